// Nested grids: the lists of the cells of some subgrids, by prefix sum and reverse insertion as insert_references.cl.
// Parameters as those of count_subgrids.cl, and
//   starts[block]        where the block's lists begin in `references`
//   counts               counts become beginnings of lists
//   full_cells[block]    cells that have a list
#include "subgrid_cells.h"
#include "tally.h"

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void fill_subgrids(__constant const GridParams *grid, __global const float *vertices,
                            __global const uint *faces, __global const Subgrid *subgrids,
                            __global const uint *parents, uint first_subgrid, uint end_subgrid, uint block_size,
                            uint first_cell, __global const uint *lists, __global const uint *entries,
                            __global const ulong *marks, uint first_counted, __global uint *counts,
                            __global const uint *starts, __global uint *references, __global uint *full_cells)
{
    const uint block = get_global_id(0);
    const uint begin = first_subgrid + block * block_size, end = min(begin + block_size, end_subgrid);
    uint at = starts[block], full = 0;
    for (uint k = begin; k < end; ++k) {
        Part part = part_of(grid, subgrids + k);
        part.number -= first_counted;
        const uint cells = (uint)(part.cells.x * part.cells.y * part.cells.z);
        full += sum_up(counts + part.number, cells, at);
        at = counts[part.number + cells - 1];
        const uint from = lists[parents[k] - first_cell], to = lists[parents[k] - first_cell + 1];
        for (uint i = to; i-- > from;) {
            const Entry entry = {marks[i], entries[i], vertices, faces};
            fill_entry(&part, &entry, counts, references);
        }
    }
    full_cells[block] = full;
}
