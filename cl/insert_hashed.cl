// Hashed layout, last stage: the compact grid's count, prefix sum and reverse insertion over the slots of
// the slab's table instead of its cells, so that lists lie in table order and a length is a difference.
// An unused slot holds no list: its start is that of the next.
//   table_starts[slab]    first slot of the slab's table, [slabs] is their number
//   table[slot]           where the slot's list starts, [slots] is the number of references
#include "binned.h"

// The slot of an entry's cell, which takes the cell's place.
uint find_slot(__global uint *entry, __global const ulong *domain, __global const ushort *offsets)
{
    const uint whole = *entry, cell = CELL_OF(whole);
    const uint row = cell >> ROW_SHIFT, x = cell & (ROW_CELLS - 1);
    const ushort slot = (ushort)(offsets[row] + SLOT_IN_ROW(domain[row], x));
    *entry = whole - cell + slot;
    return slot;
}

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void insert_hashed(uint slab_shift, __global const ref_index *slab_starts,
                            __global const ref_index *ends, uint chunks, uint chunk_size, __global uint *binned,
                            __global const ulong *domain, __global const ushort *offsets,
                            __global const uint *table_starts,
                            __global ref_index *table, __global uint *references)
{
    const uint slab = get_global_id(0), slabs = get_global_size(0);
    const ref_index begin = slab_starts[slab], end = slab_starts[slab + 1];
    const uint size = table_starts[slab + 1] - table_starts[slab];
    __global ref_index *slot = table + table_starts[slab];
    const uint first_row = (slab << slab_shift) >> ROW_SHIFT;
    __global const ulong *row_word = domain + first_row;
    __global const ushort *offset = offsets + first_row;
    for (uint i = 0; i < size; ++i)
        slot[i] = 0;
    const ref_index half_number = (end - begin) / 2;
    for (ref_index r = begin; r < begin + half_number; ++r) {
        ++slot[find_slot(binned + r, row_word, offset)];
        ++slot[find_slot(binned + r + half_number, row_word, offset)];
    }
    if ((end - begin) & 1)
        ++slot[find_slot(binned + end - 1, row_word, offset)];
    ref_index sum = begin;
    for (uint i = 0; i < size; ++i) {
        sum += slot[i];
        slot[i] = sum;
    }
    bring_into_cache(references, begin, end);
    ref_index r = end;
    for (uint chunk = chunks; chunk-- > 0;) {
        const uint first_triangle = chunk * chunk_size;
        const ref_index stop = chunk_begin(ends, chunk, slab, slabs, begin);
        for (; r > stop; --r) {
            const uint entry = binned[r - 1];
            references[--slot[CELL_OF(entry)]] = TRIANGLE_OF(entry, first_triangle);
        }
    }
    if (slab + 1 == slabs)
        slot[size] = end;
}
