// Rays from each pixel's surface to the sky, by the cosine from the triangle's normal: number `first` .. of
// cells_x x cells_y in all, each from its cell of the unit square, pictures of rays below each other.
//   distance              length of directions; 0: unit vectors
//   lifted                how far above the surface rays start (docs/numerics.md), scene units
//   origins, directions   3 doubles
#include "picture_rays.h"
#include "random.h"

#define QUARTER_PI 0x1.921fb54442d18p-1

// One less s times a series over n.
#define TERM(n, series) (1.0 - s * (1.0 / (n)) * (series))

// Sine and cosine of QUARTER_PI * share, |share| <= 1: what is left out of the series is below 2^-53.
void turned(double share, double *sine, double *cosine)
{
    const double x = QUARTER_PI * share, s = x * x;
    *sine = x * TERM(6.0, TERM(20.0, TERM(42.0, TERM(72.0, TERM(110.0, TERM(156.0, TERM(210.0, 1.0)))))));
    *cosine = TERM(2.0, TERM(12.0, TERM(30.0, TERM(56.0, TERM(90.0, TERM(132.0, TERM(182.0, TERM(240.0, 1.0))))))));
}

// From the unit square to the unit disc, areas in proportion (Shirley and Chiu 1997).
Place on_disc(Place square)
{
    const double x = 2.0 * square.x - 1.0, y = 2.0 * square.y - 1.0;
    Place place = {0.0, 0.0};
    double sine, cosine;
    if (x == 0.0 && y == 0.0)
        return place;
    if (fabs(x) > fabs(y)) {
        turned(y / x, &sine, &cosine);
        place.x = x * cosine;
        place.y = x * sine;
    } else {
        turned(x / y, &sine, &cosine);
        place.x = y * sine;
        place.y = y * cosine;
    }
    return place;
}

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void sky_rays(TILE_PARAMETERS, ulong seed, uint sample, uint first, uint rays, uint cells_x, uint cells_y,
                       double distance, double lifted, __global const uint *ids, __global const double *positions,
                       __global const double *faced, __global double *origins, __global double *directions)
{
    for (size_t i = first_pixel(); i < end_pixel(count); ++i) {
        if (ids[i] == NO_HIT) {
            for (uint k = 0; k < rays; ++k)
                store_no_ray((size_t)k * count + i, origins, directions);
            continue;
        }
        const ulong key = sample_key(seed, pixel_of(i, TILE_ARGUMENTS), sample);
        const double x = faced[3 * i], y = faced[3 * i + 1], z = faced[3 * i + 2];
        // Two axes beside the normal (Duff et al. 2017).
        const double side = z < 0.0 ? -1.0 : 1.0, a = -1.0 / (side + z), b = x * y * a;
        const double first_axis[3] = {1.0 + side * (x * x * a), side * b, -(side * x)};
        const double second_axis[3] = {b, side + y * y * a, -y};
        const double length = distance > 0.0 ? distance : 1.0;
        for (uint k = 0; k < rays; ++k) {
            const Place disc = on_disc(place_in_cell(key, first + k, cells_x, cells_y));
            const double up = sqrt(fmax(1.0 - (disc.x * disc.x + disc.y * disc.y), 0.0));
            const size_t at = 3 * ((size_t)k * count + i);
            for (int axis = 0; axis < 3; ++axis) {
                const double normal = faced[3 * i + axis];
                const double way = (disc.x * first_axis[axis] + disc.y * second_axis[axis]) + up * normal;
                origins[at + axis] = positions[3 * i + axis] + lifted * normal;
                directions[at + axis] = length * way;
            }
        }
    }
}
