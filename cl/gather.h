// The corners of eight triangles of a list, brought together as vectors of x, y and z.
#ifndef CLG_GATHER_H
#define CLG_GATHER_H
#include "mesh.h"

typedef struct {
    float8 x, y, z;
} Points;

typedef struct {
    Points a, b, c;
} Corners8;

// Four floats at any address in one load: compilers take a vload4 apart. The vertex array has a float to spare.
typedef float4 loose_float4 __attribute__((aligned(4)));

float4 load_vertex(__global const float *vertices, uint k)
{
    return *(__global const loose_float4 *)(vertices + 3 * (size_t)k);
}

// Eight vertices, transposed: two shuffles of two vectors a step.
Points transposed(const float4 *p)
{
    const float8 a = (float8)(p[0], p[4]), b = (float8)(p[1], p[5]);
    const float8 c = (float8)(p[2], p[6]), d = (float8)(p[3], p[7]);
    const float8 ab = (float8)(a.s0, b.s0, a.s1, b.s1, a.s4, b.s4, a.s5, b.s5);
    const float8 cd = (float8)(c.s0, d.s0, c.s1, d.s1, c.s4, d.s4, c.s5, d.s5);
    const float8 abz = (float8)(a.s2, b.s2, a.s3, b.s3, a.s6, b.s6, a.s7, b.s7);
    const float8 cdz = (float8)(c.s2, d.s2, c.s3, d.s3, c.s6, d.s6, c.s7, d.s7);
    Points q;
    q.x = (float8)(ab.s01, cd.s01, ab.s45, cd.s45);
    q.y = (float8)(ab.s23, cd.s23, ab.s67, cd.s67);
    q.z = (float8)(abz.s01, cdz.s01, abz.s45, cdz.s45);
    return q;
}

// Of 1 to 8 triangles; a shorter list is filled up with its last.
Corners8 gather_corners(__global const float *vertices, __global const uint *faces, const uint *ids, uint count)
{
    // Unrolled, with whole vectors: compilers would gather floats one by one, which takes twice as long.
    float4 corners[24];
    const uint last = count - 1;
#pragma unroll
    for (uint i = 0; i < 8; ++i) {
        __global const uint *face = faces + 3 * (size_t)ids[i < last ? i : last];
        corners[i] = load_vertex(vertices, face[0]);
        corners[i + 8] = load_vertex(vertices, face[1]);
        corners[i + 16] = load_vertex(vertices, face[2]);
    }
    Corners8 gathered;
    gathered.a = transposed(corners);
    gathered.b = transposed(corners + 8);
    gathered.c = transposed(corners + 16);
    return gathered;
}

#endif
