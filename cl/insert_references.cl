// Compact layout, last stage: one slab becomes a finished piece of the grid, by the paper's count, prefix
// sum and reverse insertion (Lagae & Dutre 2008, section 3): one array is counter, end, then start.
// Walking backwards while the pointers descend leaves every list ascending.
//   full_cells[slab]      cells of the slab that hold a reference
#include "binned.h"
#include "tally.h"

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void insert_references(uint cell_count, uint slab_shift, __global const ref_index *slab_starts,
                                __global const ref_index *ends, uint chunks, uint chunk_size,
                                __global const uint *binned, __global ref_index *cells,
                                __global uint *references, __global uint *full_cells)
{
    const uint slab = get_global_id(0), slabs = get_global_size(0);
    const uint first = slab << slab_shift;
    const uint size = min(cell_count - first, 1u << slab_shift);
    const ref_index begin = slab_starts[slab], end = slab_starts[slab + 1];
    __global ref_index *cell = cells + first;
    for (uint i = 0; i < size; ++i)
        cell[i] = 0;
    // Two parts in turn: neighbours count in the same cells, and wait for each other.
    const ref_index half_number = (end - begin) / 2;
    for (ref_index r = begin; r < begin + half_number; ++r) {
        ++cell[CELL_OF(binned[r])];
        ++cell[CELL_OF(binned[r + half_number])];
    }
    if ((end - begin) & 1)
        ++cell[CELL_OF(binned[end - 1])];
    full_cells[slab] = sum_up(cell, size, begin);
    bring_into_cache(references, begin, end);
    ref_index r = end;
    for (uint chunk = chunks; chunk-- > 0;) {
        const uint first_triangle = chunk * chunk_size;
        const ref_index stop = chunk_begin(ends, chunk, slab, slabs, begin);
        for (; r > stop; --r) {
            const uint entry = binned[r - 1];
            references[--cell[CELL_OF(entry)]] = TRIANGLE_OF(entry, first_triangle);
        }
    }
    if (first + size == cell_count)
        cell[size] = end;
}
