// Counters to ends of lists: the inclusive prefix sum, in place, from `sum` on. Returns how many were not 0.
// Most cells are empty, and most of them lie together.
#ifndef CLG_TALLY_H
#define CLG_TALLY_H
#include "config.h"

uint sum_up(__global ref_index *count, uint size, ref_index sum)
{
    uint full = 0, i = 0;
    for (; i + 8 <= size; i += 8) {
        const ref_index any = count[i] | count[i + 1] | count[i + 2] | count[i + 3] | count[i + 4] |
                              count[i + 5] | count[i + 6] | count[i + 7];
        if (any == 0) {
#pragma unroll
            for (uint k = 0; k < 8; ++k)
                count[i + k] = sum;
            continue;
        }
#pragma unroll
        for (uint k = 0; k < 8; ++k) {
            full += count[i + k] != 0;
            sum += count[i + k];
            count[i + k] = sum;
        }
    }
    for (; i < size; ++i) {
        full += count[i] != 0;
        sum += count[i];
        count[i] = sum;
    }
    return full;
}

#endif
