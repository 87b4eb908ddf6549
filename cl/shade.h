// The paper's plain shading: a headlight at the eye on a grey surface; four pixels at a time. Written out in float64
// with + - * / sqrt alone, which round alike everywhere, so that pictures are the same bits on all devices.
#ifndef CLG_SHADE_H
#define CLG_SHADE_H
#include "gather.h"
#include "light.h"

typedef struct {
    double4 x, y, z;
} Vectors;

double4 dot_of_4(const Vectors *a, const Vectors *b)
{
    return (a->x * b->x + a->y * b->y) + a->z * b->z;
}

// Whether a length can be told from its square.
long4 has_length(double4 square)
{
    return (square > 0.0) & (square < INFINITY);
}

// Scales the vectors to length 1, but those without a direction (zero, NaN, or beyond what a square can hold). Gives
// which were scaled.
long4 to_unit(Vectors *v)
{
    const double4 square = dot_of_4(v, v);
    const long4 sound = has_length(square);
    const double4 inverse = 1.0 / (sound ? sqrt(square) : (double4)(1.0));
    v->x = v->x * inverse;
    v->y = v->y * inverse;
    v->z = v->z * inverse;
    return sound;
}

Vectors select_vectors(Vectors a, Vectors b, long4 second)
{
    const Vectors chosen = {second ? b.x : a.x, second ? b.y : a.y, second ? b.z : a.z};
    return chosen;
}

Vectors minus(Vectors v)
{
    const Vectors opposite = {-v.x, -v.y, -v.z};
    return opposite;
}

Vectors transposed_4(float4 a, float4 b, float4 c, float4 d)
{
    Vectors v;
    v.x = convert_double4((float4)(a.x, b.x, c.x, d.x));
    v.y = convert_double4((float4)(a.y, b.y, c.y, d.y));
    v.z = convert_double4((float4)(a.z, b.z, c.z, d.z));
    return v;
}

// Numbers of corner k of four triangles.
uint4 corner_of_4(__global const uint *faces, uint4 ids, uint k)
{
    return (uint4)(faces[3 * (size_t)ids.x + k], faces[3 * (size_t)ids.y + k], faces[3 * (size_t)ids.z + k],
                   faces[3 * (size_t)ids.w + k]);
}

// Corner k of four triangles.
Vectors corners_of_4(__global const float *vertices, __global const uint *faces, uint4 ids, uint k)
{
    const uint4 n = corner_of_4(faces, ids, k);
    return transposed_4(load_vertex(vertices, n.x), load_vertex(vertices, n.y), load_vertex(vertices, n.z),
                        load_vertex(vertices, n.w));
}

float4 load_normal(__global const float *vertex_normals, uint k)
{
    return (float4)(vload3((size_t)k, vertex_normals), 0.0f);
}

// The normals of corner k of four triangles.
Vectors normals_of_4(__global const float *vertex_normals, __global const uint *faces, uint4 ids, uint k)
{
    const uint4 n = corner_of_4(faces, ids, k);
    return transposed_4(load_normal(vertex_normals, n.x), load_normal(vertex_normals, n.y),
                        load_normal(vertex_normals, n.z), load_normal(vertex_normals, n.w));
}

// Normals of four triangles, of any length and either way, but of those that have none (not `sound`). The local frame
// keeps directions, so local vertices will do.
typedef struct {
    uint4 ids;
    Vectors normals;
    long4 sound;
} Facing;

Facing facing_of(__global const float *vertices, __global const uint *faces, uint4 ids)
{
    const Vectors a = corners_of_4(vertices, faces, ids, 0);
    const Vectors b = corners_of_4(vertices, faces, ids, 1);
    const Vectors c = corners_of_4(vertices, faces, ids, 2);
    const Vectors e = {b.x - a.x, b.y - a.y, b.z - a.z}, f = {c.x - a.x, c.y - a.y, c.z - a.z};
    Facing facing;
    const Vectors normals = {e.y * f.z - e.z * f.y, e.z * f.x - e.x * f.z, e.x * f.y - e.y * f.x};
    facing.ids = ids;
    facing.normals = normals;
    facing.sound = has_length(dot_of_4(&normals, &normals));
    return facing;
}

// The normals on the viewer's side; `views` are the directions of the rays. Neither need be of length 1.
Vectors face_normals(const Facing *facing, const Vectors *views)
{
    const Vectors own = facing->normals;
    const Vectors normal = select_vectors(own, minus(own), dot_of_4(&own, views) > 0.0);
    return select_vectors(minus(*views), normal, facing->sound);
}

// The normals interpolated from the vertices by the weights u, v of the second and third, turned to the face's
// side. A vertex without a normal (a zero row) takes the face's.
Vectors smooth_normals(__global const float *vertex_normals, __global const uint *faces, uint4 ids, double4 u,
                       double4 v, Vectors normal)
{
    const double4 weights[3] = {(1.0 - u) - v, u, v};
    Vectors sum = {(double4)(0.0), (double4)(0.0), (double4)(0.0)};
    double4 without = (double4)(0.0);
    for (uint k = 0; k < 3; ++k) {
        Vectors n = normals_of_4(vertex_normals, faces, ids, k);
        const long4 sound = to_unit(&n);
        const Vectors more = {sum.x + weights[k] * n.x, sum.y + weights[k] * n.y, sum.z + weights[k] * n.z};
        sum = select_vectors(sum, more, sound);
        without = sound ? without : without + weights[k];
    }
    sum = select_vectors(sum, minus(sum), dot_of_4(&sum, &normal) < 0.0);
    if (any(without != 0.0)) {
        Vectors faces_own = normal;
        to_unit(&faces_own);
        sum.x = sum.x + without * faces_own.x;
        sum.y = sum.y + without * faces_own.y;
        sum.z = sum.z + without * faces_own.z;
    }
    return select_vectors(normal, sum, has_length(dot_of_4(&sum, &sum)));
}

// Light sent back to the eye: the facing ratio above the ambient share. Lengths do not matter: one root and one quotient
// are a fraction of what it takes to make both vectors unit ones.
float4 headlights(const Vectors *normals, const Vectors *views)
{
    const double4 lengths = sqrt(dot_of_4(normals, normals) * dot_of_4(views, views));
    const double4 facing = -dot_of_4(normals, views) / lengths;
    const double4 lit = facing > 0.0 ? facing : (double4)(0.0);
    return convert_float4(ALBEDO * (AMBIENT + (1.0 - AMBIENT) * lit));
}

#endif
