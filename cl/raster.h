// Which cells a triangle is entered in: all that its padded bounding box touches.
// float32 throughout: BOX_PAD exceeds what is needed by more than the rounding here, so that the
// cells found are a superset of the closed, exact ones (docs/numerics.md, "Insertion").
#ifndef CLG_RASTER_H
#define CLG_RASTER_H
#include "config.h"

// Asks for the vertices of eight triangles so many triangles before they are needed: where neighbours in the mesh
// are far apart in memory, the build would wait for little else.
#define FETCH_AHEAD 32u
void fetch_early(__global const float *vertices, __global const uint *faces)
{
#if defined(__has_builtin)
#if __has_builtin(__builtin_prefetch)
#pragma unroll
    for (uint i = 0; i < 24; ++i) {
        // First and last of the four floats that are read: they may lie in two cache lines.
        const size_t at = (size_t)(vertices + 3 * (size_t)faces[i]);
        __builtin_prefetch((const void *)at, 0, 3);
        __builtin_prefetch((const void *)(at + 12), 0, 3);
    }
#endif
#endif
}

typedef struct {
    int4 first, last;  // inclusive; .w is unused
} CellRange;

// Four floats at any address in one load: compilers take a vload4 apart. The vertex array has a float to spare.
typedef float4 loose_corner __attribute__((aligned(4)));

float4 load_corner(__global const float *vertices, uint k)
{
    return *(__global const loose_corner *)(vertices + 3 * (size_t)k);
}

CellRange cell_range(__constant const GridParams *grid, __global const float *vertices,
                     __global const uint *face)
{
    const float4 a = load_corner(vertices, face[0]);
    const float4 b = load_corner(vertices, face[1]);
    const float4 c = load_corner(vertices, face[2]);
    const float4 pad = (float4)((float)BOX_PAD);
    const float4 lower = (float4)(grid->lower_f[0], grid->lower_f[1], grid->lower_f[2], 0.0f);
    const float4 scale =
        (float4)(grid->cells_per_unit[0], grid->cells_per_unit[1], grid->cells_per_unit[2], 0.0f);
    const int4 highest =
        (int4)((int)grid->resolution[0], (int)grid->resolution[1], (int)grid->resolution[2], 1) - 1;
    const float4 low = min(min(a, b), c) - pad;
    const float4 high = max(max(a, b), c) + pad;
    CellRange range;
    // Both are positive: the grid reaches 2 BOX_PAD beyond the mesh. So truncation is floor.
    range.first = min(max(convert_int4((low - lower) * scale), (int4)(0)), highest);
    range.last = min(max(convert_int4((high - lower) * scale), (int4)(0)), highest);
    return range;
}

// The ranges of eight triangles.
typedef struct {
    int8 x, y, z;                 // first cell
    int8 more_x, more_y, more_z;  // cells beyond it
} CellRanges8;

// First and last of the cells along an axis, of which there are `cells`: as in cell_range.
void cells_along(float8 low, float8 high, float lower, float scale, uint cells, int8 *first, int8 *more)
{
    const int8 highest = (int8)((int)cells - 1);
    const int8 from = min(max(convert_int8((low - lower) * scale), (int8)(0)), highest);
    const int8 to = min(max(convert_int8((high - lower) * scale), (int8)(0)), highest);
    *first = from;
    *more = to - from;
}

// Eight points, transposed: a is 0 and 4, b is 1 and 5, and so on.
void transpose(float8 a, float8 b, float8 c, float8 d, float8 *x, float8 *y, float8 *z)
{
    const float8 ab = (float8)(a.s0, b.s0, a.s1, b.s1, a.s4, b.s4, a.s5, b.s5);
    const float8 cd = (float8)(c.s0, d.s0, c.s1, d.s1, c.s4, d.s4, c.s5, d.s5);
    const float8 abz = (float8)(a.s2, b.s2, a.s3, b.s3, a.s6, b.s6, a.s7, b.s7);
    const float8 cdz = (float8)(c.s2, d.s2, c.s3, d.s3, c.s6, d.s6, c.s7, d.s7);
    *x = (float8)(ab.s01, cd.s01, ab.s45, cd.s45);
    *y = (float8)(ab.s23, cd.s23, ab.s67, cd.s67);
    *z = (float8)(abz.s01, cdz.s01, abz.s45, cdz.s45);
}

// cell_range of eight triangles that follow one another.
CellRanges8 cell_ranges8(__constant const GridParams *grid, __global const float *vertices,
                         __global const uint *faces)
{
    float4 low[8], high[8];
#pragma unroll
    for (uint i = 0; i < 8; ++i) {
        const float4 a = load_corner(vertices, faces[3 * i]);
        const float4 b = load_corner(vertices, faces[3 * i + 1]);
        const float4 c = load_corner(vertices, faces[3 * i + 2]);
        low[i] = min(min(a, b), c);
        high[i] = max(max(a, b), c);
    }
    const float8 pad = (float8)((float)BOX_PAD);
    float8 lx, ly, lz, hx, hy, hz;
    transpose((float8)(low[0], low[4]) - pad, (float8)(low[1], low[5]) - pad, (float8)(low[2], low[6]) - pad,
              (float8)(low[3], low[7]) - pad, &lx, &ly, &lz);
    transpose((float8)(high[0], high[4]) + pad, (float8)(high[1], high[5]) + pad,
              (float8)(high[2], high[6]) + pad, (float8)(high[3], high[7]) + pad, &hx, &hy, &hz);
    CellRanges8 r;
    cells_along(lx, hx, grid->lower_f[0], grid->cells_per_unit[0], grid->resolution[0], &r.x, &r.more_x);
    cells_along(ly, hy, grid->lower_f[1], grid->cells_per_unit[1], grid->resolution[1], &r.y, &r.more_y);
    cells_along(lz, hz, grid->lower_f[2], grid->cells_per_unit[2], grid->resolution[2], &r.z, &r.more_z);
    return r;
}

// A range in eight bytes: the first cell's index, and the extents less one in 11, 11 and 10 bits.
// What does not fit says so by an extent of its own, whose odd bits along z are clear: no second layer is looked at.
#define RANGE_TOO_LONG 0xFFBFFFFFu
#define MOST_LAYERS 1021

uint2 pack_range(CellRange range, uint mx, uint my)
{
    const uint4 more = convert_uint4(range.last - range.first);
    const uint first = ((uint)range.first.z * my + (uint)range.first.y) * mx + (uint)range.first.x;
    if (more.x > 2047u || more.y > 2047u || more.z > (uint)MOST_LAYERS)
        return (uint2)(first, RANGE_TOO_LONG);
    return (uint2)(first, more.x | more.y << 11 | more.z << 22);
}

uint4 packed_extent(uint packed)
{
    return (uint4)(packed & 2047u, packed >> 11 & 2047u, packed >> 22, 0u) + 1u;
}

#endif
