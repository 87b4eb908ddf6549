// Cells that may get a subgrid: those of the top grid, or of coarse subgrids, which follow one another. Blocks of so
// many cells of the top grid, or of so many subgrids, are a work-item each.
#ifndef CLG_NEST_PLAN_H
#define CLG_NEST_PLAN_H
#include "subgrid.h"

// Marks the halvings of a subgrid whose cells may get subgrids.
#define COARSE 0x1000u
// Narrower cells would hold every neighbour's triangles.
#define THINNEST_CELL (8.0f * (float)BOX_PAD)

// What cells are part of.
typedef struct {
    uint number, end;     // of its first cell, and one past its last
    uint subgrid;         // its own number, if it is one
    uint4 finer;
    int4 first;           // where its first cell is
    uint along_x, along_y;
    float4 size, whole;   // of a cell; of one of the top grid
} Owner;

uint cells_of(uint halvings)
{
    return 1u << ((halvings & 15u) + (halvings >> 4 & 15u) + (halvings >> 8 & 15u));
}

void block_range(uint block, uint block_size, __global const Subgrid *subgrids, uint owners, uint cells,
                 uint *begin, uint *end)
{
    if (owners == 0) {
        *begin = min(block * block_size, cells);
        *end = min(*begin + block_size, cells);
        return;
    }
    const uint first = block * block_size, last = min(first + block_size, owners) - 1;
    *begin = subgrids[first].first_cell;
    *end = subgrids[last].first_cell + cells_of(subgrids[last].halvings);
}

void own(Owner *owner, __global const Subgrid *subgrid)
{
    owner->number = subgrid->first_cell;
    owner->end = subgrid->first_cell + cells_of(subgrid->halvings);
    owner->finer = (uint4)(finer_than(subgrid, 0), finer_than(subgrid, 1), finer_than(subgrid, 2), 0);
    owner->first = (int4)(subgrid->first[0], subgrid->first[1], subgrid->first[2], 0);
    owner->along_x = 1u << halvings_of(subgrid, 0);
    owner->along_y = 1u << halvings_of(subgrid, 1);
    owner->size = owner->whole / convert_float4((uint4)(1) << ((uint4)(FINEST, FINEST, FINEST, 0) - owner->finer));
}

// The top grid, or coarse subgrid `number`.
Owner first_owner(__constant const GridParams *grid, __global const Subgrid *subgrids, uint owners, uint number)
{
    Owner owner;
    owner.whole = (float4)((float)grid->cell_size[0], (float)grid->cell_size[1], (float)grid->cell_size[2], 1.0f);
    owner.subgrid = number;
    if (owners != 0) {
        own(&owner, subgrids + number);
        return owner;
    }
    owner.number = 0;
    owner.end = 0xFFFFFFFFu;
    owner.finer = (uint4)(FINEST, FINEST, FINEST, 0);
    owner.first = (int4)(0);
    owner.along_x = grid->resolution[0];
    owner.along_y = grid->resolution[1];
    owner.size = owner.whole;
    return owner;
}

// Goes on to the next one if the cell is that one's.
void find_owner(Owner *owner, __global const Subgrid *subgrids, uint cell)
{
    if (cell >= owner->end)
        own(owner, subgrids + ++owner->subgrid);
}

// Where a cell is, in cells of its size from the grid's lower corner.
int4 place_in(const Owner *owner, uint cell)
{
    const uint within = cell - owner->number, row = within / owner->along_x;
    return owner->first + (int4)((int)(within % owner->along_x), (int)(row % owner->along_y), (int)(row / owner->along_y), 0);
}

#endif
