// Adds what a light sends to the eye by way of each pixel's surface.
//   arriving, occluded   irradiance over the light's colour; 1 if something stands between
//   red, green, blue     the light's colour over pi
#include "picture_rays.h"

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void add_light(uint count, double red, double green, double blue, __global const double *arriving,
                        __global const uchar *occluded, __global const double *albedos, __global double *radiances)
{
    const double colour[3] = {red, green, blue};
    for (size_t i = first_pixel(); i < end_pixel(count); ++i)
        if (arriving[i] > 0.0 && !occluded[i])
            for (int c = 0; c < 3; ++c)
                radiances[3 * i + c] = radiances[3 * i + c] + albedos[3 * i + c] * (colour[c] * arriving[i]);
}
