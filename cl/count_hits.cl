// How many triangles rays given as arrays (rays_in_out.h) meet. One work-item casts a chunk of rays.
//   invalid[chunk]    rays of the chunk that have no direction or are not finite
//   counts[ray]       is added to, part after part
//   OPEN_START        rung `exact`: the ray's start is moved by an infinitesimal, and no interval asked
#define QUERY_COUNT
#include "herd.h"
#include "rays_in_out.h"

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void count_hits(__constant const FrameParams *frame, GRID_PARAMETERS, MESH_PARAMETERS, RAY_PARAMETERS,
                         uint ray_count, __global uint *invalid, __global uint *counts)
{
    const uint chunk = get_global_id(0);
    const uint begin = chunk * RAYS_PER_ITEM;
    const uint end = min(begin + RAYS_PER_ITEM, ray_count);
    uint rejected = 0;
    Walker herd[HERD];
    uint count = 0, next_ray = begin;
    while (count != 0 || next_ray < end) {
        for (; count < HERD && next_ray < end; ++next_ray) {
            const Ray ray = load_ray(next_ray, frame, RAY_ARGUMENTS);
            rejected += ray.valid ? 0 : 1;
            set_out(herd + count++, next_ray, &ray, no_hit(), grid);
        }
        take_turns(herd, count, GRID_ARGUMENTS, MESH_ARGUMENTS);
        for (uint k = 0; k < count;) {
            if (herd[k].over) {
                counts[herd[k].number] += outcome(herd + k, GRID_ARGUMENTS, MESH_ARGUMENTS).count;
                count = dismiss(herd, k, count);
            } else {
                ++k;
            }
        }
    }
    invalid[chunk] = rejected;
}
