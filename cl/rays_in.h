// Rays from host arrays.
//   origins, directions   RAY_REAL (float or double), xyz packed
//   t_bounds              double, t_min then t_max: one pair for all, or one a ray (PER_RAY_T)
#ifndef CLG_RAYS_IN_H
#define CLG_RAYS_IN_H
#include "config.h"

// Rays that a work-item casts.
#define RAYS_PER_ITEM 64u
// Low bits of a key by which rays are ordered that hold the ray's number (ray_keys.cl): more than a launch has rays.
#define NUMBER_BITS 23

#define RAY_PARAMETERS \
    __global const RAY_REAL *origins, __global const RAY_REAL *directions, __global const double *t_bounds
#define RAY_ARGUMENTS origins, directions, t_bounds

// t_min and t_max of ray i.
#ifdef PER_RAY_T
#define T_BOUNDS(i) (t_bounds + 2 * (size_t)(i))
#else
#define T_BOUNDS(i) t_bounds
#endif

#endif
