// Rung `fast`: the shading of shade.h in float32, of the eight pixels of a group.
#ifndef CLG_SHADE_FAST_H
#define CLG_SHADE_FAST_H
#include "gather.h"
#include "light.h"
#include "tile.h"

// Of the rays of a tile, by number.
typedef struct {
    float light[TILE_RAYS];
    float normal[3][TILE_RAYS];
} Shaded;

float8 dot_of_8(Points a, Points b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

Points cross_of_8(Points a, Points b)
{
    const Points p = {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
    return p;
}

Points scaled(Points p, float8 by)
{
    const Points q = {p.x * by, p.y * by, p.z * by};
    return q;
}

Points difference(Points a, Points b)
{
    const Points p = {a.x - b.x, a.y - b.y, a.z - b.z};
    return p;
}

// 1 / length; 0 of what has none, or too little for its square.
float8 inverse_length(Points p)
{
    const float8 square = dot_of_8(p, p);
    return square > 0.0f ? 1.0f / sqrt(square) : (float8)(0.0f);
}

void rays_of_8(const Tile *tile, uint g, Points *origin, Points *direction)
{
    const Points o = {vload8(g, tile->o[0]), vload8(g, tile->o[1]), vload8(g, tile->o[2])};
    const Points d = {vload8(g, tile->d[0]), vload8(g, tile->d[1]), vload8(g, tile->d[2])};
    *origin = o;
    *direction = d;
}

#ifdef SMOOTH_NORMALS
float4 load_normal(__global const float *vertex_normals, uint k)
{
    return (float4)(vload3((size_t)k, vertex_normals), 0.0f);
}

// The normals interpolated from the vertices, on the face's side; a vertex without one takes the face's.
Points smooth_normals(__global const float *vertex_normals, __global const uint *faces, const uint *ids, float8 u,
                      float8 v, Points face)
{
    const float8 weights[3] = {1.0f - u - v, u, v};
    Points sum = {(float8)(0.0f), (float8)(0.0f), (float8)(0.0f)};
    float8 without = (float8)(0.0f);
    for (uint k = 0; k < 3; ++k) {
        float4 corners[LANES];
        for (uint lane = 0; lane < LANES; ++lane)
            corners[lane] = load_normal(vertex_normals, faces[3 * (size_t)ids[lane] + k]);
        const Points n = transposed(corners);
        const float8 by = inverse_length(n) * weights[k];
        sum.x += n.x * by;
        sum.y += n.y * by;
        sum.z += n.z * by;
        without += by == 0.0f ? weights[k] : (float8)(0.0f);
    }
    const float8 side = dot_of_8(sum, face) < 0.0f ? (float8)(-1.0f) : (float8)(1.0f);
    sum.x = sum.x * side + without * face.x;
    sum.y = sum.y * side + without * face.y;
    sum.z = sum.z * side + without * face.z;
    const float8 inverse = inverse_length(sum);
    const Points unit = scaled(sum, inverse);
    const Points chosen = {inverse > 0.0f ? unit.x : face.x, inverse > 0.0f ? unit.y : face.y,
                           inverse > 0.0f ? unit.z : face.z};
    return chosen;
}
#endif

void shade_group(const Tile *tile, uint g, const uint *ids, MESH_PARAMETERS,
#ifdef SMOOTH_NORMALS
                 __global const float *vertex_normals,
#endif
                 Shaded *shaded)
{
    Points origin, view;
    rays_of_8(tile, g, &origin, &view);
    const Corners8 p = gather_corners(vertices, faces, ids, LANES);
    const Points e = difference(p.b, p.a), f = difference(p.c, p.a), across = cross_of_8(e, f);
    // Scaled up by a power of two, for the square of the smallest.
    const float8 largest = max(max(fabs(across.x), fabs(across.y)), fabs(across.z));
    const Points large = scaled(across, largest < 0x1p-40f ? (float8)(0x1p+60f) : (float8)(1.0f));
    const float8 facing = dot_of_8(large, view), per_length = inverse_length(large), per_view = inverse_length(view);
    // On the viewer's side; a triangle without a normal faces the viewer.
    const int8 flat = per_length == 0.0f;
    const float8 by = facing > 0.0f ? -per_length : per_length;
    Points normal = {flat ? -view.x * per_view : large.x * by, flat ? -view.y * per_view : large.y * by,
                     flat ? -view.z * per_view : large.z * by};
#ifdef SMOOTH_NORMALS
    const Points s = difference(origin, p.a), moment = cross_of_8(view, s);
    const float8 inverse = -1.0f / dot_of_8(across, view);
    const float8 u = dot_of_8(f, moment) * -inverse, v = dot_of_8(e, moment) * inverse;
    normal = smooth_normals(vertex_normals, faces, ids, u, v, normal);
#endif
    const float8 lit = max(-dot_of_8(normal, view) * per_view, 0.0f);
    vstore8((float)ALBEDO * ((float)AMBIENT + (1.0f - (float)AMBIENT) * lit), g, shaded->light);
    vstore8(normal.x, g, shaded->normal[0]);
    vstore8(normal.y, g, shaded->normal[1]);
    vstore8(normal.z, g, shaded->normal[2]);
}

void shade_tile(const Tile *tile, MESH_PARAMETERS,
#ifdef SMOOTH_NORMALS
                __global const float *vertex_normals,
#endif
                Shaded *shaded)
{
    for (uint g = 0; g < GROUPS; ++g) {
        uint ids[LANES], least = NO_HIT;
        for (uint i = 0; i < LANES; i += 4) {
            const uint4 found = ids_of_4(tile, g * LANES + i);
            vstore4(found, 0, ids + i);
            least = min(least, min(min(found.x, found.y), min(found.z, found.w)));
        }
        if (least == NO_HIT)
            continue;
        // Another's triangle stands in where there is none.
        for (uint i = 0; i < LANES; ++i)
            ids[i] = ids[i] == NO_HIT ? least : ids[i];
        shade_group(tile, g, ids, MESH_ARGUMENTS,
#ifdef SMOOTH_NORMALS
                    vertex_normals,
#endif
                    shaded);
    }
}

#endif
