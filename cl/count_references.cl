// Build, stage 1: the cells of each triangle, and how many references fall into each slab.
// A slab is 2^slab_shift consecutive cells. One work-item takes one chunk of triangles, so that the
// result is the same for any number of threads (sort-middle: Ize et al. 2006; paper section 3).
//   ranges[triangle]           packed cell range, see raster.h
//   counts[chunk][slab]        references of the chunk in the slab
//   spare[chunk][slab]         for the kernel's own use
//   runs[chunk][room]          of large triangles the runs of cells that they touch, so that they are clipped once: of
//                              each their number, then first cell and end of each; as many as there is room for
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

// Room for runs of a chunk, and how much of it is taken.
typedef struct {
    __global uint2 *runs;
    uint room, taken;
} Kept;

// Counts the cells that a large triangle touches; returns their number. Its runs are kept if they fit.
ulong count_clipped(__constant const GridParams *grid, __global const float *vertices, __global const uint *face,
                    CellRange range, uint slab_shift, __global ref_index *count, Kept *kept, __global uint2 *packed)
{
    uint next = kept->taken + 1;
    const uint mx = grid->resolution[0], my = grid->resolution[1];
    const Polygon triangle = whole_triangle(vertices, face);
    const Planes planes = planes_of(grid, (uint4)(0));
    ulong total = 0;
    for (int z = range.first.z; z <= range.last.z; ++z) {
        Side sides[5];
        const int number = cut_layer(&planes, &triangle, z, sides);
        for (int y = range.first.y; y <= range.last.y; ++y) {
            const int2 run = row_run(&planes, sides, number, y, range.first.x, range.last.x);
            const uint row = ((uint)z * my + (uint)y) * mx;
            const uint begin = row + (uint)run.x, end = row + (uint)run.y + 1u;
            count_run(count, slab_shift, begin, end);
            total += (ulong)(run.y - run.x + 1);
            if (begin == end)
                continue;
            if (next < kept->room)
                kept->runs[next] = (uint2)(begin, end);
            ++next;
        }
    }
    if (next <= kept->room) {
        kept->runs[kept->taken].x = next - kept->taken - 1;
        packed->y = RANGE_KEPT | kept->taken;
        kept->taken = next;
    }
    return total;
}

// Counts the cells of one triangle, whatever its size, unless they are more than `most`; returns their number.
ulong count_triangle(__constant const GridParams *grid, __global const float *vertices, __global const uint *face,
                     CellRange range, ulong most, uint slab_shift, __global ref_index *count, Kept *kept,
                     __global uint2 *packed)
{
    const uint mx = grid->resolution[0], my = grid->resolution[1];
    const uint4 extent = convert_uint4(range.last - range.first) + 1u;
    const ulong box = (ulong)extent.x * extent.y * extent.z;
    // A grid that will be refused is only counted: the rows of it may take hours.
    if (box > most)
        return box;
    if (worth_clipping(extent))
        return count_clipped(grid, vertices, face, range, slab_shift, count, kept, packed);
    for (uint z = 0; z < extent.z; ++z) {
        uint row = (((uint)range.first.z + z) * my + (uint)range.first.y) * mx + (uint)range.first.x;
        for (uint y = 0; y < extent.y; ++y, row += mx)
            count_run(count, slab_shift, row, row + extent.x);
    }
    return box;
}

// Triangles that one vector takes, and cells that count_eight can find in them at most.
#define VECTOR 8u
#define MOST_EASY_CELLS (VECTOR * 32u)
#if CLIP_CELLS < 32
#error "count_eight counts the whole boxes of up to 2 x 4 x 4 cells"
#endif

