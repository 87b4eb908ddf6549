// Nested grids, hashed: the beginnings of full cells' lists, slab by slab, in the order of cells.
//   table_starts[slab]    first slot of the slab's table
#include "config.h"

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void fill_table(uint cell_count, uint slab_shift, __global const uint *begins,
                         __global const uint *table_starts, __global uint *table)
{
    const uint slab = get_global_id(0);
    const uint first = slab << slab_shift, end = min(cell_count, first + (1u << slab_shift));
    uint slot = table_starts[slab];
    for (uint cell = first; cell < end; ++cell)
        if (begins[cell + 1] != begins[cell])
            table[slot++] = begins[cell];
    if (end == cell_count)
        table[slot] = begins[end];
}
