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

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void count_references(__constant const GridParams *grid, __global const float *vertices,
                               __global const uint *faces, uint chunk_size, uint slab_shift, uint slabs,
                               ulong most_references, __global uint2 *ranges, __global ref_index *counts,
                               __global ulong *totals)
{
    const uint chunk = get_global_id(0);
    const uint begin = chunk * chunk_size;
    const uint end = min(begin + chunk_size, grid->triangle_count);
    const uint mx = grid->resolution[0], my = grid->resolution[1];
    __global ref_index *count = counts + (size_t)chunk * slabs;
    ulong total = 0;
    for (uint s = 0; s < slabs; ++s)
        count[s] = 0;
    for (uint i = begin; i < end; ++i) {
        fetch_early(vertices, faces + 3 * (size_t)min(i + FETCH_AHEAD, end - 1));
        __global const uint *face = faces + 3 * (size_t)i;
        const CellRange range = cell_range(grid, vertices, face);
        const uint4 extent = convert_uint4(range.last - range.first) + 1u;
        const uint2 packed = pack_range(range, mx, my);
        ranges[i] = packed;
        const ulong box = (ulong)extent.x * extent.y * extent.z;
        // A grid that will be refused is only counted: the rows of it may take hours.
        if (total + box > most_references) {
            total += box;
            continue;
        }
        if (worth_clipping(extent)) {
            total += count_clipped(grid, vertices, face, range, slab_shift, count);
            continue;
        }
        total += box;
        for (uint z = 0; z < extent.z; ++z) {
            uint row = packed.x + z * my * mx;
            for (uint y = 0; y < extent.y; ++y, row += mx)
                count_run(count, slab_shift, row, row + extent.x);
        }
    }
    totals[chunk] = total;
}
