// Every triangle that rays given as arrays (rays_in_out.h) meet, sorted by t. One work-item casts a chunk of
// rays, and writes the hits of each after those of the one before, from starts[chunk] to starts[chunk + 1].
//   counts[ray]       all of its hits, also those for which there was no room
//   invalid[chunk]    rays of the chunk that have no direction or are not finite
#define QUERY_ALL
#include "grid.h"
#include "rays_in_out.h"

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void cast_all(__constant const FrameParams *frame, GRID_PARAMETERS, MESH_PARAMETERS, RAY_PARAMETERS,
                       uint ray_count, __global uint *invalid, __global uint *counts,
                       __global const ulong *starts, HIT_PARAMETERS)
{
    const uint chunk = get_global_id(0);
    const uint begin = chunk * RAYS_PER_ITEM;
    const uint end = min(begin + RAYS_PER_ITEM, ray_count);
    uint rejected = 0;
    Hit each = no_hit();
    each.records.t = t_hit;
    each.records.ids = ids;
#ifdef WITH_UVS
    each.records.uvs = uvs;
#endif
#ifdef WITH_T_ERR
    each.records.t_errs = t_errs;
#endif
    each.records.begin = starts[chunk];
    each.records.end = starts[chunk + 1];
    for (uint i = begin; i < end; ++i) {
        const Ray ray = load_ray(i, frame, RAY_ARGUMENTS);
        rejected += ray.valid ? 0 : 1;
        const Hit found = traverse(&ray, each, GRID_ARGUMENTS, MESH_ARGUMENTS);
        if (each.records.begin + found.count <= each.records.end)
            sort_records(&each.records, &ray, MESH_ARGUMENTS, found.count);
        each.records.begin += found.count;
        counts[i] = found.count;
    }
    invalid[chunk] = rejected;
}
