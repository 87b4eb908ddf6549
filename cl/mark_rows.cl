// Nested grids, hashed: the bits of full cells, and where each row's slots begin in its slab's table. Every row has its
// slots for itself (DENSE_ROW 0), in the order of cells.
//   begins[cell]      where the cell's list begins
//   slots[slab]       full cells
#include "config.h"

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void mark_rows(uint cell_count, uint slab_shift, __global const uint *begins, __global ulong *domain,
                        __global ushort *offsets, __global uint *slots)
{
    const uint slab = get_global_id(0);
    const uint first = slab << slab_shift, end = min(cell_count, first + (1u << slab_shift));
    uint used = 0;
    for (uint row = first; row < end; row += ROW_CELLS) {
        ulong bits = 0;
        for (uint cell = row; cell < min(row + ROW_CELLS, end); ++cell)
            bits |= (ulong)(begins[cell + 1] != begins[cell]) << (cell - row);
        domain[row >> ROW_SHIFT] = bits;
        offsets[row >> ROW_SHIFT] = (ushort)used;
        used += (uint)popcount(bits);
    }
    slots[slab] = used;
}
