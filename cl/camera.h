// Rays of a pinhole camera: the same bits as Camera.rays in Python, by + - * in float64 alone.
#ifndef CLG_CAMERA_H
#define CLG_CAMERA_H
#include "beam.h"

// Direction through the centre of pixel (x, y) of the window, row 0 on top; its component along the view axis is 1.
void camera_direction(__constant const CameraParams *camera, uint x, uint y, double *direction)
{
    const double right = ((double)(camera->left + x) + 0.5) - 0.5 * (double)camera->width;
    const double down = ((double)(camera->top + y) + 0.5) - 0.5 * (double)camera->height;
    for (int a = 0; a < 3; ++a) {
        const double across = camera->forward[a] + right * camera->step_x[a];
        direction[a] = across + down * camera->step_y[a];
    }
}

// The same through pixels x .. x + 3 of row y.
void camera_directions(__constant const CameraParams *camera, uint x, uint y, double directions[3][4])
{
    const double4 right = (convert_double4(camera->left + (uint4)(x, x + 1, x + 2, x + 3)) + 0.5)
                          - 0.5 * (double)camera->width;
    const double down = ((double)(camera->top + y) + 0.5) - 0.5 * (double)camera->height;
    for (int a = 0; a < 3; ++a) {
        const double4 across = camera->forward[a] + right * camera->step_x[a];
        vstore4(across + down * camera->step_y[a], 0, directions[a]);
    }
}

#ifdef CLG_WAY_H
// The way of the rays through pixels (left, top) .. (right, bottom), for passes_nothing. False: they share no axis, or
// come from so far that what rounding does to them may be more than BEAM_PAD. Of rays from one point, those through
// the corners have the least and the greatest slopes.
bool way_of_pixels(__constant const CameraParams *camera, __constant const FrameParams *frame,
                   __constant const GridParams *grid, uint left, uint top, uint right, uint bottom, Way *way)
{
    double view[4][3], middle[3] = {0.0, 0.0, 0.0}, eye[3], longest = 0.0;
    for (uint i = 0; i < 4; ++i)
        camera_direction(camera, i & 1 ? right : left, i & 2 ? bottom : top, view[i]);
    uint class = 0;
    for (uint a = 0; a < 3; ++a) {
        middle[a] = (view[0][a] + view[3][a]) + (view[1][a] + view[2][a]);
        eye[a] = (camera->eye[a] - frame->offset[a]) * frame->scale;
        if (!(fabs(eye[a]) < 0x1p+20))
            return false;
        if (fabs(middle[a]) > longest) {
            longest = fabs(middle[a]);
            class = 2 * a + (middle[a] < 0.0 ? 1 : 0);
        }
    }
    name_axes(way, class);
    const int kd = way->kd;
    const float start = (float)eye[kd], lower = (float)grid->lower[kd], upper = (float)grid->upper[kd];
    const bool climbs = way->side > 0.0f;
    way->from = (climbs ? max(start, lower) : lower) - BEAM_PAD;
    way->to = (climbs ? upper : min(start, upper)) + BEAM_PAD;
    const double near = way->from - eye[kd], far = max(way->to, way->from + SHORTEST_SPAN) - eye[kd];
    for (int i = 0; i < 2; ++i) {
        const int axis = i ? way->kv : way->ku;
        double least = INFINITY, greatest = -INFINITY;
        for (uint k = 0; k < 4; ++k) {
            const double slope = view[k][axis] / view[k][kd];
            if (!(view[k][kd] * way->side > 0.0 && fabs(slope) < 1.5))
                return false;
            least = min(least, slope);
            greatest = max(greatest, slope);
        }
        const double low_near = eye[axis] + min(near * least, near * greatest) - BEAM_PAD;
        const double low_far = eye[axis] + min(far * least, far * greatest) - BEAM_PAD;
        const double high_near = eye[axis] + max(near * least, near * greatest) + BEAM_PAD;
        const double high_far = eye[axis] + max(far * least, far * greatest) + BEAM_PAD;
        const double low_slope = (low_far - low_near) / (far - near), high_slope = (high_far - high_near) / (far - near);
        way->beam.slope[2 * i] = (float)low_slope;
        way->beam.slope[2 * i + 1] = (float)high_slope;
        way->beam.at[2 * i] = (float)(low_near - low_slope * way->from);
        way->beam.at[2 * i + 1] = (float)(high_near - high_slope * way->from);
    }
    return true;
}
#endif

#endif
