// Nested grids: the lists that count_kept.cl counts, from starts[block] on.
//   entries            the lists with their triangles
//   full_cells[block]  cells that have a list
#include "config.h"

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void fill_kept(uint first_cell, uint cells, uint block_size, __global const uint *lists,
                        __global const uint *entries, __global const uint *children, uint first_subgrid,
                        __global const uint *starts, __global uint *begins, __global uint *references,
                        __global uint *full_cells)
{
    const uint block = get_global_id(0);
    const uint begin = block * block_size, end = min(begin + block_size, cells);
    uint at = starts[block], full = 0;
    for (uint cell = begin; cell < end; ++cell) {
        const uint child = children[first_cell + cell];
        begins[first_cell + cell] = at;
        if (child != 0) {
            references[at++] = first_subgrid + (child - 1);
            ++full;
        } else {
            full += lists[cell + 1] != lists[cell];
            for (uint i = lists[cell]; i < lists[cell + 1]; ++i)
                references[at++] = entries[i];
        }
    }
    full_cells[block] = full;
}
