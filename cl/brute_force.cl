// The oracle: closest hit by testing every triangle with the grid's own triangle test, no grid.
// Triangles come twice: indexed, for the test that decides, and as nine arrays of coordinates,
// soup[3 * corner + axis][padded_count], for the filter that tests eight at once without gathering.
// One work-item casts a chunk of at most RAYS rays, tile by tile, so that a tile stays in the cache.
#include "rays_in_out.h"

#define RAYS 16
#define TILE 512

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void brute_force(__constant const FrameParams *frame, uint triangle_count, uint padded_count,
                          __global const float *soup, __global const float *vertices,
                          __global const uint *faces, __global const RAY_REAL *origins,
                          __global const RAY_REAL *directions, __global const double *t_bounds,
                          uint ray_count, __global double *t_hit, __global uint *ids, __global float *uvs,
                          __global uint *invalid)
{
    const uint begin = get_global_id(0) * RAYS;
    const uint count = min(ray_count - begin, (uint)RAYS);
    Ray rays[RAYS];
    Shear shears[RAYS];
    Hit hits[RAYS];
    uint rejected = 0;
    for (uint i = 0; i < count; ++i) {
        rays[i] = load_ray(origins, directions, t_bounds, begin + i, frame);
        if (rays[i].reaches)
            shears[i] = shear_of(&rays[i]);
        hits[i] = no_hit();
        rejected += rays[i].valid ? 0 : 1;
    }
    const size_t n = padded_count;
    for (uint tile = 0; tile < padded_count; tile += TILE) {
        const uint tile_end = min(tile + TILE, padded_count);
        for (uint i = 0; i < count; ++i) {
            const Shear *s = &shears[i];
            if (!rays[i].reaches)
                continue;
            for (uint first = tile; first < tile_end; first += 8) {
                __global const float *corner = soup + first;
                const int8 open =
                    candidates(s, vload8(0, corner + s->kx * n), vload8(0, corner + s->ky * n),
                               vload8(0, corner + s->kz * n), vload8(0, corner + (3 + s->kx) * n),
                               vload8(0, corner + (3 + s->ky) * n), vload8(0, corner + (3 + s->kz) * n),
                               vload8(0, corner + (6 + s->kx) * n), vload8(0, corner + (6 + s->ky) * n),
                               vload8(0, corner + (6 + s->kz) * n));
                if (!any(open))
                    continue;
                int lanes[8];
                vstore8(open, 0, lanes);
                for (uint k = 0; k < 8 && first + k < triangle_count; ++k)
                    if (lanes[k])
                        keep_nearest(&rays[i], s, vertices, faces, first + k, &hits[i]);
            }
        }
    }
    for (uint i = 0; i < count; ++i) {
        set_weights(&shears[i], vertices, faces, &hits[i]);
        store_hit(&rays[i], &hits[i], begin + i, t_hit, ids, uvs);
    }
    invalid[get_global_id(0)] = rejected;
}
