// Closest hit of rays given as arrays (rays_in_out.h). One work-item casts a tile of rays.
//   invalid[tile]         rays of the tile that have no direction or are not finite
//   steps[ray], tests[ray], batches[ray]   COUNT_STEPS: cells looked at, triangles tested, in so many batches
//   nearest[ray]          PARTS: the nearest hit in the parts before (parts.h)
#include "tile.h"
#include "rays_in_out.h"
#ifdef PARTS
#include "parts.h"
#endif

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void cast_closest(__constant const FrameParams *frame, GRID_PARAMETERS, MESH_PARAMETERS, RAY_PARAMETERS,
                           uint ray_count, __global uint *invalid, HIT_PARAMETERS
#ifdef COUNT_STEPS
                           , __global uint *steps, __global uint *tests, __global uint *batches
#endif
#ifdef PARTS
                           , __global real *nearest
#endif
                           )
{
    const size_t begin = (size_t)get_global_id(0) * TILE_RAYS, end = min(begin + TILE_RAYS, (size_t)ray_count);
    Tile tile;
    start_tile(&tile, grid->triangle_count);
    invalid[get_global_id(0)] = load_tile(&tile, begin, end, frame, RAY_ARGUMENTS);
#ifdef PARTS
    for (size_t i = begin; i < end; ++i)
        set_hit(&tile, (uint)(i - begin), bound_of(nearest + NEAREST_REALS * i));
#endif
    cast_tile(&tile, GRID_ARGUMENTS, MESH_ARGUMENTS);
    for (size_t i = begin; i < end; ++i) {
        const uint k = (uint)(i - begin);
        Hit hit = described_hit(&tile, k, MESH_ARGUMENTS);
        const Ray ray = ray_of(&tile, k);
#ifdef PARTS
        __global real *bound = nearest + NEAREST_REALS * i;
        if (is_nearer(&hit, bound)) {
            store_nearest(&hit, bound);
            hit.id += grid->first_triangle;
            store_hit(&ray, &hit, i, HIT_ARGUMENTS);
        }
#else
        store_hit(&ray, &hit, i, HIT_ARGUMENTS);
#endif
#ifdef COUNT_STEPS
        steps[i] += hit.steps;
        tests[i] += hit.tests;
        batches[i] += hit.batches;
#endif
    }
}
