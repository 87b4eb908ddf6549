// Adds a sample to each pixel's sum, and makes the picture of the sums after the last.
//   sums    4 doubles: colour, number of hits       open   of sky_rays rays; all of the sky where there are none
//   rgba    4 floats: mean colour (box filter), share of samples that hit
#include "picture_rays.h"

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void add_sample(uint count, uint sample, uint samples, uint sky_rays, double sky_r, double sky_g,
                         double sky_b, double background_r, double background_g, double background_b,
                         __global const uint *ids, __global const double *albedos, __global const double *radiances,
                         __global const uint *open, __global double *sums, __global float *rgba)
{
    const double sky[3] = {sky_r, sky_g, sky_b}, background[3] = {background_r, background_g, background_b};
    for (size_t i = first_pixel(); i < end_pixel(count); ++i) {
        const bool hit = ids[i] != NO_HIT;
        const double share = hit && sky_rays > 0 ? (double)open[i] / (double)sky_rays : 1.0;
        for (int c = 0; c < 4; ++c) {
            double seen = hit ? 1.0 : 0.0;
            if (c < 3)
                seen = hit ? radiances[3 * i + c] + albedos[3 * i + c] * (sky[c] * share) : background[c];
            const double sum = (sample > 0 ? sums[4 * i + c] : 0.0) + seen;
            sums[4 * i + c] = sum;
            if (sample + 1 == samples)
                rgba[4 * i + c] = (float)(sum / (double)samples);
        }
    }
}
