// A key for each ray given as arrays (rays_in.h), such that rays of near keys run near each other: the major axis
// and the way along it, then, bit by bit in turn, where the ray enters and leaves the grid's bounds (Morton 1966),
// then the ray's number, so that sorted keys are an order. Hits do not depend on it.
#include "rays_in.h"

// Bit i of x, below 2^6, to bit 6 i.
ulong4 spread(ulong4 x)
{
    x = (x | x << 20) & 0x0F00000Ful;
    x = (x | x << 10) & 0x3003003003ul;
    return (x | x << 5) & 0x41041041041ul;
}

// Which of 64 slabs x is in.
uint8 slab(float8 x, float lower, float upper)
{
    return convert_uint8(fmin(fmax((x - lower) * (64.0f / (upper - lower)), 0.0f), 63.0f));
}

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void ray_keys(__constant const FrameParams *frame, __constant const GridParams *grid, RAY_PARAMETERS,
                       uint ray_count, __global ulong *keys)
{
    const size_t begin = (size_t)get_global_id(0) * RAYS_PER_ITEM, end = min(begin + RAYS_PER_ITEM, (size_t)ray_count);
    for (size_t first = begin; first < end; first += 8) {
        float8 o[3], d[3], t_in, t_out;
        for (uint lane = 0; lane < 8; ++lane) {
            const size_t i = min(first + lane, end - 1);
            for (int a = 0; a < 3; ++a) {
                ((float *)(o + a))[lane] = (float)(((double)origins[3 * i + a] - frame->offset[a]) * frame->scale);
                ((float *)(d + a))[lane] = (float)((double)directions[3 * i + a] * frame->scale);
            }
            ((float *)&t_in)[lane] = (float)T_BOUNDS(i)[0];
            ((float *)&t_out)[lane] = (float)T_BOUNDS(i)[1];
        }
        float8 longest = 0.0f;
        int8 major = 0;
        for (int a = 0; a < 3; ++a) {
            const float8 length = fabs(d[a]), inverse = 1.0f / d[a];
            const float8 t0 = ((float)grid->lower[a] - o[a]) * inverse, t1 = ((float)grid->upper[a] - o[a]) * inverse;
            major = length > longest ? 2 * a + (d[a] < 0.0f ? (int8)(1) : (int8)(0)) : major;
            longest = fmax(length, longest);
            t_in = fmax(t_in, fmin(t0, t1));
            t_out = fmin(t_out, fmax(t0, t1));
        }
        ulong4 low = convert_ulong4(major.lo) << 36, high = convert_ulong4(major.hi) << 36;
        for (int a = 0; a < 3; ++a) {
            const uint8 in = slab(o[a] + t_in * d[a], (float)grid->lower[a], (float)grid->upper[a]);
            const uint8 out = slab(o[a] + t_out * d[a], (float)grid->lower[a], (float)grid->upper[a]);
            low |= spread(convert_ulong4(in.lo)) << (2 * a) | spread(convert_ulong4(out.lo)) << (2 * a + 1);
            high |= spread(convert_ulong4(in.hi)) << (2 * a) | spread(convert_ulong4(out.hi)) << (2 * a + 1);
        }
        const ulong4 halves[2] = {low, high};
        for (uint lane = 0; lane < 8 && first + lane < end; ++lane)
            keys[first + lane] = ((const ulong *)halves)[lane] << NUMBER_BITS | (first + lane);
    }
}
