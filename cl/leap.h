// Empty-space skipping (Cohen & Sheffer 1994): a ray in an empty brick of BRICK^3 cells leaves at once the
// cube of bricks that the brick's distance says to be empty, in the very cell that single steps reach.
#ifndef CLG_LEAP_H
#define CLG_LEAP_H
#include "walk.h"

// The axis' cell in the grid's order.
uint coordinate(const Axis *axis, int resolution)
{
    const int climbed = resolution - 1 - axis->left;
    return (uint)(axis->stride < 0 ? resolution - 1 - climbed : climbed);
}

// Plane, in the ray's order, where it leaves the cube of empty bricks around its own: none within
// `distance` - 1 on any side holds a reference.
double cube_exit(const Axis *axis, int resolution, int distance)
{
    const int brick = (int)(coordinate(axis, resolution) / BRICK);
    const bool climbs = axis->stride > 0;
    const int plane = (int)BRICK * (climbs ? brick + distance : brick - distance + 1);
    const int inside = plane < 0 ? 0 : plane > resolution ? resolution : plane;
    return (double)(climbs ? inside : resolution - inside);
}

void set_planes(Axis *axis, double planes, int resolution)
{
    axis->planes = planes;
    axis->t_next = crossing(axis, planes);
    axis->left = resolution - (int)planes;
}

// Crosses every plane up to t: the same crossings that single steps compare, so the same cell.
void advance(Axis *axis, double planes_per_t, double t, int resolution)
{
    if (axis->t_next > t)
        return;
    const double last = (double)resolution;
    const double guess = floor((t - axis->t_first) * planes_per_t) + 1.0;
    double planes = guess < last ? guess : last;
    planes = planes > axis->planes ? planes : axis->planes;
    while (planes > axis->planes && crossing(axis, planes - 1.0) > t)
        planes -= 1.0;
    while (planes < last && crossing(axis, planes) <= t)
        planes += 1.0;
    set_planes(axis, planes, resolution);
}

// Leaves the empty cube around the cell's brick. False: by then the ray is out of the grid, or past `stop`.
bool leap(__constant const GridParams *grid, const Ray *ray, int distance, double stop, Axis *x, Axis *y, Axis *z)
{
    const int mx = (int)grid->resolution[0], my = (int)grid->resolution[1], mz = (int)grid->resolution[2];
    const double px = cube_exit(x, mx, distance), tx = crossing(x, px);
    const double py = cube_exit(y, my, distance), ty = crossing(y, py);
    const double pz = cube_exit(z, mz, distance), tz = crossing(z, pz);
    const double t = tx < ty ? (tx < tz ? tx : tz) : (ty < tz ? ty : tz);
    const bool across_x = t == tx, across_y = !across_x && t == ty;
    if (t > stop || (across_x ? px == (double)mx : across_y ? py == (double)my : pz == (double)mz))
        return false;
    // The axis whose plane is met takes its index from it; the others cross what lies up to t.
    if (across_x)
        set_planes(x, px + 1.0, mx);
    else
        advance(x, fabs(ray->direction[0]) * grid->cells_per_unit[0], t, mx);
    if (across_y)
        set_planes(y, py + 1.0, my);
    else
        advance(y, fabs(ray->direction[1]) * grid->cells_per_unit[1], t, my);
    if (!across_x && !across_y)
        set_planes(z, pz + 1.0, mz);
    else
        advance(z, fabs(ray->direction[2]) * grid->cells_per_unit[2], t, mz);
    return true;
}

#endif
