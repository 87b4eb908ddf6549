// Nested grids: which cells get a subgrid, and of how many cells, by the lengths of their lists. Those of very many
// triangles get a coarse one, the cells of which may get subgrids in turn.
//   lists[cell - first_cell]             where the cell's list begins
//   halvings[cell - first_cell]          of its subgrid; 0: it gets none
//   totals[block]                        subgrids that are coarse, their cells; others, their cells
#include "nest_plan.h"

// More triangles of a cell of the top grid get a coarse subgrid.
#ifndef CROWDED
#define CROWDED 1024.0f
#endif
#define COARSE_DENSITY 0.125f
// Halvings along an axis: of a coarse subgrid and of one in it, together no more than FINEST.
#define MOST_HALVINGS 5u

// How to halve a cell, longest side first, to get about so many.
uint halvings_for(float wanted, float4 size, uint4 finer)
{
    uint halvings = 0;
    float side[3] = {size.x, size.y, size.z};
    const uint room[3] = {min(finer.x, MOST_HALVINGS), min(finer.y, MOST_HALVINGS), min(finer.z, MOST_HALVINGS)};
    uint used[3] = {0, 0, 0};
    // A halving too many is as bad as one too few.
    for (float cells = 1.0f; cells * 1.42f < wanted; cells *= 2.0f) {
        int axis = -1;
        for (int a = 0; a < 3; ++a)
            if (used[a] < room[a] && side[a] > 2.0f * THINNEST_CELL && (axis < 0 || side[a] > side[axis]))
                axis = a;
        if (axis < 0)
            break;
        side[axis] *= 0.5f;
        ++used[axis];
    }
    return used[0] | used[1] << 4 | used[2] << 8;
}

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void shape_subgrids(__constant const GridParams *grid, __global const Subgrid *subgrids, uint owners,
                             uint first_cell, uint cells, uint block_size, __global const uint *lists, float density,
                             float fewest, __global uint *halvings, __global uint *totals)
{
    const uint block = get_global_id(0);
    uint total[4] = {0, 0, 0, 0};
    uint begin, end;
    block_range(block, block_size, subgrids, owners, cells, &begin, &end);
    Owner owner = first_owner(grid, subgrids, owners, block * block_size);
    for (uint cell = begin; cell < end; ++cell) {
        find_owner(&owner, subgrids, cell);
        const uint at = cell - first_cell;
        const float triangles = (float)(lists[at + 1] - lists[at]);
        uint found = 0;
        if (triangles >= fewest) {
            const bool coarse = owners == 0 && triangles > CROWDED;
            found = halvings_for(triangles * (coarse ? COARSE_DENSITY : density), owner.size, owner.finer);
            if (found != 0) {
                const uint kind = coarse ? 0 : 2;
                ++total[kind];
                total[kind + 1] += cells_of(found);
                found |= coarse ? COARSE : 0u;
            }
        }
        halvings[at] = found;
    }
    for (uint k = 0; k < 4; ++k)
        totals[4 * block + k] = total[k];
}
