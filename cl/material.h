// What a triangle's surface looks like at weights u, v of its second and third corner.
//   material_ids   MATERIAL_ID (ushort or uint) a triangle
//   uv_rows        LOOK_UVS: 3 rows of `uvs` a triangle, set after set, each of triangle_count triangles
//   uvs            LOOK_UVS: 2 floats a row
//   colours        LOOK_COLOURS: 4 floats a vertex, linear
//   textures ...   LOOK_TEXTURES (texture.h)
#ifndef CLG_MATERIAL_H
#define CLG_MATERIAL_H
#include "mesh.h"
#include "texture.h"

#ifdef LOOK_UVS
#define LOOK_UV_PARAMETERS , __global const uint *uv_rows, __global const float *uvs
#define LOOK_UV_ARGUMENTS , uv_rows, uvs
#else
#define LOOK_UV_PARAMETERS
#define LOOK_UV_ARGUMENTS
#endif
#ifdef LOOK_COLOURS
#define LOOK_COLOUR_PARAMETERS , __global const float *colours
#define LOOK_COLOUR_ARGUMENTS , colours
#else
#define LOOK_COLOUR_PARAMETERS
#define LOOK_COLOUR_ARGUMENTS
#endif
#ifdef LOOK_TEXTURES
#define LOOK_TEXTURE_PARAMETERS , TEXTURE_PARAMETERS
#define LOOK_TEXTURE_ARGUMENTS , TEXTURE_ARGUMENTS
#else
#define LOOK_TEXTURE_PARAMETERS
#define LOOK_TEXTURE_ARGUMENTS
#endif

// Triangles first_triangle .. + triangle_count - 1 of the mesh are those of this part.
#define LOOK_PARAMETERS \
    uint first_triangle, uint triangle_count, __global const MaterialParams *materials, \
    __global const MATERIAL_ID *material_ids LOOK_UV_PARAMETERS LOOK_COLOUR_PARAMETERS LOOK_TEXTURE_PARAMETERS
#define LOOK_ARGUMENTS \
    first_triangle, triangle_count, materials, material_ids LOOK_UV_ARGUMENTS LOOK_COLOUR_ARGUMENTS \
    LOOK_TEXTURE_ARGUMENTS

typedef struct {
    double u, v;
} Coordinates;

// Texture coordinates of a set; (0, 0) where there are none.
Coordinates coordinates_at(uint id, double u, double v, uint set, LOOK_PARAMETERS)
{
    Coordinates at = {0.0, 0.0};
#ifdef LOOK_UVS
    __global const uint *rows = uv_rows + 3 * ((size_t)set * triangle_count + id);
    const double weights[3] = {(1.0 - u) - v, u, v};
    for (int k = 0; k < 3; ++k) {
        at.u = at.u + weights[k] * (double)uvs[2 * (size_t)rows[k]];
        at.v = at.v + weights[k] * (double)uvs[2 * (size_t)rows[k] + 1];
    }
#endif
    return at;
}

#ifdef LOOK_TEXTURES
Colour looked_up(uint texture, uint set, __global const double *transform, uint id, double u, double v, LOOK_PARAMETERS)
{
    const Coordinates at = coordinates_at(id, u, v, set, LOOK_ARGUMENTS);
    return texture_at(texture, (transform[0] * at.u + transform[1] * at.v) + transform[2],
                      (transform[3] * at.u + transform[4] * at.v) + transform[5], TEXTURE_ARGUMENTS);
}
#endif

// Base colour times texture times the vertices' colour.
Colour base_at(uint id, double u, double v, __global const uint *faces, LOOK_PARAMETERS)
{
    __global const MaterialParams *material = materials + material_ids[id];
    Colour base;
    for (int c = 0; c < 4; ++c)
        base.at[c] = material->base_colour[c];
#ifdef LOOK_TEXTURES
    if (material->base_texture != NO_TEXTURE) {
        const Colour found = looked_up(material->base_texture, material->base_uv, material->base_transform, id, u, v,
                                       LOOK_ARGUMENTS);
        for (int c = 0; c < 4; ++c)
            base.at[c] = base.at[c] * found.at[c];
    }
#endif
#ifdef LOOK_COLOURS
    __global const uint *face = faces + 3 * (size_t)id;
    for (int c = 0; c < 4; ++c) {
        const double a = colours[4 * (size_t)face[0] + c], b = colours[4 * (size_t)face[1] + c];
        const double d = colours[4 * (size_t)face[2] + c];
        base.at[c] = base.at[c] * ((((1.0 - u) - v) * a + u * b) + v * d);
    }
#endif
    return base;
}

// Radiance sent out.
Colour emission_at(uint id, double u, double v, LOOK_PARAMETERS)
{
    __global const MaterialParams *material = materials + material_ids[id];
    Colour emission;
    for (int c = 0; c < 3; ++c)
        emission.at[c] = material->emissive[c];
    emission.at[3] = 1.0;
#ifdef LOOK_TEXTURES
    if (material->emissive_texture != NO_TEXTURE) {
        const Colour found = looked_up(material->emissive_texture, material->emissive_uv, material->emissive_transform,
                                       id, u, v, LOOK_ARGUMENTS);
        for (int c = 0; c < 3; ++c)
            emission.at[c] = emission.at[c] * found.at[c];
    }
#endif
    return emission;
}

#endif
