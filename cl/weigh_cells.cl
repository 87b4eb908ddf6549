// Nested grids, before they are built: how many triangles are entered in each cell that may get a subgrid, in a sample
// of every `stride`-th triangle.
//   children[cell]             number of its subgrid, plus one, for cells before `parents`
//   weights[item][cell]        of the cells first_cell .. first_cell + cells - 1
#include "ask.h"

typedef struct {
    __global uint *weights;
    uint first, end;      // cells that are weighed
} Visitor;

void visit_run(Visitor *visitor, uint cell, uint end)
{
    for (cell = max(cell, visitor->first); cell < min(end, visitor->end); ++cell)
        ++visitor->weights[cell - visitor->first];
}

#include "nested_cells.h"

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void weigh_cells(__constant const GridParams *grid, __global const float *vertices,
                          __global const uint *faces, uint stride, uint sampled, __global const Subgrid *subgrids,
                          __global const uint *children, uint parents, uint first_cell, uint cells,
                          __global uint *weights)
{
    const uint item = get_global_id(0);
    const ulong share = (sampled + (ulong)get_global_size(0) - 1) / get_global_size(0);
    const uint begin = (uint)min(share * item, (ulong)sampled), end = (uint)min(begin + share, (ulong)sampled);
    __global uint *weight = weights + (size_t)item * cells;
    for (uint i = 0; i < cells; ++i)
        weight[i] = 0;
    const Nest nest = {grid, subgrids, children, parents, vertices};
    Visitor visitor = {weight, first_cell, first_cell + cells};
    for (uint i = begin; i < end; ++i)
        visit_cells(&nest, faces + 3 * (size_t)i * stride, &visitor);
}
