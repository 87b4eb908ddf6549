// Empty-space skipping, stage 1: distances[brick] = 0 where a brick of BRICK^3 cells holds a reference,
// else FAR_AWAY. One work-item takes one layer of bricks.
#include "lists.h"

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void mark_bricks(__constant const GridParams *grid, LIST_PARAMETERS, __global uchar *distances)
{
    const uint mx = grid->resolution[0], my = grid->resolution[1], mz = grid->resolution[2];
    const uint bx = (mx + BRICK - 1) / BRICK, by = (my + BRICK - 1) / BRICK;
    const uint layer = get_global_id(0);
    __global uchar *out = distances + (size_t)layer * by * bx;
    for (uint i = 0; i < by * bx; ++i)
        out[i] = FAR_AWAY;
    const uint z_end = min((layer + 1) * BRICK, mz);
    for (uint z = layer * BRICK; z < z_end; ++z) {
        for (uint y = 0; y < my; ++y) {
            const uint row = (z * my + y) * mx;
            __global uchar *brick_row = out + (y / BRICK) * bx;
            for (uint b = 0; b < bx; ++b)
                if (brick_row[b] != 0 && !all_empty(row + b * BRICK, min(BRICK, mx - b * BRICK), grid, LIST_ARGUMENTS))
                    brick_row[b] = 0;
        }
    }
}
