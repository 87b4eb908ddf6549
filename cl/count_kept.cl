// Nested grids: how long the lists are of cells that may have a subgrid, where one that has is a single reference.
//   lists              where each cell's list begins, with its triangles
//   children[cell]     number of its subgrid, plus one; 0: it has none
#include "config.h"

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void count_kept(uint first_cell, uint cells, uint block_size, __global const uint *lists,
                         __global const uint *children, __global ulong *totals)
{
    const uint block = get_global_id(0);
    const uint begin = block * block_size, end = min(begin + block_size, cells);
    ulong total = 0;
    for (uint cell = begin; cell < end; ++cell)
        total += children[first_cell + cell] != 0 ? 1 : lists[cell + 1] - lists[cell];
    totals[block] = total;
}
