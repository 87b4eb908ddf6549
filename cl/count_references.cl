// Build, stage 1: the cells of each triangle, and how many references fall into each slab.
// A slab is 2^slab_shift consecutive cells. One work-item takes one chunk of triangles, so that the
// result is the same for any number of threads (sort-middle: Ize et al. 2006; paper section 3).
//   ranges[triangle]           packed cell range, see raster.h
//   counts[chunk][slab]        references of the chunk in the slab
//   totals[chunk]              references of the chunk, in 64 bits
#include "raster.h"

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void count_references(__constant const GridParams *grid, __global const float *vertices,
                               __global const uint *faces, uint chunk_size, uint slab_shift, uint slabs,
                               ulong most_references, __global uint2 *ranges, __global uint *counts,
                               __global ulong *totals)
{
    const uint chunk = get_global_id(0);
    const uint begin = chunk * chunk_size;
    const uint end = min(begin + chunk_size, grid->triangle_count);
    const uint mx = grid->resolution[0], my = grid->resolution[1];
    __global uint *count = counts + (size_t)chunk * slabs;
    ulong total = 0;
    for (uint s = 0; s < slabs; ++s)
        count[s] = 0;
    for (uint i = begin; i < end; ++i) {
        const CellRange range = cell_range(grid, vertices, faces + 3 * (size_t)i);
        const uint4 extent = convert_uint4(range.last - range.first) + 1u;
        const uint2 packed = pack_range(range, mx, my);
        ranges[i] = packed;
        total += (ulong)extent.x * extent.y * extent.z;
        // A grid that will be refused is only counted: the rows of it may take hours.
        if (total > most_references)
            continue;
        for (uint z = 0; z < extent.z; ++z) {
            uint row = packed.x + z * my * mx;
            for (uint y = 0; y < extent.y; ++y, row += mx) {
                uint cell = row;
                const uint row_end = row + extent.x;
                while (cell < row_end) {
                    const uint slab = cell >> slab_shift;
                    const uint slab_end = min(row_end, (slab + 1) << slab_shift);
                    count[slab] += slab_end - cell;
                    cell = slab_end;
                }
            }
        }
    }
    totals[chunk] = total;
}
