// Nested grids: numbers the subgrids that shape_subgrids.cl found, and their cells.
//   halvings[cell]     of its subgrid; 0: it has none
//   starts[block]      numbers of the block's first coarse subgrid, of that one's first cell; the same for the others
//   children[cell]     number of its subgrid, plus one
//   parents[subgrid]   the cell that it is in
#include "nest_plan.h"

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void place_subgrids(__constant const GridParams *grid, uint owners, uint first_cell, uint cells,
                             uint block_size, __global const uint *halvings, __global const uint *starts,
                             __global Subgrid *subgrids, __global uint *children, __global uint *parents)
{
    const uint block = get_global_id(0);
    uint next[4], begin, end;
    for (uint k = 0; k < 4; ++k)
        next[k] = starts[4 * block + k];
    block_range(block, block_size, subgrids, owners, cells, &begin, &end);
    Owner owner = first_owner(grid, subgrids, owners, block * block_size);
    for (uint cell = begin; cell < end; ++cell) {
        find_owner(&owner, subgrids, cell);
        const uint found = halvings[cell - first_cell], own = found & ~COARSE;
        children[cell] = 0;
        if (own == 0)
            continue;
        const uint kind = found & COARSE ? 0 : 2;
        const uint number = next[kind]++;
        const uint of[3] = {own & 15u, own >> 4 & 15u, own >> 8 & 15u};
        const int4 place = place_in(&owner, cell);
        const int at[3] = {place.x, place.y, place.z};
        const uint finer[3] = {owner.finer.x - of[0], owner.finer.y - of[1], owner.finer.z - of[2]};
        Subgrid subgrid;
        subgrid.first_cell = next[kind + 1];
        subgrid.halvings = own | finer[0] << 12 | finer[1] << 16 | finer[2] << 20;
        for (int a = 0; a < 3; ++a)
            subgrid.first[a] = at[a] << of[a];
        next[kind + 1] += cells_of(own);
        subgrids[number] = subgrid;
        parents[number] = cell;
        children[cell] = number + 1;
    }
}
