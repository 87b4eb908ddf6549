// Closest hit of rays given as arrays (rays_in_out.h). One work-item casts a chunk of rays.
//   invalid[chunk]        rays of the chunk that have no direction or are not finite
//   steps[ray], tests[ray], batches[ray]   COUNT_STEPS: cells looked at, triangles tested, in so many batches
//   nearest[ray]          PARTS: local t of the nearest hit in the parts before, inf at first
#include "grid.h"
#include "rays_in_out.h"

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void cast_closest(__constant const FrameParams *frame, GRID_PARAMETERS,
                           __global const float *vertices, __global const uint *faces,
                           __global const RAY_REAL *origins, __global const RAY_REAL *directions,
                           __global const double *t_bounds, uint ray_count, uint chunk_size,
                           __global double *t_hit, __global uint *ids, __global float *uvs,
                           __global uint *invalid
#ifdef COUNT_STEPS
                           , __global uint *steps, __global uint *tests, __global uint *batches
#endif
#ifdef PARTS
                           , __global float *nearest
#endif
                           )
{
    const uint chunk = get_global_id(0);
    const uint begin = chunk * chunk_size;
    const uint end = min(begin + chunk_size, ray_count);
    uint rejected = 0;
    for (uint i = begin; i < end; ++i) {
        const Ray ray = load_ray(origins, directions, t_bounds, i, frame);
        rejected += ray.valid ? 0 : 1;
#ifdef PARTS
        Hit hit = closest_hit(&ray, bound_of(nearest[i]), GRID_ARGUMENTS, vertices, faces);
        if (hit.t < nearest[i]) {
            nearest[i] = hit.t;
            hit.id += grid->first_triangle;
            store_hit(&ray, &hit, i, t_hit, ids, uvs);
        }
#else
        const Hit hit = closest_hit(&ray, no_hit(), GRID_ARGUMENTS, vertices, faces);
        store_hit(&ray, &hit, i, t_hit, ids, uvs);
#endif
#ifdef COUNT_STEPS
        steps[i] += hit.steps;
        tests[i] += hit.tests;
        batches[i] += hit.batches;
#endif
    }
    invalid[chunk] = rejected;
}
