// Build of a nested grid: every reference goes to its slab, as bin_references.cl; those that stand for subgrids come
// after those of triangles.
// starts[chunk][slab] is the chunk's write position in the slab, and advances to where the next chunk's is.
#include "binned.h"

typedef struct {
    __global uint *position;
    __global uint *entries;
    uint slab_shift, within_chunk;
} Visitor;

void visit_run(Visitor *visitor, uint cell, uint end)
{
    const uint within = (1u << visitor->slab_shift) - 1u;
    for (; cell < end; ++cell) {
        const uint at = visitor->position[cell >> visitor->slab_shift]++;
        visitor->entries[at] = visitor->within_chunk << CELL_BITS | (cell & within);
    }
}

#include "nested_cells.h"

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void bin_nested(__constant const GridParams *grid, __global const float *vertices,
                         __global const uint *faces, uint chunks, uint chunk_size, uint slab_shift, uint slabs,
                         __global const Subgrid *subgrids, __global const uint *parents, uint subgrid_count,
                         __global const uint *children, uint parent_cells, __global uint *starts,
                         __global uint *binned)
{
    const uint chunk = get_global_id(0);
    Visitor visitor = {starts + (size_t)chunk * slabs, binned, slab_shift, 0};
    if (chunk < chunks) {
        const Nest nest = {grid, subgrids, children, parent_cells, vertices};
        const uint begin = chunk * chunk_size, end = min(begin + chunk_size, grid->triangle_count);
        for (uint i = begin; i < end; ++i) {
            if (i % 8 == 0 && i + FETCH_AHEAD + 8 <= end)
                fetch_early(vertices, faces + 3 * (size_t)(i + FETCH_AHEAD));
            visitor.within_chunk = i - begin;
            visit_cells(&nest, faces + 3 * (size_t)i, &visitor);
        }
    } else {
        const uint begin = (chunk - chunks) * chunk_size, end = min(begin + chunk_size, subgrid_count);
        for (uint k = begin; k < end; ++k) {
            visitor.within_chunk = k - begin;
            visit_run(&visitor, parents[k], parents[k] + 1);
        }
    }
}
