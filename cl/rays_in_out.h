// Rays from and hits to host arrays, for every kernel that casts rays given as arrays (rays_in.h).
//   t_hit, ids            of each ray; inf and NO_HIT on a miss
//   uvs, t_errs, certain  WITH_UVS, WITH_T_ERR, WITH_CERTAIN: what else is asked for (triangle.h)
#ifndef CLG_RAYS_IN_OUT_H
#define CLG_RAYS_IN_OUT_H
#include "ask.h"
#include "rays_in.h"
#include "triangle.h"

Ray load_ray(size_t i, __constant const FrameParams *frame, RAY_PARAMETERS)
{
    double o[3], d[3];
    for (int a = 0; a < 3; ++a) {
        o[a] = origins[3 * i + a];
        d[a] = directions[3 * i + a];
    }
    return prepare_ray(o, d, T_BOUNDS(i)[0], T_BOUNDS(i)[1], frame);
}

#ifdef CLG_TILE_H
// Where the rays of a tile are: ORDERED: in the order of sorted keys (ray_keys.cl); else `row` rays make a row, and
// a tile has 8 of each of 8 rows, in groups of 4 x 2.
#ifdef ORDERED
#define ORDER_PARAMETERS uint ray_count, __global const ulong *order
#define ORDER_ARGUMENTS ray_count, order
#else
#define ORDER_PARAMETERS uint ray_count, uint row
#define ORDER_ARGUMENTS ray_count, row
#endif

// Ray k of a tile; at least ray_count if there is none.
size_t ray_in_tile(size_t tile, uint k, ORDER_PARAMETERS)
{
#ifdef ORDERED
    const size_t i = tile * TILE_RAYS + k;
    return i < ray_count ? order[i] & ((1ul << NUMBER_BITS) - 1) : ray_count;
#else
    const uint across = (row + 7) / 8, g = k / LANES, lane = k % LANES;
    const size_t x = tile % across * 8 + g % 2 * 4 + lane % 4, y = tile / across * 8 + g / 2 * 2 + lane / 4;
    return x < row ? y * row + x : ray_count;
#endif
}

// The rays of a tile. Returns how many of them are none.
uint load_tile(Tile *tile, size_t number, ORDER_PARAMETERS, __constant const FrameParams *frame, RAY_PARAMETERS)
{
    ulong here = 0;
#ifdef ORDERED
    for (uint k = 0; k < TILE_RAYS; ++k) {
        const size_t i = min(ray_in_tile(number + 1, k, ORDER_ARGUMENTS), (size_t)ray_count - 1);
        ask_for(origins + 3 * i);
        ask_for(directions + 3 * i);
    }
#endif
    for (uint k = 0; k < TILE_RAYS; k += 4) {
        double o[3][4], d[3][4], t_min[4], t_max[4];
        size_t i[4];
        for (uint lane = 0; lane < 4; ++lane) {
            const size_t given = ray_in_tile(number, k + lane, ORDER_ARGUMENTS);
            i[lane] = min(given, (size_t)ray_count - 1);
            here |= (ulong)(given < ray_count ? 1 : 0) << (k + lane);
        }
        // As vectors from the start: four stores of a number each are not yet done when their vector is read.
        for (int a = 0; a < 3; ++a) {
            __global const RAY_REAL *from = origins + a, *along = directions + a;
            vstore4((double4)(from[3 * i[0]], from[3 * i[1]], from[3 * i[2]], from[3 * i[3]]), 0, o[a]);
            vstore4((double4)(along[3 * i[0]], along[3 * i[1]], along[3 * i[2]], along[3 * i[3]]), 0, d[a]);
        }
        __global const double *own[4] = {T_BOUNDS(i[0]), T_BOUNDS(i[1]), T_BOUNDS(i[2]), T_BOUNDS(i[3])};
        vstore4((double4)(own[0][0], own[1][0], own[2][0], own[3][0]), 0, t_min);
        vstore4((double4)(own[0][1], own[1][1], own[2][1], own[3][1]), 0, t_max);
        set_rays(tile, k, o, d, t_min, t_max, frame);
    }
    tile->reach &= here;
    return (uint)popcount(here & ~tile->valid);
}
#endif

#ifdef WITH_UVS
#define UV_PARAMETER , __global real *uvs
#define UV_ARGUMENT , uvs
#else
#define UV_PARAMETER
#define UV_ARGUMENT
#endif
#ifdef WITH_T_ERR
#define T_ERR_PARAMETER , __global double *t_errs
#define T_ERR_ARGUMENT , t_errs
#else
#define T_ERR_PARAMETER
#define T_ERR_ARGUMENT
#endif
#ifdef WITH_CERTAIN
#define CERTAIN_PARAMETER , __global uchar *certain
#define CERTAIN_ARGUMENT , certain
#else
#define CERTAIN_PARAMETER
#define CERTAIN_ARGUMENT
#endif
#define HIT_PARAMETERS __global double *t_hit, __global uint *ids UV_PARAMETER T_ERR_PARAMETER CERTAIN_PARAMETER
#define HIT_ARGUMENTS t_hit, ids UV_ARGUMENT T_ERR_ARGUMENT CERTAIN_ARGUMENT

void store_hit(const Ray *ray, const Hit *hit, size_t i, HIT_PARAMETERS)
{
    const bool missed = hit->id == NO_HIT;
    t_hit[i] = missed ? INFINITY : reported_t(ray, &hit->meeting);
    ids[i] = hit->id;
#ifdef WITH_UVS
    uvs[2 * i] = hit->u;
    uvs[2 * i + 1] = hit->v;
#endif
#ifdef WITH_T_ERR
    t_errs[i] = missed ? 0.0 : hit->t_err;
#endif
#ifdef WITH_CERTAIN
    certain[i] = missed || hit->meeting.certain ? 1 : 0;
#endif
}

#endif
