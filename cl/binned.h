// References sorted by slab, in four bytes each: the triangle within its chunk above the cell within its slab.
#ifndef CLG_BINNED_H
#define CLG_BINNED_H
#include "config.h"

#define CELL_BITS 16u
#define CELL_OF(entry) ((entry) & 0xFFFFu)
#define TRIANGLE_OF(entry, first_of_chunk) ((first_of_chunk) + ((entry) >> CELL_BITS))

// Where a chunk's references in the slab begin; `ends` is [chunk][slab], and `begin` the slab's first.
ref_index chunk_begin(__global const ref_index *ends, uint chunk, uint slab, uint slabs, ref_index begin)
{
    return chunk == 0 ? begin : ends[(size_t)(chunk - 1) * slabs + slab];
}

// Before lists are written in no order: stores that miss wait for each other, and a prefetch gains less.
void bring_into_cache(__global uint *references, ref_index begin, ref_index end)
{
    for (ref_index r = begin; r < end; ++r)
        references[r] = 0;
}

#endif
