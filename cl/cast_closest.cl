// Closest hit of rays given as arrays. One work-item casts a chunk of rays.
//   origins, directions   RAY_REAL (float or double), xyz packed
//   t_bounds              double, t_min then t_max: one pair for all, or one a ray (PER_RAY_T)
//   invalid[chunk]        rays of the chunk that have no direction or are not finite
#ifdef BRUTE_FORCE
#include "brute_force.h"
#else
#include "grid.h"
#endif

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void cast_closest(__constant const FrameParams *frame, __constant const GridParams *grid,
#ifndef BRUTE_FORCE
                           __global const uint *cells, __global const uint *references,
#endif
                           __global const float *vertices, __global const uint *faces,
                           __global const RAY_REAL *origins, __global const RAY_REAL *directions,
                           __global const double *t_bounds, uint ray_count, uint chunk_size,
                           __global double *t_hit, __global uint *ids, __global float *uvs,
                           __global uint *invalid)
{
    const uint chunk = get_global_id(0);
    const uint begin = chunk * chunk_size;
    const uint end = min(begin + chunk_size, ray_count);
    uint rejected = 0;
    for (uint i = begin; i < end; ++i) {
        double o[3], d[3];
        for (int a = 0; a < 3; ++a) {
            o[a] = origins[3 * (size_t)i + a];
            d[a] = directions[3 * (size_t)i + a];
        }
#ifdef PER_RAY_T
        __global const double *t = t_bounds + 2 * (size_t)i;
#else
        __global const double *t = t_bounds;
#endif
        const Ray ray = prepare_ray(o, d, t[0], t[1], frame);
        rejected += ray.valid ? 0 : 1;
#ifdef BRUTE_FORCE
        const Hit hit = closest_of_all(&ray, grid->triangle_count, vertices, faces);
#else
        const Hit hit = closest_hit(&ray, grid, cells, references, vertices, faces);
#endif
        t_hit[i] = hit.id == NO_HIT ? INFINITY : scene_t(&ray, hit.t);
        ids[i] = hit.id;
        uvs[2 * (size_t)i] = hit.u;
        uvs[2 * (size_t)i + 1] = hit.v;
    }
    invalid[chunk] = rejected;
}
