// A ray from each pixel's surface to a light; none where nothing of it can arrive.
//   lifted                how far above the surface rays start (docs/numerics.md), scene units
//   arriving              irradiance over the light's colour, if nothing stands between
//   origins, directions   3 doubles: to the light's own position at t = 1, or unit vectors to a directional one
#include "picture_rays.h"

#define DIRECTIONAL 0ul
#define SPOT 2ul

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void light_rays(__constant const LightParams *light, uint count, double lifted, __global const uint *ids,
                         __global const double *positions, __global const double *faced,
                         __global const double *shaded, __global double *arriving, __global double *origins,
                         __global double *directions)
{
    for (size_t i = first_pixel(); i < end_pixel(count); ++i) {
        arriving[i] = 0.0;
        store_no_ray(i, origins, directions);
        if (ids[i] == NO_HIT)
            continue;
        double to[3], square = 0.0, above = 0.0, facing = 0.0, along = 0.0, start[3];
        for (int a = 0; a < 3; ++a) {
            start[a] = positions[3 * i + a] + lifted * faced[3 * i + a];
            to[a] = light->kind == DIRECTIONAL ? -light->direction[a] : light->position[a] - positions[3 * i + a];
            square = square + to[a] * to[a];
            above = above + to[a] * faced[3 * i + a];
            facing = facing + to[a] * shaded[3 * i + a];
            along = along - to[a] * light->direction[a];
        }
        const double distance = sqrt(square);
        // A light nearer than that lies in the surface.
        if (!(facing > 0.0 && square < INFINITY)
            || !(light->kind == DIRECTIONAL ? above > 0.0 : above > lifted))
            continue;
        double strength = facing / distance;
        if (light->kind != DIRECTIONAL) {
            const double share = distance / light->reach, squared = share * share;
            const double window = fmin(fmax(1.0 - squared * squared, 0.0), 1.0);
            strength = strength * window / square;
        }
        if (light->kind == SPOT) {
            const double cone = fmin(fmax(along / distance * light->spot_scale + light->spot_offset, 0.0), 1.0);
            strength = strength * (cone * cone);
        }
        if (!(strength > 0.0))
            continue;
        arriving[i] = strength;
        for (int a = 0; a < 3; ++a) {
            origins[3 * i + a] = start[a];
            directions[3 * i + a] = light->kind == DIRECTIONAL ? to[a] : light->position[a] - start[a];
        }
    }
}
