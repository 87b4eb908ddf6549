// Hashed layout, last stage: the compact grid's count, prefix sum and reverse insertion over the slots of
// the slab's table instead of its cells, so that lists lie in table order and a length is a difference.
// An unused slot holds no list: its start is that of the next.
//   table_starts[slab]    first slot of the slab's table, [slabs] is their number
//   table[slot]           where the slot's list starts, [slots] is the number of references
#include "config.h"

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void insert_hashed(uint slab_shift, uint slabs, __global const ref_index *slab_starts,
                            __global ushort *binned_cells, __global const uint *binned_triangles,
                            __global const ulong *domain, __global const ushort *offsets,
                            __global const uint *table_starts,
                            __global ref_index *table, __global uint *references)
{
    const uint slab = get_global_id(0);
    const ref_index begin = slab_starts[slab], end = slab_starts[slab + 1];
    const uint size = table_starts[slab + 1] - table_starts[slab];
    __global ref_index *slot = table + table_starts[slab];
    const uint first_row = (slab << slab_shift) >> ROW_SHIFT;
    for (uint i = 0; i < size; ++i)
        slot[i] = 0;
    for (ref_index r = begin; r < end; ++r) {
        const uint row = first_row + (binned_cells[r] >> ROW_SHIFT), x = binned_cells[r] & (ROW_CELLS - 1);
        const ushort at = (ushort)(offsets[row] + SLOT_IN_ROW(domain[row], x));
        binned_cells[r] = at;
        ++slot[at];
    }
    ref_index sum = begin;
    for (uint i = 0; i < size; ++i) {
        sum += slot[i];
        slot[i] = sum;
    }
    for (ref_index r = end; r > begin; --r)
        references[--slot[binned_cells[r - 1]]] = binned_triangles[r - 1];
    if (slab + 1 == slabs)
        slot[size] = end;
}
