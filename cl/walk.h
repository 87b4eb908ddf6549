// The walk of a ray from cell to cell (after Amanatides & Woo 1987), one axis at a time. Plane k of axis a
// lies at lower[a] + k * cell_size[a], for the build and the walk alike. Cells are closed boxes.
#ifndef CLG_WALK_H
#define CLG_WALK_H
#include "ray.h"

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

// A component as the walk takes it: 0 where the ray crosses no plane within reach, and 1 / d may overflow.
double climb_rate(double d)
{
    return fabs(d) < SMALLEST_CLIMB ? 0.0 : d;
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

#endif
