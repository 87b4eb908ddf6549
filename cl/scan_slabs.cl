// Build, stage 2: where each chunk writes into each slab. counts becomes the exclusive prefix sum in
// (slab, chunk) order, which keeps triangles ascending within a slab; slab_starts[slabs] is the total.
#include "config.h"

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void scan_slabs(uint chunks, uint slabs, __global ref_index *counts, __global ref_index *slab_starts)
{
    ref_index sum = 0;
    for (uint s = 0; s < slabs; ++s) {
        slab_starts[s] = sum;
        for (uint c = 0; c < chunks; ++c) {
            const ref_index count = counts[(size_t)c * slabs + s];
            counts[(size_t)c * slabs + s] = sum;
            sum += count;
        }
    }
    slab_starts[slabs] = sum;
}
