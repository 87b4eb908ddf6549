// Rays of a pinhole camera: the same bits as Camera.rays in Python, by + - * in float64 alone.
#ifndef CLG_CAMERA_H
#define CLG_CAMERA_H
#include "config.h"

// Direction through the centre of pixel (x, y), row 0 on top; its component along the view axis is 1.
void camera_direction(__constant const CameraParams *camera, uint x, uint y, double *direction)
{
    const double right = ((double)x + 0.5) - 0.5 * (double)camera->width;
    const double down = ((double)y + 0.5) - 0.5 * (double)camera->height;
    for (int a = 0; a < 3; ++a) {
        const double across = camera->forward[a] + right * camera->step_x[a];
        direction[a] = across + down * camera->step_y[a];
    }
}

// The same through pixels x .. x + 3 of row y.
void camera_directions(__constant const CameraParams *camera, uint x, uint y, double directions[3][4])
{
    const double4 right = (convert_double4((uint4)(x, x + 1, x + 2, x + 3)) + 0.5) - 0.5 * (double)camera->width;
    const double down = ((double)y + 0.5) - 0.5 * (double)camera->height;
    for (int a = 0; a < 3; ++a) {
        const double4 across = camera->forward[a] + right * camera->step_x[a];
        vstore4(across + down * camera->step_y[a], 0, directions[a]);
    }
}

#endif
