// Nested grids: a ray's way down into a subgrid and up again. All planes of all levels are planes of the finest cells
// there can be, and are crossed at their ticks, so that a cell of any level is left at the very tick at which the next
// one is entered (docs/numerics.md, "Nested grids").
#ifndef CLG_DESCENT_H
#define CLG_DESCENT_H
#include "subgrid.h"
#include "walk.h"

// Grids that a ray is in at once: the top grid, and subgrids each in a cell of the one before.
#define MOST_LEVELS 3

// A ray in one of them.
typedef struct {
    Ticks next, pace;
    uint cell;
    uint x, y, z;      // what a step across each axis adds to the cell
    long left;         // when the grid is left
} Level;

Level top_level(const Walk *walk, __constant const GridParams *grid)
{
    const uint mx = grid->resolution[0], layer = mx * grid->resolution[1];
    Level top;
    top.next = walk->next;
    top.pace = walk->pace;
    top.cell = ((uint)walk->cell.z * grid->resolution[1] + (uint)walk->cell.y) * mx + (uint)walk->cell.x;
    top.x = walk->up_x ? 1u : -1u;
    top.y = walk->up_y ? mx : -mx;
    top.z = walk->up_z ? layer : -layer;
    top.left = LONG_MAX;
    return top;
}

// Of the planes inside a cell that is left at tick `leaves`, those that are crossed after `tick`; there is one every
// `pace`, and 2^halvings - 1 in all.
uint inner_planes_after(long tick, long leaves, long pace, uint halvings)
{
    long left = leaves - tick;
    uint planes = 0;
    for (uint bit = halvings; bit-- > 0;) {
        const long far = pace << bit;
        const long is_ahead = (far - left) >> 63;
        left -= far & is_ahead;
        planes += (1u << bit) & (uint)is_ahead;
    }
    return planes;
}

// Into the subgrid of the cell where the ray is, at `tick`.
Level enter_subgrid(const Level *around, const Walk *walk, __global const Subgrid *subgrid, long tick)
{
    const uint of_x = halvings_of(subgrid, 0), of_y = halvings_of(subgrid, 1), of_z = halvings_of(subgrid, 2);
    Level in;
    in.pace.x = around->pace.x >> of_x;
    in.pace.y = around->pace.y >> of_y;
    in.pace.z = around->pace.z >> of_z;
    const uint x = inner_planes_after(tick, around->next.x, in.pace.x, of_x);
    const uint y = inner_planes_after(tick, around->next.y, in.pace.y, of_y);
    const uint z = inner_planes_after(tick, around->next.z, in.pace.z, of_z);
    in.next.x = around->next.x - x * in.pace.x;
    in.next.y = around->next.y - y * in.pace.y;
    in.next.z = around->next.z - z * in.pace.z;
    in.cell = subgrid->first_cell + (walk->up_x ? (1u << of_x) - 1u - x : x)
              + ((walk->up_y ? (1u << of_y) - 1u - y : y) << of_x)
              + ((walk->up_z ? (1u << of_z) - 1u - z : z) << (of_x + of_y));
    in.x = walk->up_x ? 1u : -1u;
    in.y = walk->up_y ? 1u << of_x : -(1u << of_x);
    in.z = walk->up_z ? 1u << (of_x + of_y) : -(1u << (of_x + of_y));
    in.left = least_tick(&around->next);
    return in;
}

#endif
