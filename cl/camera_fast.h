// Rung `fast`: the camera rays of a tile, told from the ray through its middle, which alone is in float64.
#ifndef CLG_CAMERA_FAST_H
#define CLG_CAMERA_FAST_H
#include "tile_rays.h"

// Local t at which a distant ray comes near the mesh, which is within sqrt(3) of the local origin.
double t_near(const double *o, const double *d)
{
    if (fmax(fmax(fabs(o[0]), fabs(o[1])), fabs(o[2])) <= START_LIMIT)
        return 0.0;
    const double square = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
    const double middle = -(o[0] * d[0] + o[1] * d[1] + o[2] * d[2]) / square;
    return fmax(middle - START_LIMIT / sqrt(square), 0.0);
}

// The rays of the pixels from (left, top) on; a group is 4 x 2 of them, as in render.cl.
void set_camera_rays(Tile *tile, __constant const CameraParams *camera, __constant const FrameParams *frame, uint left,
                     uint top)
{
    const double right = (double)(camera->left + left) + 4.0 - 0.5 * (double)camera->width;
    const double down = (double)(camera->top + top) + 4.0 - 0.5 * (double)camera->height;
    double o[3], d[3];
    for (int a = 0; a < 3; ++a) {
        o[a] = (camera->eye[a] - frame->offset[a]) * frame->scale;
        d[a] = camera->forward[a] + right * camera->step_x[a] + down * camera->step_y[a];
    }
    const double entry = t_near(o, d);
    for (uint g = 0; g < GROUPS; ++g) {
        const float8 x = (float8)(-3.5f, -2.5f, -1.5f, -0.5f, -3.5f, -2.5f, -1.5f, -0.5f) + (float)(g % 2 * 4);
        const float8 y = (float8)(-3.5f, -3.5f, -3.5f, -3.5f, -2.5f, -2.5f, -2.5f, -2.5f) + (float)(g / 2 * 2);
        float8 direction[3], longest = (float8)(0.0f);
        for (int a = 0; a < 3; ++a) {
            const float8 aside = x * (float)camera->step_x[a] + y * (float)camera->step_y[a];
            direction[a] = (float)d[a] + aside;
            vstore8((float)(o[a] + entry * d[a]) + (float)entry * aside, g, tile->o[a]);
            longest = max(longest, fabs(direction[a]));
        }
        // A power of two that brings the largest component within [0.5, 1), by its bits, and the inverse.
        const uint8 exponent = as_uint8(longest) & 0x7F800000u;
        const float8 factor = as_float8(0x7E800000u - exponent), inverse = as_float8(exponent + 0x00800000u);
        for (int a = 0; a < 3; ++a)
            vstore8(direction[a] * factor, g, tile->d[a]);
        for (uint upper = 0; upper < 2; ++upper) {
            const uint i = 2 * g + upper;
            vstore4((double4)(0.0), i, tile->t_min);
            vstore4((double4)(INFINITY), i, tile->t_max);
            vstore4(entry * convert_double4(upper ? inverse.hi : inverse.lo), i, tile->t_entry);
            vstore4(frame->inverse_scale * convert_double4(upper ? factor.hi : factor.lo), i, tile->t_unit);
        }
    }
    tile->valid = tile->reach = ~0ul;
}

#endif
