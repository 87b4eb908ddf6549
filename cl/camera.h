// Rays of a pinhole camera: the same bits as Camera.rays in Python, by + - * in float64 alone.
#ifndef CLG_CAMERA_H
#define CLG_CAMERA_H
#include "beam.h"

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

// Whether no ray through pixels (left, top) .. (right, bottom) comes near the grid: whether its box, BEAM_PAD wider, lies on
// the far side of one of the four planes through the eye and the outermost rays. What is rounded is below 2^-46 of
// the lengths multiplied.
bool sees_nothing(__constant const CameraParams *camera, __constant const FrameParams *frame,
                  __constant const GridParams *grid, uint left, uint top, uint right, uint bottom)
{
    double4 view[4], middle = (double4)(0.0);
    for (uint i = 0; i < 4; ++i) {
        double d[3];
        camera_direction(camera, i == 1 || i == 2 ? right : left, i >= 2 ? bottom : top, d);
        view[i] = (double4)(d[0], d[1], d[2], 0.0);
        middle = middle + view[i];
    }
    const double4 eye = (double4)(camera->eye[0], camera->eye[1], camera->eye[2], 0.0);
    const double4 offset = (double4)(frame->offset[0], frame->offset[1], frame->offset[2], 0.0);
    const double4 lower = (double4)(grid->lower[0], grid->lower[1], grid->lower[2], 0.0);
    const double4 upper = (double4)(grid->upper[0], grid->upper[1], grid->upper[2], 0.0);
    const double4 extent = (upper - lower) * 0.5, to_box = (lower + upper) * 0.5 - (eye - offset) * frame->scale;
    // From farther away, what rounding does to the rays may be more than BEAM_PAD there.
    if (!(fmax(fmax(fabs(to_box.x), fabs(to_box.y)), fabs(to_box.z)) < 0x1p+20))
        return false;
    for (uint i = 0; i < 4; ++i) {
        const double4 a = view[i], b = view[(i + 1) % 4];
        const double4 n = a.yzxw * b.zxyw - a.zxyw * b.yzxw;
        const double4 terms = fabs(a.yzxw * b.zxyw) + fabs(a.zxyw * b.yzxw);
        const double4 along = n * middle, unsure = terms * fabs(middle);
        const double side = along.x + along.y + along.z;
        if (!(fabs(side) > 0x1p-46 * (unsure.x + unsure.y + unsure.z)))
            continue;
        const double4 inward = side < 0.0 ? -n : n, size = fabs(n);
        const double4 far = inward * to_box, room = size * (extent + BEAM_PAD);
        const double4 doubt = terms * (fabs(to_box) + extent);
        if ((far.x + far.y + far.z) + (room.x + room.y + room.z) < -0x1p-46 * (doubt.x + doubt.y + doubt.z))
            return true;
    }
    return false;
}

#endif
