// Nested grids: how many triangles each cell of some subgrids gets, out of the list of the cell that the subgrid is in.
//   lists, entries     of the cells from first_cell on: where each one's list begins, and all lists
//   parents[subgrid]   the cell that it is in
//   marks[entry]       where the triangle is entered in the cell's subgrid (subgrid_cells.h)
//   counts             by cell, from first_counted on
//   totals[block]      of a block of subgrids
#include "subgrid_cells.h"

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void count_subgrids(__constant const GridParams *grid, __global const float *vertices,
                             __global const uint *faces, __global const Subgrid *subgrids,
                             __global const uint *parents, uint first_subgrid, uint end_subgrid, uint block_size,
                             uint first_cell, __global const uint *lists, __global const uint *entries,
                             __global ulong *marks, uint first_counted, __global uint *counts,
                             __global ulong *totals)
{
    const uint block = get_global_id(0);
    const uint begin = first_subgrid + block * block_size, end = min(begin + block_size, end_subgrid);
    ulong total = 0;
    for (uint k = begin; k < end; ++k) {
        Part part = part_of(grid, subgrids + k);
        part.number -= first_counted;
        const uint cells = (uint)(part.cells.x * part.cells.y * part.cells.z);
        for (uint i = 0; i < cells; ++i)
            counts[part.number + i] = 0;
        const uint from = lists[parents[k] - first_cell], to = lists[parents[k] - first_cell + 1];
        for (uint i = from; i < to; i += 8) {
            const uint count = min(to - i, 8u);
            for (uint j = i + 16; j < min(i + 24, to); ++j)
                ask_for(faces + 3 * (size_t)entries[j]);
            for (uint j = i + 8; j < min(i + 16, to); ++j)
                for (uint corner = 0; corner < 3; ++corner)
                    ask_for(vertices + 3 * (size_t)faces[3 * (size_t)entries[j] + corner]);
            ulong found[8];
            mark_eight(&part, vertices, faces, entries + i, count, found);
            for (uint j = 0; j < count; ++j) {
                marks[i + j] = found[j];
                const Entry entry = {found[j], entries[i + j], vertices, faces};
                total += count_entry(&part, &entry, counts);
            }
        }
    }
    totals[block] = total;
}
