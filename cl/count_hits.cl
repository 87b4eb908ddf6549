// How many triangles rays given as arrays (rays_in_out.h) meet. One work-item casts a tile of rays.
//   invalid[tile]     rays of the tile that have no direction or are not finite
//   counts[ray]       is added to, part after part
//   OPEN_START        rung `exact`: the ray's start is moved by an infinitesimal, and no interval asked
#define QUERY_COUNT
#include "tile.h"
#include "rays_in_out.h"

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void count_hits(__constant const FrameParams *frame, GRID_PARAMETERS, MESH_PARAMETERS, RAY_PARAMETERS,
                         ORDER_PARAMETERS, __global uint *invalid, __global uint *counts)
{
    const size_t number = get_global_id(0);
    Tile tile;
    start_tile(&tile, frame, grid);
    invalid[number] = load_tile(&tile, number, ORDER_ARGUMENTS, frame, RAY_ARGUMENTS);
    cast_tiles(&tile, 1, GRID_ARGUMENTS, MESH_ARGUMENTS);
    for (uint k = 0; k < TILE_RAYS; ++k) {
        const size_t i = ray_in_tile(number, k, ORDER_ARGUMENTS);
        if (i < ray_count)
            counts[i] += hit_of(&tile, k).count;
    }
}
