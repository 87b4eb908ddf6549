// The pixels that a launch of a shading stage works on: those of a tile of the window, row by row.
#ifndef CLG_PICTURE_RAYS_H
#define CLG_PICTURE_RAYS_H
#include "config.h"

// Pixels that a work-item takes one after another.
#define PIXELS_PER_ITEM 64u

// Column and row of the tile's first pixel in the window, and columns; pixels of it in all.
#define TILE_PARAMETERS __constant const CameraParams *camera, uint tile_x, uint tile_y, uint columns, uint count
#define TILE_ARGUMENTS camera, tile_x, tile_y, columns, count

size_t first_pixel(void)
{
    return (size_t)get_global_id(0) * PIXELS_PER_ITEM;
}

size_t end_pixel(uint count)
{
    return min(first_pixel() + PIXELS_PER_ITEM, (size_t)count);
}

uint column_of(size_t i, TILE_PARAMETERS)
{
    return camera->left + tile_x + (uint)(i % columns);
}

uint row_of(size_t i, TILE_PARAMETERS)
{
    return camera->top + tile_y + (uint)(i / columns);
}

// Number of pixel i of the tile in the whole picture.
ulong pixel_of(size_t i, TILE_PARAMETERS)
{
    return (ulong)row_of(i, TILE_ARGUMENTS) * camera->width + column_of(i, TILE_ARGUMENTS);
}

// No ray: what has no direction meets nothing.
void store_no_ray(size_t i, __global double *origins, __global double *directions)
{
    for (int a = 0; a < 3; ++a)
        origins[3 * i + a] = directions[3 * i + a] = 0.0;
}

#endif
