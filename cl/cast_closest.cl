// Closest hit of rays given as arrays (rays_in_out.h). One work-item casts a chunk of rays.
//   invalid[chunk]        rays of the chunk that have no direction or are not finite
//   steps[ray], tests[ray], batches[ray]   COUNT_STEPS: cells looked at, triangles tested, in so many batches
//   nearest[ray]          PARTS: the nearest hit in the parts before (parts.h)
#include "grid.h"
#include "rays_in_out.h"
#ifdef PARTS
#include "parts.h"
#endif

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void cast_closest(__constant const FrameParams *frame, GRID_PARAMETERS, MESH_PARAMETERS, RAY_PARAMETERS,
                           uint ray_count, uint chunk_size, __global uint *invalid, HIT_PARAMETERS
#ifdef COUNT_STEPS
                           , __global uint *steps, __global uint *tests, __global uint *batches
#endif
#ifdef PARTS
                           , __global real *nearest
#endif
                           )
{
    const uint chunk = get_global_id(0);
    const uint begin = chunk * chunk_size;
    const uint end = min(begin + chunk_size, ray_count);
    uint rejected = 0;
    for (uint i = begin; i < end; ++i) {
        const Ray ray = load_ray(i, frame, RAY_ARGUMENTS);
        rejected += ray.valid ? 0 : 1;
#ifdef PARTS
        __global real *bound = nearest + NEAREST_REALS * (size_t)i;
        Hit hit = traverse(&ray, bound_of(bound), GRID_ARGUMENTS, MESH_ARGUMENTS);
        if (is_nearer(&hit, bound)) {
            store_nearest(&hit, bound);
            hit.id += grid->first_triangle;
            store_hit(&ray, &hit, i, HIT_ARGUMENTS);
        }
#else
        const Hit hit = traverse(&ray, no_hit(), GRID_ARGUMENTS, MESH_ARGUMENTS);
        store_hit(&ray, &hit, i, HIT_ARGUMENTS);
#endif
#ifdef COUNT_STEPS
        steps[i] += hit.steps;
        tests[i] += hit.tests;
        batches[i] += hit.batches;
#endif
    }
    invalid[chunk] = rejected;
}
