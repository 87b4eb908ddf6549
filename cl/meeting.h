// Where a ray's line meets a triangle's plane, for rungs that know t as one number: all but `exact`.
#ifndef CLG_MEETING_H
#define CLG_MEETING_H
#include "ray.h"

typedef struct {
    real t;
} Meeting;

bool within(const Ray *ray, const Meeting *meeting)
{
    return within_interval(ray, meeting->t);
}

// Whether the meeting with triangle `id` comes before that with `other`, by the t that is reported: ties go to
// the lowest id.
bool before(const Ray *ray, uint id, const Meeting *meeting, uint other, const Meeting *best)
{
    const double t = scene_t(ray, meeting->t), least = scene_t(ray, best->t);
    return t < least || (t == least && id < other);
}

double reported_t(const Ray *ray, const Meeting *meeting)
{
    return scene_t(ray, meeting->t);
}

#endif
