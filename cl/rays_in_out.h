// Rays from and hits to host arrays, for every kernel that casts rays given as arrays.
//   origins, directions   RAY_REAL (float or double), xyz packed
//   t_bounds              double, t_min then t_max: one pair for all, or one a ray (PER_RAY_T)
#ifndef CLG_RAYS_IN_OUT_H
#define CLG_RAYS_IN_OUT_H
#include "triangle.h"

Ray load_ray(__global const RAY_REAL *origins, __global const RAY_REAL *directions,
             __global const double *t_bounds, size_t i, __constant const FrameParams *frame)
{
    double o[3], d[3];
    for (int a = 0; a < 3; ++a) {
        o[a] = origins[3 * i + a];
        d[a] = directions[3 * i + a];
    }
#ifdef PER_RAY_T
    return prepare_ray(o, d, t_bounds[2 * i], t_bounds[2 * i + 1], frame);
#else
    return prepare_ray(o, d, t_bounds[0], t_bounds[1], frame);
#endif
}

void store_hit(const Ray *ray, const Hit *hit, size_t i, __global double *t_hit, __global uint *ids,
               __global float *uvs)
{
    t_hit[i] = hit->id == NO_HIT ? INFINITY : scene_t(ray, hit->t);
    ids[i] = hit->id;
    uvs[2 * i] = hit->u;
    uvs[2 * i + 1] = hit->v;
}

#endif
