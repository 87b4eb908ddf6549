// Build, stage 1: the cells of each triangle, and how many references fall into each slab.
// A slab is 2^slab_shift consecutive cells. One work-item takes one chunk of triangles, so that the
// result is the same for any number of threads (sort-middle: Ize et al. 2006; paper section 3).
//   ranges[triangle]           packed cell range, see raster.h
//   counts[chunk][slab]        references of the chunk in the slab
//   totals[chunk]              references of the chunk, in 64 bits
#include "clip.h"

// Counts the cells `cell` .. `end` - 1 of a row, slab by slab.
void count_run(__global ref_index *count, uint slab_shift, uint cell, uint end)
{
    while (cell < end) {
        const uint slab = cell >> slab_shift;
        const uint slab_end = min(end, (slab + 1) << slab_shift);
        count[slab] += slab_end - cell;
        cell = slab_end;
    }
}

// Counts the cells that a large triangle touches; returns their number.
ulong count_clipped(__constant const GridParams *grid, __global const float *vertices, __global const uint *face,
                    CellRange range, uint slab_shift, __global ref_index *count)
{
    const uint mx = grid->resolution[0], my = grid->resolution[1];
    const Polygon triangle = whole_triangle(vertices, face);
    const double per_unit = 1.0 / grid->cell_size[0];
    ulong total = 0;
    for (int z = range.first.z; z <= range.last.z; ++z) {
        Side sides[5];
        const int number = cut_layer(grid, &triangle, z, sides);
        for (int y = range.first.y; y <= range.last.y; ++y) {
            const int2 run = row_run(grid, per_unit, sides, number, y, range.first.x, range.last.x);
            const uint row = ((uint)z * my + (uint)y) * mx;
            count_run(count, slab_shift, row + (uint)run.x, row + (uint)run.y + 1u);
            total += (ulong)(run.y - run.x + 1);
        }
    }
    return total;
}

// Counts the cells of one triangle, whatever its size; returns their number.
ulong count_triangle(__constant const GridParams *grid, __global const float *vertices, __global const uint *face,
                     CellRange range, ulong room, uint slab_shift, __global ref_index *count)
{
    const uint mx = grid->resolution[0], my = grid->resolution[1];
    const uint4 extent = convert_uint4(range.last - range.first) + 1u;
    const ulong box = (ulong)extent.x * extent.y * extent.z;
    // A grid that will be refused is only counted: the rows of it may take hours.
    if (box > room)
        return box;
    if (worth_clipping(extent))
        return count_clipped(grid, vertices, face, range, slab_shift, count);
    for (uint z = 0; z < extent.z; ++z) {
        uint row = (((uint)range.first.z + z) * my + (uint)range.first.y) * mx + (uint)range.first.x;
        for (uint y = 0; y < extent.y; ++y, row += mx)
            count_run(count, slab_shift, row, row + extent.x);
    }
    return box;
}

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void count_references(__constant const GridParams *grid, __global const float *vertices,
                               __global const uint *faces, uint chunk_size, uint slab_shift, uint slabs,
                               ulong most_references, __global uint2 *ranges, __global ref_index *counts,
                               __global ref_index *spare, __global ulong *totals)
{
    const uint chunk = get_global_id(0);
    const uint begin = chunk * chunk_size;
    const uint end = min(begin + chunk_size, grid->triangle_count);
    const uint mx = grid->resolution[0], my = grid->resolution[1];
    __global ref_index *count = counts + (size_t)chunk * slabs;
    __global ref_index *other = spare + (size_t)chunk * slabs;
    ulong total = 0;
    for (uint s = 0; s < slabs; ++s)
        count[s] = other[s] = 0;
    uint i = begin;
    for (; i + 8 <= end && total + 256 <= most_references; i += 8) {
        if (i + FETCH_AHEAD + 8 <= end)
            fetch_early8(vertices, faces + 3 * (size_t)(i + FETCH_AHEAD));
        const CellRanges8 r = cell_ranges8(grid, vertices, faces + 3 * (size_t)i);
        const uint8 first = convert_uint8((r.z * (int)my + r.y) * (int)mx + r.x);
        const int8 too_long = (r.more_x > 2047) | (r.more_y > 2047) | (r.more_z > 1022);
        const int8 packed = (r.more_x | r.more_y << 11 | r.more_z << 22) | too_long;
        const uint8 packed_u = as_uint8(packed);
        vstore8((uint8)(first.s0, packed_u.s0, first.s1, packed_u.s1, first.s2, packed_u.s2, first.s3, packed_u.s3), 0,
                (__global uint *)(ranges + i));
        vstore8((uint8)(first.s4, packed_u.s4, first.s5, packed_u.s5, first.s6, packed_u.s6, first.s7, packed_u.s7), 0,
                (__global uint *)(ranges + i + 4));
        // Most triangles touch two layers of cells at most, and of each one slab alone.
        const uint8 layer = as_uint8(r.more_y * (int)mx + r.more_x);
        const uint8 second = first + as_uint8(r.more_z * (int)(mx * my));
        const uint8 slab0 = first >> slab_shift, slab1 = second >> slab_shift;
        const int8 small = (r.more_z < 2) & (r.more_x < 4) & (r.more_y < 4) & ((first + layer) >> slab_shift == slab0) & ((second + layer) >> slab_shift == slab1);
        const int8 cells = (r.more_x + 1) * (r.more_y + 1) & small;
        const int8 cells1 = cells & (0 - r.more_z);
        uint s0[8], s1[8], n0[8], n1[8];
        vstore8(slab0, 0, s0);
        vstore8(slab1 & as_uint8(small), 0, s1);
        vstore8(as_uint8(cells), 0, n0);
        vstore8(as_uint8(cells1), 0, n1);
#pragma unroll
        for (uint k = 0; k < 8; ++k) {
            count[s0[k]] += n0[k];
            other[s1[k]] += n1[k];
            total += n0[k] + n1[k];
        }
        const int4 both = small.lo & small.hi;
        if ((both.x & both.y & both.z & both.w) == 0)
            for (uint k = 0; k < 8; ++k)
                if (n0[k] == 0) {
                    __global const uint *face = faces + 3 * (size_t)(i + k);
                    const CellRange range = cell_range(grid, vertices, face);
                    total += count_triangle(grid, vertices, face, range, most_references - min(total, most_references), slab_shift, count);
                }
    }
    for (; i < end; ++i) {
        __global const uint *face = faces + 3 * (size_t)i;
        const CellRange range = cell_range(grid, vertices, face);
        ranges[i] = pack_range(range, mx, my);
        total += count_triangle(grid, vertices, face, range, most_references - min(total, most_references), slab_shift, count);
    }
    for (uint s = 0; s < slabs; ++s)
        count[s] += other[s];
    totals[chunk] = total;
}
