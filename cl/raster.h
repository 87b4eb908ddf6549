// Which cells a triangle is entered in: all that its padded bounding box touches.
// float32 throughout: BOX_PAD exceeds what is needed by more than the rounding here, so that the
// cells found are a superset of the closed, exact ones (docs/numerics.md, "Insertion").
#ifndef CLG_RASTER_H
#define CLG_RASTER_H
#include "ask.h"
#include "gather.h"

// Asks for the vertices of eight triangles so many triangles before they are needed: where neighbours in the mesh
// are far apart in memory, the build would wait for little else.
#define FETCH_AHEAD 32u
void fetch_early(__global const float *vertices, __global const uint *faces)
{
#pragma unroll
    for (uint i = 0; i < 24; ++i) {
        // First and last of the four floats that are read: they may lie in two cache lines.
        __global const float *vertex = vertices + 3 * (size_t)faces[i];
        ask_for(vertex);
        ask_for(vertex + 3);
    }
}

typedef struct {
    int4 first, last;  // inclusive; .w is unused
} CellRange;

CellRange cell_range(__constant const GridParams *grid, __global const float *vertices,
                     __global const uint *face)
{
    const float4 a = load_vertex(vertices, face[0]);
    const float4 b = load_vertex(vertices, face[1]);
    const float4 c = load_vertex(vertices, face[2]);
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

// cell_range of eight triangles that follow one another.
CellRanges8 cell_ranges8(__constant const GridParams *grid, __global const float *vertices,
                         __global const uint *faces)
{
    float4 low[8], high[8];
#pragma unroll
    for (uint i = 0; i < 8; ++i) {
        const float4 a = load_vertex(vertices, faces[3 * i]);
        const float4 b = load_vertex(vertices, faces[3 * i + 1]);
        const float4 c = load_vertex(vertices, faces[3 * i + 2]);
        low[i] = min(min(a, b), c);
        high[i] = max(max(a, b), c);
    }
    const float8 pad = (float8)((float)BOX_PAD);
    const Points l = transposed(low), h = transposed(high);
    CellRanges8 r;
    cells_along(l.x - pad, h.x + pad, grid->lower_f[0], grid->cells_per_unit[0], grid->resolution[0], &r.x, &r.more_x);
    cells_along(l.y - pad, h.y + pad, grid->lower_f[1], grid->cells_per_unit[1], grid->resolution[1], &r.y, &r.more_y);
    cells_along(l.z - pad, h.z + pad, grid->lower_f[2], grid->cells_per_unit[2], grid->resolution[2], &r.z, &r.more_z);
    return r;
}

// A range in eight bytes: the first cell's index, and the extents less one in 11, 11 and 10 bits.
// What does not fit says so by an extent of its own, whose odd bits along z are clear: no second layer is looked at.
#define RANGE_TOO_LONG 0xFFBFFFFFu
// Of a triangle that was clipped: where its runs of cells are kept, in the 22 bits below.
#define RANGE_KEPT 0xFF000000u
#define KEPT_AT 0x003FFFFFu
#define MOST_LAYERS 1019

bool is_kept(uint packed)
{
    return (packed & ~KEPT_AT) == RANGE_KEPT;
}

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
