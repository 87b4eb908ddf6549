// Whether rays given as arrays (rays_in_out.h) meet anything. One work-item casts a tile of rays.
//   invalid[tile]     rays of the tile that have no direction or are not finite
//   occluded[ray]     1 if a triangle is met; a ray that a part before found so is not cast again
#define QUERY_ANY
#include "tile.h"
#include "rays_in_out.h"

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void cast_any(__constant const FrameParams *frame, GRID_PARAMETERS, MESH_PARAMETERS, RAY_PARAMETERS,
                       uint ray_count, __global uint *invalid, __global uchar *occluded)
{
    const size_t begin = (size_t)get_global_id(0) * TILE_RAYS, end = min(begin + TILE_RAYS, (size_t)ray_count);
    Tile tile;
    start_tile(&tile, grid->triangle_count);
    invalid[get_global_id(0)] = load_tile(&tile, begin, end, frame, RAY_ARGUMENTS);
    for (size_t i = begin; i < end; ++i)
        if (occluded[i])
            tile.reach &= ~(1ul << (i - begin));
    cast_tile(&tile, GRID_ARGUMENTS, MESH_ARGUMENTS);
    for (size_t i = begin; i < end; ++i)
        if (hit_of(&tile, (uint)(i - begin)).id != NO_HIT)
            occluded[i] = 1;
}
