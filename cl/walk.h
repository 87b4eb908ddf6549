// The walk of a ray from cell to cell (after Amanatides & Woo 1987) in fixed point: sums of integers are exact, so
// that a step is a comparison and an addition, and walks by cells and by bricks of cells agree to the last
// bit. Plane k of axis a lies at lower[a] + k * cell_size[a], for the build and the walk alike; a cell is closed.
#ifndef CLG_WALK_H
#define CLG_WALK_H
#include "ray.h"

// Ticks of a local unit of t. A ray is in the grid for little more than 4 units; what takes it more than
// MOST_TICKS does not matter, and four times that is a long.
#ifdef NESTED
// Paces are those of cells 2^FINEST times as large as the planes that are counted.
#define TICKS 0x1p+48
#define MOST_TICKS 0x1p+51
#else
#define TICKS 0x1p+54
#define MOST_TICKS 0x1p+57
#endif

// A component as the walk takes it: one that climbs less crosses no plane within reach, and 1 / d may overflow.
#define SMALLEST_CLIMB 0x1p-200

typedef struct {
    long x, y, z;
} Ticks;

// A ray's way through the grid, in ticks from where it comes in.
typedef struct {
    Ticks next;             // when it crosses the next plane of each axis
    Ticks pace;             // from plane to plane
    long stop;              // nothing from then on matters
    double t_in;            // t at tick 0
    int4 cell;              // where it comes in
    bool up_x, up_y, up_z;  // whether it climbs
} Walk;

long least_tick(const Ticks *t)
{
    const long m = t->x < t->y ? t->x : t->y;
    return m < t->z ? m : t->z;
}

// Crosses the plane that is due, one of those if there are several, by masks: which axis is next cannot be foretold by
// a branch, and compilers would compare and select pairs of axes in vectors, which takes three times as long.
// What a step across that axis adds, of x, y and z.
long step_over(Ticks *next, const Ticks *pace, long x, long y, long z)
{
    const long by_x = (next->x - next->y) >> 63;
    const long first = next->y + ((next->x - next->y) & by_x);
    const long not_z = (first - next->z) >> 63;
    next->x += pace->x & by_x & not_z;
    next->y += pace->y & ~by_x & not_z;
    next->z += pace->z & ~not_z;
    return (x & by_x & not_z) | (y & ~by_x & not_z) | (z & ~not_z);
}

// The first tick that is later than t.
long tick_after(const Walk *walk, double t)
{
    return (long)(fmin(fmax(t - walk->t_in, -1.0), MOST_TICKS / TICKS) * TICKS) + 1;
}

double t_of_tick(const Walk *walk, long tick)
{
    return walk->t_in + (double)tick * (1.0 / TICKS);
}

#ifdef NESTED
// Planes of the finest cells between one of them and the end of the cell of the top grid that holds it.
long finest_ahead(int cell, bool up)
{
    const int within = cell & ((1 << FINEST) - 1);
    return up ? (1 << FINEST) - 1 - within : within;
}

// From the planes of the finest cells to those of the top grid, which are every 2^FINEST-th of them.
void coarsen(Walk *walk)
{
    walk->next.x += walk->pace.x * finest_ahead(walk->cell.x, walk->up_x);
    walk->next.y += walk->pace.y * finest_ahead(walk->cell.y, walk->up_y);
    walk->next.z += walk->pace.z * finest_ahead(walk->cell.z, walk->up_z);
    walk->pace.x <<= FINEST;
    walk->pace.y <<= FINEST;
    walk->pace.z <<= FINEST;
    walk->cell >>= FINEST;
}
#endif

#endif
