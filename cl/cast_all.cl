// Every triangle that rays given as arrays (rays_in_out.h) meet, sorted by t. One work-item casts a tile of rays.
// The hits of each ray are written from starts[ray] on, as far as there is room before starts[ray + 1].
//   counts[ray]       all of its hits, also those for which there was no room
//   invalid[tile]     rays of the tile that have no direction or are not finite
#define QUERY_ALL
#include "tile.h"
#include "rays_in_out.h"

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void cast_all(__constant const FrameParams *frame, GRID_PARAMETERS, MESH_PARAMETERS, RAY_PARAMETERS,
                       ORDER_PARAMETERS, __global uint *invalid, __global uint *counts,
                       __global const ulong *starts, HIT_PARAMETERS)
{
    const size_t number = get_global_id(0);
    Tile tile;
    start_tile(&tile, frame, grid);
    invalid[number] = load_tile(&tile, number, ORDER_ARGUMENTS, frame, RAY_ARGUMENTS);
    for (uint k = 0; k < TILE_RAYS; ++k) {
        const size_t i = ray_in_tile(number, k, ORDER_ARGUMENTS);
        if (i >= ray_count)
            continue;
        Records *records = &tile.hits[k].records;
        records->t = t_hit;
        records->ids = ids;
#ifdef WITH_UVS
        records->uvs = uvs;
#endif
#ifdef WITH_T_ERR
        records->t_errs = t_errs;
#endif
        records->begin = starts[i];
        records->end = starts[i + 1];
    }
    cast_tiles(&tile, 1, GRID_ARGUMENTS, MESH_ARGUMENTS);
    for (uint k = 0; k < TILE_RAYS; ++k) {
        const size_t i = ray_in_tile(number, k, ORDER_ARGUMENTS);
        if (i >= ray_count)
            continue;
        const Hit found = hit_of(&tile, k);
        const Ray ray = ray_of(&tile, k);
        if (found.count <= found.records.end - found.records.begin)
            sort_records(&found.records, &ray, MESH_ARGUMENTS, found.count);
        counts[i] = found.count;
    }
}
