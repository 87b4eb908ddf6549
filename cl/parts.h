// Where the mesh is in several grids (PARTS), the nearest hit so far goes from one to the next.
//   nearest   NEAREST_REALS a ray: t, inf at first; for `exact` its error and the triangle's corners as well
#ifndef CLG_PARTS_H
#define CLG_PARTS_H
#include "triangle.h"

#ifdef RUNG_EXACT
#define NEAREST_REALS 11
#else
#define NEAREST_REALS 1
#endif

// A triangle that is as near has a higher id than those of the parts before, and loses: no id is below 0.
Hit bound_of(__global const real *nearest)
{
    Hit bound = no_hit();
    bound.meeting.t = nearest[0];
    bound.id = nearest[0] < INFINITY ? 0u : NO_HIT;
#ifdef RUNG_EXACT
    bound.meeting.error = nearest[1];
    for (int k = 0; k < 9; ++k)
        bound.meeting.corners.at[k / 3][k % 3] = nearest[2 + k];
#endif
    return bound;
}

// Whether this part has a nearer hit: one of its own, not the bound.
bool is_nearer(const Hit *hit, __global const real *nearest)
{
    if (hit->id == NO_HIT)
        return false;
#ifdef RUNG_EXACT
    if (hit->id != 0 || !(nearest[0] < INFINITY))
        return true;
    for (int k = 0; k < 9; ++k)
        if (hit->meeting.corners.at[k / 3][k % 3] != nearest[2 + k])
            return true;
    return false;
#else
    return hit->meeting.t < nearest[0];
#endif
}

void store_nearest(const Hit *hit, __global real *nearest)
{
    nearest[0] = hit->meeting.t;
#ifdef RUNG_EXACT
    nearest[1] = hit->meeting.error;
    for (int k = 0; k < 9; ++k)
        nearest[2 + k] = hit->meeting.corners.at[k / 3][k % 3];
#endif
}

#endif
