// Rung `fast`: closest hit of rays given as arrays (rays_in_out.h), eight side by side. One work-item casts a
// chunk of rays.
//   invalid[chunk]        rays of the chunk that have no direction or are not finite
//   steps[ray], tests[ray], batches[ray]   COUNT_STEPS: cells looked at, triangles tested, in so many batches
//   nearest[ray]          PARTS: local t of the nearest hit in the parts before, inf at first
#include "packet_walk.h"
#include "rays_in_out.h"

// Rays i .. i + 7, those before `end`; gives how many of them are none.
uint load_rays(uint i, uint end, __constant const FrameParams *frame, RAY_PARAMETERS, Packet *rays)
{
    double o[3][LANES];
    float d[3][LANES], t_min[LANES], t_max[LANES];
    for (uint lane = 0; lane < LANES; ++lane) {
        const size_t k = i + lane < end ? i + lane : end - 1;
#ifdef PER_RAY_T
        __global const double *bounds = t_bounds + 2 * k;
#else
        __global const double *bounds = t_bounds;
#endif
        bool finite = true;
        for (int a = 0; a < 3; ++a) {
            o[a][lane] = ((double)origins[3 * k + a] - frame->offset[a]) * frame->scale;
            d[a][lane] = (float)directions[3 * k + a];
            finite = finite && isfinite(o[a][lane]) && isfinite(d[a][lane]);
        }
        t_min[lane] = finite ? (float)bounds[0] : NAN;
        t_max[lane] = (float)bounds[1];
    }
    for (int a = 0; a < 3; ++a) {
        rays->origin[a][0] = vload4(0, o[a]);
        rays->origin[a][1] = vload4(1, o[a]);
    }
    const int8 valid = set_directions(rays, vload8(0, d[0]), vload8(0, d[1]), vload8(0, d[2]), vload8(0, t_min),
                                      vload8(0, t_max), (float)frame->inverse_scale);
    int sound[LANES];
    vstore8(valid, 0, sound);
    uint none = 0;
    for (uint lane = 0; lane < LANES && i + lane < end; ++lane)
        none += sound[lane] == 0 ? 1 : 0;
    return none;
}

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void cast_closest_fast(__constant const FrameParams *frame, GRID_PARAMETERS, MESH_PARAMETERS,
                                RAY_PARAMETERS, uint ray_count, __global uint *invalid,
                                HIT_PARAMETERS
#ifdef COUNT_STEPS
                                , __global uint *steps, __global uint *tests, __global uint *batches
#endif
#ifdef PARTS
                                , __global float *nearest
#endif
                                )
{
    const uint chunk = get_global_id(0);
    const uint begin = chunk * RAYS_PER_ITEM;
    const uint end = min(begin + RAYS_PER_ITEM, ray_count);
    uint rejected = 0;
    for (uint first = begin; first < end; first += LANES) {
        Packet rays;
        rejected += load_rays(first, end, frame, RAY_ARGUMENTS, &rays);
        PacketHit hits[LANES];
        for (uint lane = 0; lane < LANES; ++lane)
#ifdef PARTS
            hits[lane] = packet_bound(nearest[min(first + lane, end - 1)]);
#else
            hits[lane] = no_packet_hit();
#endif
        cast_packet(&rays, hits, GRID_ARGUMENTS, vertices, faces);
        float units[LANES];
        vstore8(rays.unit, 0, units);
        for (uint lane = 0; lane < LANES && first + lane < end; ++lane) {
            const size_t i = first + lane;
            PacketHit hit = hits[lane];
#ifdef COUNT_STEPS
            steps[i] += hit.steps;
            tests[i] += hit.tests;
            batches[i] += hit.batches;
#endif
#ifdef PARTS
            if (!(hit.t < nearest[i]))
                continue;
            nearest[i] = hit.t;
            hit.id += grid->first_triangle;
#endif
            t_hit[i] = hit.id == NO_HIT ? INFINITY : (double)hit.t * (double)units[lane] * frame->inverse_scale;
            ids[i] = hit.id;
#ifdef WITH_UVS
            uvs[2 * i] = hit.u;
            uvs[2 * i + 1] = hit.v;
#endif
        }
    }
    invalid[chunk] = rejected;
}
