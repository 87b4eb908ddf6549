// Empty-space skipping (Cohen & Sheffer 1994): a byte for each brick of BRICK^3 cells says how many bricks away
// the nearest reference is. From 2 on, a ray leaves at once the cube of bricks that the distance says to
// be empty, in the very cell that single steps reach; at 1, it steps out of the brick without a look at
// its cells, which costs less than such a leap.
#ifndef CLG_LEAP_H
#define CLG_LEAP_H
#include "walk.h"

// The axis' cell in the grid's order.
uint coordinate(const Axis *axis, int resolution)
{
    return (uint)(axis->stride < 0 ? axis->left : resolution - 1 - axis->left);
}

// Planes still ahead inside the cell's brick, as if every brick were whole.
int ahead_in_brick(const Axis *axis, int resolution)
{
    return (axis->left - (axis->stride < 0 ? 0 : resolution)) & ((int)BRICK - 1);
}

// Whether the last step across this axis led into another brick.
bool enters_brick(const Axis *axis, int resolution)
{
    return ahead_in_brick(axis, resolution) == (int)BRICK - 1;
}

// Planes still ahead inside the cube of empty bricks around the cell's own: none within `distance` - 1 of
// that on any side holds a reference.
int ahead_in_cube(const Axis *axis, int resolution, int distance)
{
    const int ahead = ahead_in_brick(axis, resolution) + (int)BRICK * (distance - 1);
    return ahead < axis->left ? ahead : axis->left;
}

void climb(Axis *axis, int planes, uint *cell)
{
    axis->left -= planes;
    *cell += (uint)(planes * axis->stride);
    axis->planes += (double)planes;
    axis->t_next = crossing(axis, axis->planes);
}

// Crosses every plane up to t, `ahead` at most: the same crossings that single steps compare.
void climb_up_to(Axis *axis, double t, double planes_per_t, int ahead, uint *cell)
{
    if (!(axis->t_next <= t))
        return;
    int planes = clamp((int)((t - axis->t_next) * planes_per_t) + 1, 0, ahead);
    while (planes > 0 && crossing(axis, axis->planes + (double)(planes - 1)) > t)
        --planes;
    while (planes < ahead && crossing(axis, axis->planes + (double)planes) <= t)
        ++planes;
    climb(axis, planes, cell);
}

// Across axis a out of the cube, at t; b and c follow.
bool leave_cube(Axis *a, int ahead_a, double t, double stop, Axis *b, int ahead_b, double b_per_t, Axis *c,
                int ahead_c, double c_per_t, uint *cell)
{
    if (t > stop || ahead_a == a->left)
        return false;
    climb(a, ahead_a + 1, cell);
    climb_up_to(b, t, b_per_t, ahead_b, cell);
    climb_up_to(c, t, c_per_t, ahead_c, cell);
    return true;
}

// Leaves the empty cube around the cell's brick, at t `left_at`. False: by then the ray is out of the grid,
// or past `stop`.
bool leap(__constant const GridParams *grid, const Ray *ray, int distance, double stop, Axis *x, Axis *y, Axis *z,
          uint *cell, double *left_at)
{
    const int ax = ahead_in_cube(x, (int)grid->resolution[0], distance);
    const int ay = ahead_in_cube(y, (int)grid->resolution[1], distance);
    const int az = ahead_in_cube(z, (int)grid->resolution[2], distance);
    const double tx = crossing(x, x->planes + (double)ax);
    const double ty = crossing(y, y->planes + (double)ay);
    const double tz = crossing(z, z->planes + (double)az);
    const double x_per_t = fabs(ray->direction[0]) * grid->cells_per_unit[0];
    const double y_per_t = fabs(ray->direction[1]) * grid->cells_per_unit[1];
    const double z_per_t = fabs(ray->direction[2]) * grid->cells_per_unit[2];
    *left_at = fmin(fmin(tx, ty), tz);
    if (tx < ty ? tx < tz : false)
        return leave_cube(x, ax, tx, stop, y, ay, y_per_t, z, az, z_per_t, cell);
    if (ty < tz)
        return leave_cube(y, ay, ty, stop, x, ax, x_per_t, z, az, z_per_t, cell);
    return leave_cube(z, az, tz, stop, x, ax, x_per_t, y, ay, y_per_t, cell);
}

// Distance of the brick that holds the cell.
int brick_distance(__constant const GridParams *grid, __global const uchar *distances, const Axis *x, const Axis *y,
                   const Axis *z)
{
    const uint mx = grid->resolution[0], my = grid->resolution[1], mz = grid->resolution[2];
    const uint across = (mx + BRICK - 1) / BRICK, deep = (my + BRICK - 1) / BRICK;
    const uint bx = coordinate(x, (int)mx) / BRICK, by = coordinate(y, (int)my) / BRICK;
    const uint bz = coordinate(z, (int)mz) / BRICK;
    return (int)distances[((size_t)bz * deep + by) * across + bx];
}

#endif
