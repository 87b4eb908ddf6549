// How far the t of a hit may be from where the caller's ray meets the caller's triangle: running error
// analysis (after Higham 2002; pbrt-v4), derived in docs/numerics.md, "The error of t".
#ifndef CLG_T_ERROR_H
#define CLG_T_ERROR_H
#include "ray.h"

// A hit as the sheared triangle has it: coordinates, the edge functions' sum, and t.
typedef struct {
    double x[3], y[3], z[3];
    double det, t, z_scale;
} Crossing;

// `unit` is the rounding of the coordinates; the point that t belongs to is up to `aside` off the ray, and
// t up to `late` off that point's.
double t_error(const Crossing *c, double unit, double aside, double late)
{
    double reach = 0.0, depth = 0.0, extent = 0.0;
    for (int i = 0; i < 3; ++i) {
        reach = fmax(reach, fmax(fabs(c->x[i]), fabs(c->y[i])));
        depth = fmax(depth, fabs(c->z[i] - c->z[0]));
        // A crossing lies between the depths of the corners.
        extent = fmax(extent, fabs(c->z[i] * c->z_scale - c->t));
    }
    // The plane's slope against the ray, as a quotient of determinants, at the worst of their errors.
    const double bz = c->z[1] - c->z[0], cz = c->z[2] - c->z[0];
    const double bx = c->x[1] - c->x[0], cx = c->x[2] - c->x[0];
    const double by = c->y[1] - c->y[0], cy = c->y[2] - c->y[0];
    const double along = fabs(bz * cy - cz * by) + fabs(cz * bx - bz * cx)
                         + (400 * unit * (reach + depth) + 8192 * unit * unit);
    const double across = fabs(c->det) - (450 * unit * reach + 8192 * unit * unit);
    double off = extent;
    if (across > 0.0) {
        const double slide = fabs(c->z_scale) * (aside * (along / across));
        off = slide < off ? slide : off;
    }
    return off + late;
}

// The same for the t that is reported, in the caller's lengths.
double scene_t_error(const Ray *ray, double t, double error)
{
    return (error + 0x1p-51 * fabs(ray->t_entry + t)) * ray->t_unit * (1.0 + 0x1p-40) + 0x1p-1074;
}

#ifdef RUNG_EXACT
// t_error of four; the sheared triangles as in Crossing.
double4 t_errors(const double4 *x, const double4 *y, const double4 *z, double4 det, double4 t, double4 z_scale,
                 double unit, double4 aside, double late)
{
    double4 reach = (double4)(0.0), depth = (double4)(0.0), extent = (double4)(0.0);
    for (int i = 0; i < 3; ++i) {
        reach = max(reach, max(fabs(x[i]), fabs(y[i])));
        depth = max(depth, fabs(z[i] - z[0]));
        extent = max(extent, fabs(z[i] * z_scale - t));
    }
    const double4 bz = z[1] - z[0], cz = z[2] - z[0];
    const double4 bx = x[1] - x[0], cx = x[2] - x[0];
    const double4 by = y[1] - y[0], cy = y[2] - y[0];
    const double4 along = fabs(bz * cy - cz * by) + fabs(cz * bx - bz * cx)
                          + (400 * unit * (reach + depth) + 8192 * unit * unit);
    const double4 across = fabs(det) - (450 * unit * reach + 8192 * unit * unit);
    const double4 slide = fabs(z_scale) * (aside * (along / across));
    return (((across > 0.0) & (slide < extent)) ? slide : extent) + late;
}
#endif

#endif
