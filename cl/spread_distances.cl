// Empty-space skipping, stage 2: distances[brick] becomes the Chebyshev distance, in bricks, to the nearest
// brick that holds a reference, at most FAR_AWAY (Cohen & Sheffer 1994, "Proximity clouds"). Two raster
// sweeps over the 26 neighbours with weight 1 are exact for this metric. There are 64 times fewer
// bricks than cells, so one work-item does it.
#include "config.h"

// out = min(out, 1 + the three bricks of `row` at and beside each).
void relax(__global uchar *out, __global const uchar *row, int count)
{
    for (int i = 0; i < count; ++i) {
        uchar least = row[i];
        least = i > 0 ? min(least, row[i - 1]) : least;
        least = i + 1 < count ? min(least, row[i + 1]) : least;
        out[i] = min(out[i], add_sat(least, (uchar)1));
    }
}

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void spread_distances(int bx, int by, int bz, __global uchar *distances)
{
    for (int pass = 0; pass < 2; ++pass) {
        const int way = pass == 0 ? -1 : 1;
        for (int k = 0; k < bz; ++k) {
            const int z = pass == 0 ? k : bz - 1 - k;
            for (int j = 0; j < by; ++j) {
                const int y = pass == 0 ? j : by - 1 - j;
                __global uchar *row = distances + ((size_t)z * by + y) * bx;
                if (z + way >= 0 && z + way < bz)
                    for (int yy = max(y - 1, 0); yy <= min(y + 1, by - 1); ++yy)
                        relax(row, distances + ((size_t)(z + way) * by + yy) * bx, bx);
                if (y + way >= 0 && y + way < by)
                    relax(row, row + way * bx, bx);
                if (pass == 0)
                    for (int x = 1; x < bx; ++x)
                        row[x] = min(row[x], add_sat(row[x - 1], (uchar)1));
                else
                    for (int x = bx - 2; x >= 0; --x)
                        row[x] = min(row[x], add_sat(row[x + 1], (uchar)1));
            }
        }
    }
}
