// A number for each ray given as arrays (rays_in.h), such that rays of near numbers run near each other: the
// major axis and the way along it, then, bit by bit in turn, where the ray enters and leaves the grid's bounds
// (Morton 1966). Hits do not depend on it.
#include "rays_in.h"

// Bit i of x, below 2^8, to bit 6 i.
ulong spread(ulong x)
{
    x = (x | x << 20) & 0x0F00000Ful;
    x = (x | x << 10) & 0x3003003003ul;
    return (x | x << 5) & 0x41041041041ul;
}

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void ray_keys(__constant const FrameParams *frame, __constant const GridParams *grid, RAY_PARAMETERS,
                       uint ray_count, __global ulong *keys)
{
    const size_t begin = (size_t)get_global_id(0) * RAYS_PER_ITEM, end = min(begin + RAYS_PER_ITEM, (size_t)ray_count);
    for (size_t i = begin; i < end; ++i) {
        float t_in = (float)T_BOUNDS(i)[0], t_out = (float)T_BOUNDS(i)[1];
        float o[3], d[3], longest = 0.0f;
        uint major = 0;
        for (int a = 0; a < 3; ++a) {
            o[a] = (float)(((double)origins[3 * i + a] - frame->offset[a]) * frame->scale);
            d[a] = (float)((double)directions[3 * i + a] * frame->scale);
            major = fabs(d[a]) > longest ? 2 * a + (d[a] < 0.0f ? 1 : 0) : major;
            longest = fmax(fabs(d[a]), longest);
            const float t0 = ((float)grid->lower[a] - o[a]) / d[a], t1 = ((float)grid->upper[a] - o[a]) / d[a];
            t_in = fmax(t_in, fmin(t0, t1));
            t_out = fmin(t_out, fmax(t0, t1));
        }
        ulong key = (ulong)major << 48;
        for (int a = 0; a < 3; ++a) {
            const float lower = (float)grid->lower[a], scale = 256.0f / ((float)grid->upper[a] - lower);
            const float first = (o[a] + t_in * d[a] - lower) * scale, last = (o[a] + t_out * d[a] - lower) * scale;
            key |= spread((ulong)fmin(fmax(first, 0.0f), 255.0f)) << (2 * a);
            key |= spread((ulong)fmin(fmax(last, 0.0f), 255.0f)) << (2 * a + 1);
        }
        keys[i] = key;
    }
}
