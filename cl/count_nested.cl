// Build of a nested grid: how many references fall into each slab, as count_references.cl. Work-items from `chunks` on
// count the references that stand for subgrids, chunk_size of them each.
//   parents[subgrid]           the cell that it takes the place of
//   counts[chunk][slab]        references of the chunk in the slab
//   totals[chunk]              references of the chunk; more than most_references where there are so many
#include "ask.h"

typedef struct {
    __global uint *counts;
    uint slab_shift;
    ulong total;
} Visitor;

void visit_run(Visitor *visitor, uint cell, uint end)
{
    visitor->total += end - cell;
    while (cell < end) {
        const uint slab = cell >> visitor->slab_shift;
        const uint slab_end = min(end, (slab + 1) << visitor->slab_shift);
        visitor->counts[slab] += slab_end - cell;
        cell = slab_end;
    }
}

#include "nested_cells.h"

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void count_nested(__constant const GridParams *grid, __global const float *vertices,
                           __global const uint *faces, uint chunks, uint chunk_size, uint slab_shift, uint slabs,
                           ulong most_references, __global const Subgrid *subgrids, __global const uint *parents,
                           uint subgrid_count, __global const uint *children, uint parent_cells,
                           __global uint *counts, __global ulong *totals)
{
    const uint chunk = get_global_id(0);
    __global uint *count = counts + (size_t)chunk * slabs;
    for (uint s = 0; s < slabs; ++s)
        count[s] = 0;
    Visitor visitor = {count, slab_shift, 0};
    if (chunk < chunks) {
        const Nest nest = {grid, subgrids, children, parent_cells, vertices};
        const uint begin = chunk * chunk_size, end = min(begin + chunk_size, grid->triangle_count);
        for (uint i = begin; i < end && visitor.total <= most_references; ++i) {
            if (i % 8 == 0 && i + FETCH_AHEAD + 8 <= end)
                fetch_early(vertices, faces + 3 * (size_t)(i + FETCH_AHEAD));
            visit_cells(&nest, faces + 3 * (size_t)i, &visitor);
        }
    } else {
        const uint begin = (chunk - chunks) * chunk_size, end = min(begin + chunk_size, subgrid_count);
        for (uint k = begin; k < end; ++k)
            visit_run(&visitor, parents[k], parents[k] + 1);
    }
    totals[chunk] = visitor.total;
}
