// The oracle: closest hit, or with QUERY_COUNT the number of hits, by testing every triangle with the grid's
// own triangle test, no grid.
// Triangles come twice: as the test that decides reads them, and as nine arrays of coordinates,
// soup[3 * corner + axis][padded_count], for the filter that tests eight at once without gathering.
// One work-item casts a chunk of at most RAYS rays, tile by tile, so that a tile stays in the cache.
#include "rays_in_out.h"

#define RAYS 16
#define TILE 512

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void brute_force(__constant const FrameParams *frame, uint triangle_count, uint padded_count,
                          __global const float *soup, MESH_PARAMETERS, RAY_PARAMETERS, uint ray_count,
                          __global uint *invalid,
#ifdef QUERY_COUNT
                          __global uint *counts
#else
                          HIT_PARAMETERS
#endif
                          )
{
    const uint begin = get_global_id(0) * RAYS;
    const uint count = min(ray_count - begin, (uint)RAYS);
    Ray rays[RAYS];
    Projection projections[RAYS];
    Hit hits[RAYS];
    uint rejected = 0;
    for (uint i = 0; i < count; ++i) {
        rays[i] = load_ray(begin + i, frame, RAY_ARGUMENTS);
        if (rays[i].reaches)
            projections[i] = projection_of(&rays[i]);
        hits[i] = no_hit();
        rejected += rays[i].valid ? 0 : 1;
    }
    for (uint tile = 0; tile < padded_count; tile += TILE) {
        const uint tile_end = min(tile + TILE, padded_count);
        for (uint i = 0; i < count; ++i) {
            if (!rays[i].reaches)
                continue;
            for (uint first = tile; first < tile_end; first += 8) {
                int8 open = candidates_of_soup(&projections[i], soup + first, padded_count);
#ifdef RUNG_EXACT
                if (rays[i].astray)
                    open = (int8)(-1);
#endif
                if (!any(open))
                    continue;
                int lanes[8];
                vstore8(open, 0, lanes);
                for (uint k = 0; k < 8 && first + k < triangle_count; ++k)
                    if (lanes[k])
                        keep(&rays[i], &projections[i], MESH_ARGUMENTS, first + k, &hits[i]);
            }
        }
    }
    for (uint i = 0; i < count; ++i) {
#ifdef QUERY_COUNT
        counts[begin + i] = hits[i].count;
#else
        describe_hit(&rays[i], &projections[i], MESH_ARGUMENTS, &hits[i]);
        store_hit(&rays[i], &hits[i], begin + i, HIT_ARGUMENTS);
#endif
    }
    invalid[get_global_id(0)] = rejected;
}