// The ranges of eight triangles, and the counts of those that touch two layers of cells at most, and of each
// one slab alone: nearly all. No branch foretells the number of a triangle's cells. The two layers have
// counters apart, since neighbours add to the same ones, and each addition waits for the last.
// Returns the number of cells counted; `left`: triangles that were not.
ulong count_eight(__constant const GridParams *grid, __global const float *vertices, __global const uint *faces,
                  uint slab_shift, __global uint *ranges, __global ref_index *lower, __global ref_index *upper,
                  bool *left, uint *counted)
{
    const int mx = (int)grid->resolution[0], my = (int)grid->resolution[1];
    const CellRanges8 r = cell_ranges8(grid, vertices, faces);
    const uint8 first = as_uint8((r.z * my + r.y) * mx + r.x);
    const int8 too_long = (r.more_x > 2047) | (r.more_y > 2047) | (r.more_z > MOST_LAYERS);
    const uint8 fitting = as_uint8(r.more_x | r.more_y << 11 | r.more_z << 22);
    const uint8 more = too_long ? (uint8)(RANGE_TOO_LONG) : fitting;
    vstore8((uint8)(first.s0, more.s0, first.s1, more.s1, first.s2, more.s2, first.s3, more.s3), 0, ranges);
    vstore8((uint8)(first.s4, more.s4, first.s5, more.s5, first.s6, more.s6, first.s7, more.s7), 1, ranges);

    const uint8 across = as_uint8(r.more_y * mx + r.more_x);
    const uint8 second = first + as_uint8(r.more_z * (mx * my));
    const uint8 slab0 = first >> slab_shift, slab1 = second >> slab_shift;
    const int8 easy = (r.more_z < 2) & (r.more_x < 4) & (r.more_y < 4) &
                      ((first + across) >> slab_shift == slab0) & ((second + across) >> slab_shift == slab1);
    const int8 cells0 = (r.more_x + 1) * (r.more_y + 1) & easy;
    const int8 cells1 = cells0 & -r.more_z;
    uint s0[VECTOR], s1[VECTOR], n1[VECTOR];
    vstore8(slab0, 0, s0);
    vstore8(slab1 & as_uint8(easy), 0, s1);
    vstore8(as_uint8(cells0), 0, counted);
    vstore8(as_uint8(cells1), 0, n1);
    uint total = 0;
#pragma unroll
    for (uint k = 0; k < VECTOR; ++k) {
        lower[s0[k]] += counted[k];
        upper[s1[k]] += n1[k];
        total += counted[k] + n1[k];
    }
    const int4 halves = easy.lo & easy.hi;
    *left = (halves.x & halves.y & halves.z & halves.w) == 0;
    return total;
}

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void count_references(__constant const GridParams *grid, __global const float *vertices,
                               __global const uint *faces, uint chunk_size, uint slab_shift, uint slabs,
                               ulong most_references, __global uint2 *ranges, __global ref_index *counts,
                               __global ref_index *spare, uint room, __global uint2 *runs, __global ulong *totals)
{
    const uint chunk = get_global_id(0);
    const uint begin = chunk * chunk_size;
    const uint end = min(begin + chunk_size, grid->triangle_count);
    __global ref_index *count = counts + (size_t)chunk * slabs, *other = spare + (size_t)chunk * slabs;
    for (uint s = 0; s < slabs; ++s)
        count[s] = other[s] = 0;
    Kept kept = {runs + (size_t)chunk * room, room, 0};
    ulong total = 0;
    uint i = begin;
    for (; i + VECTOR <= end && total + MOST_EASY_CELLS <= most_references; i += VECTOR) {
        __global const uint *face = faces + 3 * (size_t)i;
        if (i + FETCH_AHEAD + VECTOR <= end)
            fetch_early(vertices, face + 3 * FETCH_AHEAD);
        uint counted[VECTOR];
        bool left;
        total += count_eight(grid, vertices, face, slab_shift, (__global uint *)(ranges + i), count, other, &left,
                             counted);
        if (left)
            for (uint k = 0; k < VECTOR; ++k)
                if (counted[k] == 0)
                    total += count_triangle(grid, vertices, face + 3 * k, cell_range(grid, vertices, face + 3 * k),
                                            most_references - min(total, most_references), slab_shift, count, &kept,
                                            ranges + i + k);
    }
    for (; i < end; ++i) {
        __global const uint *face = faces + 3 * (size_t)i;
        const CellRange range = cell_range(grid, vertices, face);
        ranges[i] = pack_range(range, grid->resolution[0], grid->resolution[1]);
        total += count_triangle(grid, vertices, face, range, most_references - min(total, most_references),
                                slab_shift, count, &kept, ranges + i);
    }
    for (uint s = 0; s < slabs; ++s)
        count[s] += other[s];
    totals[chunk] = total;
}
