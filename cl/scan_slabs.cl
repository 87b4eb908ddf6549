// Build, stage 2: where each chunk writes into each slab, from `starts` to `ends`: the exclusive and the
// inclusive prefix sum in (slab, chunk) order, which keeps triangles ascending within a slab.
// `ends` holds the counts before; slab_starts[slabs] is the total.
#include "config.h"

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void scan_slabs(uint chunks, uint slabs, __global ref_index *ends, __global ref_index *starts,
                         __global ref_index *slab_starts)
{
    ref_index sum = 0;
    for (uint s = 0; s < slabs; ++s) {
        slab_starts[s] = sum;
        for (uint c = 0; c < chunks; ++c) {
            const size_t at = (size_t)c * slabs + s;
            starts[at] = sum;
            sum += ends[at];
            ends[at] = sum;
        }
    }
    slab_starts[slabs] = sum;
}
