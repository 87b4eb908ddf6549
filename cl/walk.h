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

double least_axis(double4 v)
{
    const double m = v.x < v.y ? v.x : v.y;
    return m < v.z ? m : v.z;
}

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

// Enters the grid, with the tests' t in [t_first, t_last]. False: the ray misses it.
bool enter_grid(const Ray *ray, __constant const GridParams *grid, double t_first, double t_last, Walk *walk)
{
    const double4 lower = (double4)(grid->lower[0], grid->lower[1], grid->lower[2], 0.0);
    const double4 upper = (double4)(grid->upper[0], grid->upper[1], grid->upper[2], 1.0);
#ifdef NESTED
    const double finer = 1.0 / (double)(1 << FINEST);
#else
    const double finer = 1.0;
#endif
    const double4 size = finer * (double4)(grid->cell_size[0], grid->cell_size[1], grid->cell_size[2], 1.0);
    const double4 o = (double4)(ray->origin[0], ray->origin[1], ray->origin[2], 0.0);
    const double4 given = (double4)(ray->direction[0], ray->direction[1], ray->direction[2], 1.0);
    const double4 d = fabs(given) < SMALLEST_CLIMB ? (double4)(SMALLEST_CLIMB) : given;
    const double4 inverse = 1.0 / d;
    const double4 t0 = (lower - o) * inverse, t1 = (upper - o) * inverse;
    const long4 climbs = d > 0.0;
    const double4 near = climbs ? t0 : t1, far = climbs ? t1 : t0;
    double t_in = t_first;
    t_in = near.x > t_in ? near.x : t_in;
    t_in = near.y > t_in ? near.y : t_in;
    t_in = near.z > t_in ? near.z : t_in;
    const double t_leave = least_axis(far), t_out = t_leave < t_last ? t_leave : t_last;
    if (!(t_in <= t_out))
        return false;

#ifdef NESTED
    const int4 whole = (int4)((int)grid->resolution[0], (int)grid->resolution[1], (int)grid->resolution[2], 1);
    const int4 resolution = whole << FINEST;
#else
    const int4 resolution = (int4)((int)grid->resolution[0], (int)grid->resolution[1], (int)grid->resolution[2], 1);
#endif
    const double4 highest = convert_double4(resolution - 1);
    double4 k = ((o + t_in * d) - lower) / size;
    k = k > 0.0 ? k : (double4)(0.0);
    k = k < highest ? k : highest;
    const int4 cell = convert_int4(k);
    k = convert_double4(cell);
    const double4 next = ((lower + (climbs ? k + 1.0 : k) * size) - o) * inverse - t_in;
    const double4 pace = size * fabs(inverse);
    const double4 ahead = climbs ? highest - k : k;  // planes inside the grid
    const double4 leaves = next + ahead * pace;
    double4 first = next * TICKS, between = pace * TICKS;
    first = first > 0.0 ? first : (double4)(0.0);
    between = between < MOST_TICKS ? between : (double4)(MOST_TICKS);
    first = first < between ? first : between;
    walk->next.x = (long)first.x;
    walk->next.y = (long)first.y;
    walk->next.z = (long)first.z;
    walk->pace.x = (long)between.x;
    walk->pace.y = (long)between.y;
    walk->pace.z = (long)between.z;
    walk->t_in = t_in;
    walk->cell = cell;
    walk->up_x = climbs.x != 0;
    walk->up_y = climbs.y != 0;
    walk->up_z = climbs.z != 0;
    // The very tick of the last plane, where it is soon enough to matter: no step leads out of the grid.
    Ticks out;
    out.x = leaves.x < 7.0 ? walk->next.x + (long)ahead.x * walk->pace.x : (long)MOST_TICKS;
    out.y = leaves.y < 7.0 ? walk->next.y + (long)ahead.y * walk->pace.y : (long)MOST_TICKS;
    out.z = leaves.z < 7.0 ? walk->next.z + (long)ahead.z * walk->pace.z : (long)MOST_TICKS;
    const long left = least_tick(&out), last = tick_after(walk, t_out);
    walk->stop = left < last ? left : last;
#ifdef NESTED
    coarsen(walk);
#endif
    return walk->stop > 0;
}

#endif
