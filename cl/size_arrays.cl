// Dynamic-array layout, counting: the size of each cell's array, and its capacity, which is what doubling
// would leave: the next power of two.
//   room[slab]            entries that the slab's arrays need        full_cells[slab]   cells with an array
#include "binned.h"

uint next_power_of_two(uint n)
{
    return n < 2 ? n : 1u << (32u - clz(n - 1));
}

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void size_arrays(uint cell_count, uint slab_shift, __global const ref_index *slab_starts,
                          __global const uint *binned, __global uint *sizes,
                          __global uint *capacities, __global ulong *room, __global uint *full_cells)
{
    const uint slab = get_global_id(0);
    const uint first = slab << slab_shift;
    const uint size = min(cell_count - first, 1u << slab_shift);
    for (uint i = 0; i < size; ++i)
        sizes[first + i] = 0;
    for (ref_index r = slab_starts[slab]; r < slab_starts[slab + 1]; ++r)
        ++sizes[first + CELL_OF(binned[r])];
    ulong sum = 0;
    uint full = 0;
    for (uint i = first; i < first + size; ++i) {
        capacities[i] = next_power_of_two(sizes[i]);
        sum += capacities[i];
        full += sizes[i] != 0;
    }
    room[slab] = sum;
    full_cells[slab] = full;
}
