// A ray brought from scene units into the local frame: unit size, near the mesh, `real` components.
// `robust` and `precise` define the ray as these values: all later stages see only them. To `exact` they
// are within ORIGIN_ERROR (triangle_exact.h) of the caller's ray, which it keeps.
#ifndef CLG_RAY_H
#define CLG_RAY_H
#include "config.h"
#ifdef WIDE_RAYS
#include "pair.h"
#endif

typedef struct {
    real origin[3];      // local, each within [-START_LIMIT, START_LIMIT]
    real direction[3];   // largest component within [0.5, 1]
    double t_min, t_max; // the caller's closed interval, in scene units of t
    double t_entry;      // local distance by which the origin was moved
    double t_unit;       // scene t of one local unit (a power of two)
    bool valid;          // false: not finite, no direction, or t beyond 2^+-960
    bool reaches;        // false: the ray never comes near the mesh
#ifdef RUNG_EXACT
    double caller_origin[3], caller_direction[3];
    double offset[3];    // of the local frame, in local units
    int frame_exponent;  // a local unit is 2^frame_exponent scene units
    int length_exponent; // direction = caller_direction * 2^length_exponent
    bool astray;         // farther away than the walk can follow: all triangles are tested
#endif
} Ray;

double power_of_two(int exponent)
{
    return as_double((ulong)(exponent + 1023) << 52);
}

// Exponent e with 2^(e-1) <= x < 2^e, for normal x > 0.
int exponent_above(double x)
{
    return (int)((as_ulong(x) >> 52) & 0x7FF) - 1022;
}

// Scene t of a local t.
double scene_t(const Ray *ray, real t)
{
    return (ray->t_entry + (double)t) * ray->t_unit;
}

// Whether a local t lies in the caller's interval: asked of the very value that is reported.
bool within_interval(const Ray *ray, real t)
{
    const double at = scene_t(ray, t);
    return at >= ray->t_min && at <= ray->t_max;
}

#ifdef WIDE_RAYS
// o + t d, rounded about once also where both are large: what sums and the product lose is kept and added.
double point_at(double o, double o_rest, double t, double d)
{
    if (fabs(t) > 0x1p+900)  // beyond two_product, and beyond what is promised
        return o + t * d;
    const Pair along = two_product(t, d);
    const Pair sum = two_sum(o, along.high);
    return sum.high + (sum.low + (o_rest + along.low));
}
#endif

Ray prepare_ray(const double *origin, const double *direction, double t_min, double t_max,
                __constant const FrameParams *frame)
{
    Ray ray;
    double o[3], d[3];
    double longest = 0.0, farthest = 0.0;
    bool finite = t_min == t_min && t_max == t_max;
    for (int a = 0; a < 3; ++a) {
        o[a] = (origin[a] - frame->offset[a]) * frame->scale;
        d[a] = direction[a];
        longest = fabs(d[a]) > longest ? fabs(d[a]) : longest;
        farthest = fabs(o[a]) > farthest ? fabs(o[a]) : farthest;
        finite = finite && isfinite(o[a]) && isfinite(d[a]);
    }
    ray.valid = finite && longest > 0.0;
    ray.reaches = false;
    ray.t_entry = 0.0;
    ray.t_unit = 1.0;
    ray.t_min = t_min;
    ray.t_max = t_max;
    for (int a = 0; a < 3; ++a)
        ray.origin[a] = ray.direction[a] = 0;
#ifdef RUNG_EXACT
    ray.astray = false;
#endif
    if (!ray.valid)
        return ray;

    // Two steps keep every factor a normal double, also for denormal and huge directions.
    const double first = longest < 0x1p-600 ? 0x1p+400 : longest > 0x1p+600 ? 0x1p-400 : 1.0;
    const double second = power_of_two(-exponent_above(longest * first));
    for (int a = 0; a < 3; ++a)
        d[a] = d[a] * first * second;
    ray.t_unit = frame->inverse_scale * first * second;
    // Beyond, t may have fewer digits than a double: intervals would lose their meaning.
    ray.valid = ray.t_unit >= 0x1p-960 && ray.t_unit <= 0x1p+960;
    if (!ray.valid)
        return ray;

#ifdef RUNG_EXACT
    for (int a = 0; a < 3; ++a) {
        ray.caller_origin[a] = origin[a];
        ray.caller_direction[a] = direction[a];
        ray.offset[a] = frame->offset[a] * frame->scale;
    }
    ray.frame_exponent = exponent_above(frame->inverse_scale) - 1;
    ray.length_exponent = exponent_above(first) + exponent_above(second) - 2;
    if (farthest > FARTHEST_ORIGIN) {
        ray.astray = ray.reaches = true;
        return ray;
    }
#endif
    // A distant origin would cost the float32 test its digits: start where the ray comes near.
    if (farthest > START_LIMIT) {
        double t_near = -INFINITY, t_far = INFINITY;
        for (int a = 0; a < 3; ++a) {
            if (d[a] != 0.0) {
                const double side = d[a] > 0.0 ? ENTRY_CUBE : -ENTRY_CUBE;
                const double t0 = (-side - o[a]) / d[a], t1 = (side - o[a]) / d[a];
                t_near = t0 > t_near ? t0 : t_near;
                t_far = t1 < t_far ? t1 : t_far;
            } else if (fabs(o[a]) > ENTRY_CUBE) {
                return ray;
            }
        }
        // Beyond what a double holds, nothing that follows would have a meaning.
        if (!(t_near <= t_far) || t_near == INFINITY)
            return ray;
        ray.t_entry = t_near;
    }
    for (int a = 0; a < 3; ++a) {
#ifdef WIDE_RAYS
        const Pair exact = two_sum(origin[a], -frame->offset[a]);
        const double start = point_at(o[a], exact.low * frame->scale, ray.t_entry, d[a]);
#else
        const double start = o[a] + ray.t_entry * d[a];
#endif
        ray.origin[a] = (real)(start < -START_LIMIT ? -START_LIMIT : start > START_LIMIT ? START_LIMIT : start);
        ray.direction[a] = (real)d[a];
    }
    ray.reaches = true;
    return ray;
}

#endif
