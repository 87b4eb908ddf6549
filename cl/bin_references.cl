// Build, stage 3: every reference goes to its slab, triangles ascending, packed as in binned.h.
// starts[chunk][slab] is the chunk's write position in the slab, and advances to ends[chunk][slab].
#include "binned.h"
#include "clip.h"

// Where references go: the chunk's position in each slab, and the arrays.
typedef struct {
    __global ref_index *position;
    __global uint *entries;
    uint slab_shift;
} Bins;

// Enters a triangle of the chunk in the cells `cell` .. `end` - 1 of a row.
void bin_run(const Bins *bins, uint cell, uint end, uint triangle)
{
    const uint within = (1u << bins->slab_shift) - 1u;
    for (; cell < end; ++cell) {
        const ref_index at = bins->position[cell >> bins->slab_shift]++;
        bins->entries[at] = triangle << CELL_BITS | (cell & within);
    }
}

// Enters a large triangle in the cells that it touches, as count_clipped counts them.
void bin_clipped(__constant const GridParams *grid, __global const float *vertices, __global const uint *face,
                 CellRange range, const Bins *bins, uint triangle)
{
    const uint mx = grid->resolution[0], my = grid->resolution[1];
    const Polygon corners = whole_triangle(vertices, face);
    const Planes planes = planes_of(grid, (uint4)(0));
    for (int z = range.first.z; z <= range.last.z; ++z) {
        Side sides[5];
        const int number = cut_layer(&planes, &corners, z, sides);
        for (int y = range.first.y; y <= range.last.y; ++y) {
            const int2 run = row_run(&planes, sides, number, y, range.first.x, range.last.x);
            const uint row = ((uint)z * my + (uint)y) * mx;
            bin_run(bins, row + (uint)run.x, row + (uint)run.y + 1u, triangle);
        }
    }
}

// A vector at any address, in one store.
typedef uint4 loose_uint4 __attribute__((aligned(4)));

// Enters a triangle of whatever size.
void bin_triangle(__constant const GridParams *grid, __global const float *vertices, __global const uint *face,
                  uint2 packed, __global const uint2 *runs, const Bins *bins, uint triangle)
{
    if (is_kept(packed.y)) {
        __global const uint2 *own = runs + (packed.y & KEPT_AT);
        for (uint k = 1; k <= own->x; ++k)
            bin_run(bins, own[k].x, own[k].y, triangle);
        return;
    }
    const uint mx = grid->resolution[0], my = grid->resolution[1];
    uint4 extent = packed_extent(packed.y);
    if (packed.y == RANGE_TOO_LONG || worth_clipping(extent)) {
        const CellRange range = cell_range(grid, vertices, face);
        extent = convert_uint4(range.last - range.first) + 1u;
        if (worth_clipping(extent)) {
            bin_clipped(grid, vertices, face, range, bins, triangle);
            return;
        }
        // Too long for a packed range, along one axis alone.
    }
    for (uint z = 0; z < extent.z; ++z) {
        uint row = packed.x + z * my * mx;
        for (uint y = 0; y < extent.y; ++y, row += mx)
            bin_run(bins, row, row + extent.x, triangle);
    }
}

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void bin_references(__constant const GridParams *grid, __global const float *vertices,
                             __global const uint *faces, uint chunk_size, uint slab_shift, uint slabs,
                             __global const uint2 *ranges, __global ref_index *starts,
                             __global const ref_index *ends, uint room, __global const uint2 *runs,
                             __global uint *binned)
{
    const uint chunk = get_global_id(0);
    const uint begin = chunk * chunk_size;
    const uint end = min(begin + chunk_size, grid->triangle_count);
    const uint mx = grid->resolution[0], layer = mx * grid->resolution[1];
    __global ref_index *position = starts + (size_t)chunk * slabs;
    __global const ref_index *end_of = ends + (size_t)chunk * slabs;
    const Bins bins = {position, binned, slab_shift};
    const uint within = (1u << slab_shift) - 1u;
    // Cells of a layer after its first, by the extents less one along y and x, 0 or 1 each.
    const uint4 squares[4] = {(uint4)(0), (uint4)(0, 1, 0, 0), (uint4)(0, mx, 0, 0), (uint4)(0, 1, mx, mx + 1)};
    for (uint i = begin; i < end; ++i) {
        // Most triangles touch at most two layers of cells, of each at most 2 x 2, in one slab. All of these are
        // entered alike, by two stores of four, since no branch foretells the number of their cells. What is
        // stored beyond it, the chunk's next references in the slab overwrite, if it has so many to come.
        const uint2 packed = ranges[i];
        const uint more_x = packed.y & 1u, more_y = packed.y >> 11 & 1u, more_z = packed.y >> 22 & 1u;
        const uint first = packed.x, second = first + (layer & -more_z);
        const uint slab0 = first >> slab_shift, slab1 = second >> slab_shift;
        const uint across = (mx & -more_y) + more_x;
        const ref_index at0 = position[slab0], next = position[slab1];
        const bool easy = ((packed.y & ~(1u | 1u << 11 | 1u << 22)) | ((first + across) >> slab_shift ^ slab0) |
                           ((second + across) >> slab_shift ^ slab1)) == 0;
        if (!easy || at0 + 8 > end_of[slab0] || next + 8 > end_of[slab1]) {
            bin_triangle(grid, vertices, faces + 3 * (size_t)i, packed, runs + (size_t)chunk * room, &bins, i - begin);
            continue;
        }
        const uint count = (1u + more_x) << more_y;
        const ref_index end0 = at0 + count;
        const ref_index at1 = slab0 == slab1 ? end0 : next;
        const uint4 square = squares[more_y * 2 + more_x] + ((i - begin) << CELL_BITS);
        *(__global loose_uint4 *)(binned + at0) = square + (first & within);
        *(__global loose_uint4 *)(binned + at1) = square + (second & within);
        position[slab0] = end0;
        position[slab1] = at1 + (count & -more_z);
    }
}
