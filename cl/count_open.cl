// Counts the rays of each pixel that nothing stands before.
//   occluded   pictures of `count` rays, one after another
//   open       so many so far; from 0 on where `first` is set
#include "picture_rays.h"

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void count_open(uint count, uint rays, uint first, __global const uchar *occluded, __global uint *open)
{
    for (size_t i = first_pixel(); i < end_pixel(count); ++i) {
        uint found = first ? 0u : open[i];
        for (uint k = 0; k < rays; ++k)
            found += occluded[(size_t)k * count + i] ? 0u : 1u;
        open[i] = found;
    }
}
