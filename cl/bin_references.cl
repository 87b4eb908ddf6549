// Build, stage 3: every reference goes to its slab, triangles ascending: (cell within the slab, triangle).
// counts[chunk][slab] is the chunk's write position in the slab, and advances.
#include "raster.h"

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void bin_references(__constant const GridParams *grid, __global const float *vertices,
                             __global const uint *faces, uint chunk_size, uint slab_shift, uint slabs,
                             __global const uint2 *ranges, __global uint *counts,
                             __global ushort *binned_cells, __global uint *binned_triangles)
{
    const uint chunk = get_global_id(0);
    const uint begin = chunk * chunk_size;
    const uint end = min(begin + chunk_size, grid->triangle_count);
    const uint mx = grid->resolution[0], my = grid->resolution[1];
    const uint within = (1u << slab_shift) - 1u;
    __global uint *position = counts + (size_t)chunk * slabs;
    for (uint i = begin; i < end; ++i) {
        const uint2 packed = ranges[i];
        uint4 extent = packed_extent(packed.y);
        if (packed.y == RANGE_TOO_LONG) {
            const CellRange range = cell_range(grid, vertices, faces + 3 * (size_t)i);
            extent = convert_uint4(range.last - range.first) + 1u;
        }
        for (uint z = 0; z < extent.z; ++z) {
            uint row = packed.x + z * my * mx;
            for (uint y = 0; y < extent.y; ++y, row += mx) {
                for (uint cell = row; cell < row + extent.x; ++cell) {
                    const uint at = position[cell >> slab_shift]++;
                    binned_cells[at] = (ushort)(cell & within);
                    binned_triangles[at] = i;
                }
            }
        }
    }
}
