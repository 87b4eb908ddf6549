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
                           ORDER_PARAMETERS, __global uint *invalid, HIT_PARAMETERS
#ifdef COUNT_STEPS
                           , __global uint *steps, __global uint *tests, __global uint *batches
#endif
#ifdef PARTS
                           , __global real *nearest
#endif
                           )
{
    const size_t number = get_global_id(0);
    Tile tile;
    start_tile(&tile, frame, grid);
    invalid[number] = load_tile(&tile, number, ORDER_ARGUMENTS, frame, RAY_ARGUMENTS);
#ifdef PARTS
    for (uint k = 0; k < TILE_RAYS; ++k) {
        const size_t i = ray_in_tile(number, k, ORDER_ARGUMENTS);
        if (i < ray_count)
            set_hit(&tile, k, bound_of(nearest + NEAREST_REALS * i));
    }
#endif
    cast_tiles(&tile, 1, GRID_ARGUMENTS, MESH_ARGUMENTS);
    for (uint k = 0; k < TILE_RAYS; ++k) {
        const size_t i = ray_in_tile(number, k, ORDER_ARGUMENTS);
        if (i >= ray_count)
            continue;
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
