// Build, stage 3: every reference goes to its slab, triangles ascending: (cell within the slab, triangle).
// counts[chunk][slab] is the chunk's write position in the slab, and advances.
#include "clip.h"

// Where references go: the chunk's position in each slab, and the arrays.
typedef struct {
    __global ref_index *position;
    __global ushort *cells;
    __global uint *triangles;
    uint slab_shift;
} Bins;

// Enters a triangle in the cells `cell` .. `end` - 1 of a row.
void bin_run(const Bins *bins, uint cell, uint end, uint triangle)
{
    const uint within = (1u << bins->slab_shift) - 1u;
    for (; cell < end; ++cell) {
        const ref_index at = bins->position[cell >> bins->slab_shift]++;
        bins->cells[at] = (ushort)(cell & within);
        bins->triangles[at] = triangle;
    }
}

// Enters a large triangle in the cells that it touches, as count_clipped counts them.
void bin_clipped(__constant const GridParams *grid, __global const float *vertices, __global const uint *face,
                 CellRange range, const Bins *bins, uint triangle)
{
    const uint mx = grid->resolution[0], my = grid->resolution[1];
    const Polygon corners = whole_triangle(vertices, face);
    const double per_unit = 1.0 / grid->cell_size[0];
    for (int z = range.first.z; z <= range.last.z; ++z) {
        Side sides[5];
        const int number = cut_layer(grid, &corners, z, sides);
        for (int y = range.first.y; y <= range.last.y; ++y) {
            const int2 run = row_run(grid, per_unit, sides, number, y, range.first.x, range.last.x);
            const uint row = ((uint)z * my + (uint)y) * mx;
            bin_run(bins, row + (uint)run.x, row + (uint)run.y + 1u, triangle);
        }
    }
}

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void bin_references(__constant const GridParams *grid, __global const float *vertices,
                             __global const uint *faces, uint chunk_size, uint slab_shift, uint slabs,
                             __global const uint2 *ranges, __global ref_index *counts,
                             __global ushort *binned_cells, __global uint *binned_triangles)
{
    const uint chunk = get_global_id(0);
    const uint begin = chunk * chunk_size;
    const uint end = min(begin + chunk_size, grid->triangle_count);
    const uint mx = grid->resolution[0], my = grid->resolution[1];
    const Bins bins = {counts + (size_t)chunk * slabs, binned_cells, binned_triangles, slab_shift};
    for (uint i = begin; i < end; ++i) {
        const uint2 packed = ranges[i];
        const uint4 extent = packed_extent(packed.y);
        if (packed.y == RANGE_TOO_LONG || worth_clipping(extent)) {
            __global const uint *face = faces + 3 * (size_t)i;
            const CellRange range = cell_range(grid, vertices, face);
            const uint4 whole = convert_uint4(range.last - range.first) + 1u;
            if (worth_clipping(whole)) {
                bin_clipped(grid, vertices, face, range, &bins, i);
                continue;
            }
            // Too long for a packed range, along one axis alone.
            for (uint z = 0; z < whole.z; ++z)
                for (uint y = 0; y < whole.y; ++y) {
                    const uint row = packed.x + (z * my + y) * mx;
                    bin_run(&bins, row, row + whole.x, i);
                }
            continue;
        }
        for (uint z = 0; z < extent.z; ++z) {
            uint row = packed.x + z * my * mx;
            for (uint y = 0; y < extent.y; ++y, row += mx)
                bin_run(&bins, row, row + extent.x, i);
        }
    }
}
