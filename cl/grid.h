// The compact grid (Lagae & Dutre 2008): cell i holds references[cells[i] .. cells[i+1]-1], ascending,
// i = (z * My + y) * Mx + x. Plane k of axis a lies at lower[a] + k * cell_size[a], for the build and
// the walk alike. Cells are closed boxes; triangles are entered by their padded bounding box.
#ifndef CLG_GRID_H
#define CLG_GRID_H
#include "triangle.h"

#ifdef SKIP_EMPTY
#define GRID_PARAMETERS                                                                              \
    __constant const GridParams *grid, __global const uint *cells, __global const uint *references,  \
        __global const uchar *distances
#define GRID_ARGUMENTS grid, cells, references, distances
#else
#define GRID_PARAMETERS                                                                              \
    __constant const GridParams *grid, __global const uint *cells, __global const uint *references
#define GRID_ARGUMENTS grid, cells, references
#endif

// One axis of the walk, mirrored so that the ray always climbs: it crosses plane j at
// t(j) = t_first + j * t_cell, straight from the integer: no rounding piles up over the steps.
typedef struct {
    double t_first, t_cell;  // t of plane 0 and from plane to plane; inf and 0 if parallel
    double planes;           // index of the next plane to cross
    double t_next;           // t of that plane
    int left;                // planes inside the grid still ahead
    int stride;              // signed step in the array of cells
} Axis;

double crossing(const Axis *axis, double plane)
{
    return axis->t_first + plane * axis->t_cell;
}

// Sets t_first, t_cell; narrows [t_in, t_out] to the grid's slab. False: parallel and outside.
bool enter_slab(Axis *axis, double o, double d, double lower, double upper, double cell, uint resolution,
                double *t_in, double *t_out)
{
    if (d == 0.0) {
        axis->t_first = INFINITY;
        axis->t_cell = 0.0;
        return o >= lower && o <= upper;
    }
    const double inverse = 1.0 / d;
    axis->t_first = ((d > 0.0 ? lower : upper) - o) * inverse;
    axis->t_cell = cell * fabs(inverse);
    const double t_out_here = crossing(axis, (double)resolution);
    *t_in = axis->t_first > *t_in ? axis->t_first : *t_in;
    *t_out = t_out_here < *t_out ? t_out_here : *t_out;
    return true;
}

// Index, in the ray's own order, of the cell that holds t: the number of planes with crossing <= t,
// less one. A guess by floor is corrected with the same crossings that the walk compares.
int start_cell(Axis *axis, double o, double d, double lower, double cell, int resolution, double t)
{
    const double x = ((o + t * d) - lower) / cell;
    int k = x < 0.0 ? 0 : x >= (double)resolution ? resolution - 1 : (int)x;
    if (d < 0.0)
        k = resolution - 1 - k;
    if (d != 0.0) {
        while (k < resolution - 1 && crossing(axis, (double)(k + 1)) <= t)
            ++k;
        while (k > 0 && crossing(axis, (double)k) > t)
            --k;
    }
    axis->planes = (double)(k + 1);
    axis->t_next = crossing(axis, axis->planes);
    axis->left = resolution - 1 - k;
    return d < 0.0 ? resolution - 1 - k : k;
}

// Moves to the next cell across this axis. False: out of the grid.
bool step(Axis *axis, uint *cell)
{
    if (axis->left == 0)
        return false;
    --axis->left;
    *cell += (uint)axis->stride;
    axis->planes += 1.0;
    axis->t_next = crossing(axis, axis->planes);
    return true;
}

#ifdef SKIP_EMPTY
// Bricks of BRICK^3 cells, each with the distance to the nearest that holds a reference.

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

// The nearest hit, bit for bit that of testing every triangle (docs/numerics.md, "Lossless grid").
Hit closest_hit(const Ray *ray, GRID_PARAMETERS, __global const float *vertices, __global const uint *faces)
{
    Hit hit = no_hit();
    if (!ray->reaches)
        return hit;
    Axis x, y, z;
    double t_in = first_t(ray), t_out = last_t(ray);
    const double ox = ray->origin[0], oy = ray->origin[1], oz = ray->origin[2];
    const double dx = ray->direction[0], dy = ray->direction[1], dz = ray->direction[2];
    const int mx = (int)grid->resolution[0], my = (int)grid->resolution[1], mz = (int)grid->resolution[2];
    if (!enter_slab(&x, ox, dx, grid->lower[0], grid->upper[0], grid->cell_size[0], mx, &t_in, &t_out)
        || !enter_slab(&y, oy, dy, grid->lower[1], grid->upper[1], grid->cell_size[1], my, &t_in, &t_out)
        || !enter_slab(&z, oz, dz, grid->lower[2], grid->upper[2], grid->cell_size[2], mz, &t_in, &t_out)
        || t_in > t_out)
        return hit;

    const int ix = start_cell(&x, ox, dx, grid->lower[0], grid->cell_size[0], mx, t_in);
    const int iy = start_cell(&y, oy, dy, grid->lower[1], grid->cell_size[1], my, t_in);
    const int iz = start_cell(&z, oz, dz, grid->lower[2], grid->cell_size[2], mz, t_in);
    uint cell = ((uint)iz * (uint)my + (uint)iy) * (uint)mx + (uint)ix;
    x.stride = dx < 0.0 ? -1 : 1;
    y.stride = dy < 0.0 ? -mx : mx;
    z.stride = dz < 0.0 ? -mx * my : mx * my;

    const Shear shear = shear_of(ray);
    double stop = t_out;  // no hit beyond it can win
#ifdef SKIP_EMPTY
    const uint bx = (mx + BRICK - 1) / BRICK, by = (my + BRICK - 1) / BRICK;
#endif
    for (;;) {
        const uint begin = cells[cell], end = cells[cell + 1];
        if (begin != end) {
            keep_nearest_of_list(ray, &shear, vertices, faces, references + begin, end - begin, &hit);
            // Later cells may still hold a hit whose computed t is as near (docs/numerics.md).
            const double bound = (double)hit.t + T_SLACK;
            stop = bound < stop ? bound : stop;
        }
#ifdef SKIP_EMPTY
        else {
            const uint cx = coordinate(&x, mx), cy = coordinate(&y, my), cz = coordinate(&z, mz);
            const int distance = distances[((size_t)(cz / BRICK) * by + cy / BRICK) * bx + cx / BRICK];
            if (distance > 1) {
                if (!leap(grid, ray, distance, stop, &x, &y, &z))
                    break;
                cell = (coordinate(&z, mz) * (uint)my + coordinate(&y, my)) * (uint)mx + coordinate(&x, mx);
                continue;
            }
        }
#endif
        bool inside;
        if (x.t_next < y.t_next ? x.t_next < z.t_next : false)
            inside = x.t_next <= stop && step(&x, &cell);
        else if (y.t_next < z.t_next)
            inside = y.t_next <= stop && step(&y, &cell);
        else
            inside = z.t_next <= stop && step(&z, &cell);
        if (!inside)
            break;
    }
    set_weights(&shear, vertices, faces, &hit);
    return hit;
}

#endif
