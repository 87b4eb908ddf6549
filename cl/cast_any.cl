// Whether rays given as arrays (rays_in_out.h) meet anything. One work-item casts a chunk of rays.
//   invalid[chunk]    rays of the chunk that have no direction or are not finite
//   occluded[ray]     1 if a triangle is met; a ray that a part before found so is not cast again
#define QUERY_ANY
#include "grid.h"
#include "rays_in_out.h"

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void cast_any(__constant const FrameParams *frame, GRID_PARAMETERS, MESH_PARAMETERS, RAY_PARAMETERS,
                       uint ray_count, uint chunk_size, __global uint *invalid, __global uchar *occluded)
{
    const uint chunk = get_global_id(0);
    const uint begin = chunk * chunk_size;
    const uint end = min(begin + chunk_size, ray_count);
    uint rejected = 0;
    for (uint i = begin; i < end; ++i) {
        const Ray ray = load_ray(i, frame, RAY_ARGUMENTS);
        rejected += ray.valid ? 0 : 1;
        if (!occluded[i])
            occluded[i] = traverse(&ray, no_hit(), GRID_ARGUMENTS, MESH_ARGUMENTS).id != NO_HIT ? 1 : 0;
    }
    invalid[chunk] = rejected;
}
