// Dynamic-array layout, last stage: places the arrays of a slab one after another in the pool, and appends
// each reference to its cell's.
//   room_starts[slab]     first entry of the slab's arrays in the pool
//   pointers[cell]        first entry of the cell's array              sizes, capacities: size_arrays.cl
#include "binned.h"

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void append_references(uint cell_count, uint slab_shift, __global const ref_index *slab_starts,
                                __global const ref_index *ends, uint chunks, uint chunk_size,
                                __global const uint *binned,
                                __global const ulong *room_starts, __global ref_index *pointers,
                                __global uint *sizes, __global const uint *capacities, __global uint *pool)
{
    const uint slab = get_global_id(0), slabs = get_global_size(0);
    const uint first = slab << slab_shift;
    const uint size = min(cell_count - first, 1u << slab_shift);
    ref_index at = (ref_index)room_starts[slab];
    for (uint i = first; i < first + size; ++i) {
        pointers[i] = at;
        at += capacities[i];
        sizes[i] = 0;
        // What doubling leaves unused has no meaning, but the same bytes every time.
        if (capacities[i] != 0)
            for (ref_index e = at - capacities[i] / 2; e < at; ++e)
                pool[e] = NO_HIT;
    }
    ref_index r = slab_starts[slab];
    for (uint chunk = 0; chunk < chunks; ++chunk)
        for (; r < ends[(size_t)chunk * slabs + slab]; ++r) {
            const uint cell = first + CELL_OF(binned[r]);
            pool[pointers[cell] + sizes[cell]++] = TRIANGLE_OF(binned[r], chunk * chunk_size);
        }
}
