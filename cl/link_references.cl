// Linked-list layout, last stage: a node per reference, of which the binned references become one half.
// Nodes are pushed on their cell's list from the last to the first, so that lists ascend.
//   binned[node]          becomes its triangle
//   heads[cell]           first node of the cell's list, or NO_REFERENCE
//   next[node]            the node after it, or NO_REFERENCE       full_cells[slab]   cells with a list
#include "binned.h"

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void link_references(uint cell_count, uint slab_shift, __global const ref_index *slab_starts,
                              __global const ref_index *ends, uint chunks, uint chunk_size,
                              __global uint *binned, __global ref_index *heads,
                              __global ref_index *next, __global uint *full_cells)
{
    const uint slab = get_global_id(0), slabs = get_global_size(0);
    const uint first = slab << slab_shift;
    const uint size = min(cell_count - first, 1u << slab_shift);
    __global ref_index *head = heads + first;
    for (uint i = 0; i < size; ++i)
        head[i] = NO_REFERENCE;
    uint full = 0;
    ref_index r = slab_starts[slab + 1];
    for (uint chunk = chunks; chunk-- > 0;) {
        const uint first_triangle = chunk * chunk_size;
        const ref_index stop = chunk_begin(ends, chunk, slab, slabs, slab_starts[slab]);
        for (; r > stop; --r) {
            const uint entry = binned[r - 1], cell = CELL_OF(entry);
            binned[r - 1] = TRIANGLE_OF(entry, first_triangle);
            full += head[cell] == NO_REFERENCE;
            next[r - 1] = head[cell];
            head[cell] = r - 1;
        }
    }
    full_cells[slab] = full;
}
