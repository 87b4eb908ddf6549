// Empty-space skipping: a byte for each brick of BRICK^3 cells says how many bricks away the nearest reference is.
// The ray walks from brick to brick, and by cells only where that is 0; both walks are the same to the tick.
#ifndef CLG_LEAP_H
#define CLG_LEAP_H
#include "walk.h"

typedef struct {
    Ticks next;        // when the ray leaves the brick across each axis
    long place;        // the brick's first cell * 2^32 + the brick's number
    long x, y, z;      // what a step across each axis adds to that
} Bricks;

// Planes between the cell and the end of its brick, as if every brick were whole.
long planes_ahead(int cell, bool up)
{
    const int within = cell & ((int)BRICK - 1);
    return up ? (int)BRICK - 1 - within : within;
}

Bricks bricks_of(const Walk *walk, __constant const GridParams *grid)
{
    const long mx = grid->resolution[0], my = grid->resolution[1];
    const long across = (mx + BRICK - 1) / BRICK, deep = (my + BRICK - 1) / BRICK;
    const long x = ((long)BRICK << 32) + 1;
    const long y = (BRICK * mx << 32) + across;
    const long z = (BRICK * mx * my << 32) + across * deep;
    Bricks b;
    b.next.x = walk->next.x + walk->pace.x * planes_ahead(walk->cell.x, walk->up_x);
    b.next.y = walk->next.y + walk->pace.y * planes_ahead(walk->cell.y, walk->up_y);
    b.next.z = walk->next.z + walk->pace.z * planes_ahead(walk->cell.z, walk->up_z);
    b.place = walk->cell.x / (int)BRICK * x + walk->cell.y / (int)BRICK * y + walk->cell.z / (int)BRICK * z;
    b.x = walk->up_x ? x : -x;
    b.y = walk->up_y ? y : -y;
    b.z = walk->up_z ? z : -z;
    return b;
}

uint brick_number(const Bricks *b)
{
    return (uint)b->place;
}

// Into the next brick.
void leave_brick(Bricks *b, const Walk *walk)
{
    const Ticks pace = {walk->pace.x * (long)BRICK, walk->pace.y * (long)BRICK, walk->pace.z * (long)BRICK};
    b->place += step_over(&b->next, &pace, b->x, b->y, b->z);
}

// Leaves an empty brick at `distance` of the nearest full one, at tick `due`, and those that it tells to be empty: all
// within so many steps, less one. The tick at which the next brick is entered.
long leave_empty(Bricks *b, const Walk *walk, uint distance, long due)
{
    leave_brick(b, walk);
    for (; distance > 1 && due < walk->stop; --distance) {
        due = least_tick(&b->next);
        leave_brick(b, walk);
    }
    return due;
}

// Of the three planes inside the brick, those that are crossed after `tick`.
int planes_after(long tick, long leaves, long pace)
{
    return (leaves - pace > tick ? 1 : 0) + (leaves - 2 * pace > tick ? 1 : 0) + (leaves - 3 * pace > tick ? 1 : 0);
}

// The cell of the brick in which the ray is at `tick`, and when it crosses its planes.
uint enter_brick(const Bricks *b, const Walk *walk, __constant const GridParams *grid, long tick, Ticks *next)
{
    const int x = planes_after(tick, b->next.x, walk->pace.x);
    const int y = planes_after(tick, b->next.y, walk->pace.y);
    const int z = planes_after(tick, b->next.z, walk->pace.z);
    next->x = b->next.x - x * walk->pace.x;
    next->y = b->next.y - y * walk->pace.y;
    next->z = b->next.z - z * walk->pace.z;
    const uint last = BRICK - 1;
    return (uint)(b->place >> 32) + (walk->up_x ? last - x : x)
           + ((walk->up_y ? last - y : y) + (walk->up_z ? last - z : z) * grid->resolution[1]) * grid->resolution[0];
}

#endif
