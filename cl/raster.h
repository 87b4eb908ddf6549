// Which cells a triangle is entered in: all that its padded bounding box touches.
// float32 throughout: BOX_PAD exceeds what is needed by more than the rounding here, so that the
// cells found are a superset of the closed, exact ones (docs/numerics.md, "Insertion").
#ifndef CLG_RASTER_H
#define CLG_RASTER_H
#include "config.h"

// Asks for a triangle's vertices so many triangles before they are needed: where neighbours in the mesh are
// far apart in memory, the build would wait for little else.
#define FETCH_AHEAD 32u
void fetch_early(__global const float *vertices, __global const uint *face)
{
#if defined(__has_builtin)
#if __has_builtin(__builtin_prefetch)
    for (int i = 0; i < 3; ++i) {
        // First and last of the four floats that are read: they may lie in two cache lines.
        const size_t at = (size_t)(vertices + 3 * (size_t)face[i]);
        __builtin_prefetch((const void *)at, 0, 3);
        __builtin_prefetch((const void *)(at + 12), 0, 3);
    }
#endif
#endif
}

typedef struct {
    int4 first, last;  // inclusive; .w is unused
} CellRange;

CellRange cell_range(__constant const GridParams *grid, __global const float *vertices,
                     __global const uint *face)
{
    // Four floats at a time; the vertex array has one float to spare.
    const float4 a = vload4(0, vertices + 3 * (size_t)face[0]);
    const float4 b = vload4(0, vertices + 3 * (size_t)face[1]);
    const float4 c = vload4(0, vertices + 3 * (size_t)face[2]);
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

// A range in eight bytes: the first cell's index, and the extents less one in 11, 11 and 10 bits.
#define RANGE_TOO_LONG 0xFFFFFFFFu

uint2 pack_range(CellRange range, uint mx, uint my)
{
    const uint4 more = convert_uint4(range.last - range.first);
    const uint first = ((uint)range.first.z * my + (uint)range.first.y) * mx + (uint)range.first.x;
    if (more.x > 2047u || more.y > 2047u || more.z > 1022u)
        return (uint2)(first, RANGE_TOO_LONG);
    return (uint2)(first, more.x | more.y << 11 | more.z << 22);
}

uint4 packed_extent(uint packed)
{
    return (uint4)(packed & 2047u, packed >> 11 & 2047u, packed >> 22, 0u) + 1u;
}

#endif
