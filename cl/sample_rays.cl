// One ray a pixel of a tile: through its middle if it is the only one, else through a seeded place in cell `sample`
// of cells_x x cells_y. The bits of Camera.rays through the middle.
//   origins, directions   3 doubles a pixel
#include "picture_rays.h"
#include "random.h"

// Number of the "ray" that places a sample: none of the occlusion rays has it.
#define PLACING 0x5A11CEul

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void sample_rays(TILE_PARAMETERS, ulong seed, uint sample, uint cells_x, uint cells_y,
                          __global double *origins, __global double *directions)
{
    for (size_t i = first_pixel(); i < end_pixel(count); ++i) {
        Place place = {0.5, 0.5};
        if (cells_x * cells_y > 1)
            place = place_in_cell(mixed(sample_key(seed, pixel_of(i, TILE_ARGUMENTS), 0) ^ PLACING), sample, cells_x,
                                  cells_y);
        const double right = ((double)column_of(i, TILE_ARGUMENTS) + place.x) - 0.5 * (double)camera->width;
        const double down = ((double)row_of(i, TILE_ARGUMENTS) + place.y) - 0.5 * (double)camera->height;
        for (int a = 0; a < 3; ++a) {
            const double from = camera->parallel ? camera->eye[a] : camera->forward[a];
            const double moved = (from + right * camera->step_x[a]) + down * camera->step_y[a];
            origins[3 * i + a] = camera->parallel ? moved : camera->eye[a];
            directions[3 * i + a] = camera->parallel ? camera->forward[a] : moved;
        }
    }
}
