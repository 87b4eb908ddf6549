// Whether rays given as arrays (rays_in_out.h) meet anything. One work-item casts a tile of rays.
//   invalid[tile]     rays of the tile that have no direction or are not finite
//   occluded[ray]     1 if a triangle is met; a ray that a part before found so is not cast again
#define QUERY_ANY
#include "tile.h"
#include "rays_in_out.h"

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void cast_any(__constant const FrameParams *frame, GRID_PARAMETERS, MESH_PARAMETERS, RAY_PARAMETERS,
                       ORDER_PARAMETERS, __global uint *invalid, __global uchar *occluded)
{
    const size_t number = get_global_id(0);
    Tile tile;
    start_tile(&tile, frame, grid);
    invalid[number] = load_tile(&tile, number, ORDER_ARGUMENTS, frame, RAY_ARGUMENTS);
    for (uint k = 0; k < TILE_RAYS; ++k) {
        const size_t i = ray_in_tile(number, k, ORDER_ARGUMENTS);
        if (i < ray_count && occluded[i])
            tile.reach &= ~(1ul << k);
    }
    cast_tiles(&tile, 1, GRID_ARGUMENTS, MESH_ARGUMENTS);
    for (uint k = 0; k < TILE_RAYS; ++k) {
        const size_t i = ray_in_tile(number, k, ORDER_ARGUMENTS);
        if (i < ray_count && hit_of(&tile, k).id != NO_HIT)
            occluded[i] = 1;
    }
}
