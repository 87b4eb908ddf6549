// Tiles of up to 64 rays, cast together where they keep together: the triangles of the cells that any of them
// may pass are brought in once for all (slices.h). Rays that spread too far go each its own way. What is kept of a
// triangle is the same either way (triangle.h), and so are the bits of all hits.
//   IN_TURNS   where they do, so many at once take turns (herd.h): worth it for meshes that caches do not hold
// Numbers that are tuned, in upper case, come from clgrid/tuning.py.
#ifndef CLG_TILE_H
#define CLG_TILE_H
#include "grid.h"
#ifdef IN_TURNS
#include "herd.h"
#endif
#include "tile_rays.h"
#ifndef ALONE
#include "slices.h"
#endif

// Fewer rays of a major axis go one by one.
#ifndef FEWEST_TOGETHER
#define FEWEST_TOGETHER 12
#endif

// Casts rays of the tile each its own way.
#ifdef IN_TURNS
void cast_alone(Tile *tile, ulong members, GRID_PARAMETERS, MESH_PARAMETERS)
{
    Walker herd[HERD];
    uint count = 0;
    while (count != 0 || members != 0) {
        for (; count < HERD && members != 0; members &= members - 1) {
            const uint k = lowest_of_64(members);
            const Ray ray = ray_of(tile, k);
            set_out(herd + count++, k, &ray, hit_of(tile, k), grid);
        }
        take_turns(herd, count, GRID_ARGUMENTS, MESH_ARGUMENTS);
        for (uint k = 0; k < count;) {
            if (herd[k].over) {
                set_hit(tile, herd[k].number, outcome(herd + k, GRID_ARGUMENTS, MESH_ARGUMENTS));
                count = dismiss(herd, k, count);
            } else {
                ++k;
            }
        }
    }
}
#else
void cast_alone(Tile *tile, ulong members, GRID_PARAMETERS, MESH_PARAMETERS)
{
    for (; members != 0; members &= members - 1) {
        const uint k = lowest_of_64(members);
        const Ray ray = ray_of(tile, k);
        set_hit(tile, k, traverse(&ray, hit_of(tile, k), GRID_ARGUMENTS, MESH_ARGUMENTS));
    }
}
#endif

// What the query asks for of the triangles that the tile's rays meet, but for weights and the like.
void cast_tile(Tile *tile, GRID_PARAMETERS, MESH_PARAMETERS)
{
#ifdef ALONE
    cast_alone(tile, tile->reach, GRID_ARGUMENTS, MESH_ARGUMENTS);
#else
    for (ulong pending = tile->reach & ~tile->alone; pending != 0;) {
        uint class;
        const ulong members = take_class(tile, pending, &class);
        pending &= ~members;
        Bundle bundle;
        if (popcount(members) < FEWEST_TOGETHER)
            tile->alone |= members;
        else if (set_bundle(tile, members, class, grid, &bundle)
                 && !walk_slices(tile, &bundle, GRID_ARGUMENTS, MESH_ARGUMENTS))
            tile->alone |= members;
#ifdef RUNG_FAST
        else
            settle(tile, &bundle);  // nothing, if the bundle was not set
#endif
    }
    cast_alone(tile, tile->alone & tile->reach, GRID_ARGUMENTS, MESH_ARGUMENTS);
#endif
}

// The hit of ray k with all that was asked for.
Hit described_hit(const Tile *tile, uint k, MESH_PARAMETERS)
{
    Hit hit = hit_of(tile, k);
#if defined(WITH_UVS) || defined(WITH_T_ERR)
    if (hit.id == NO_HIT)
        return hit;
    const Ray ray = ray_of(tile, k);
    const Projection projection = projection_of(&ray);
    describe_hit(&ray, &projection, MESH_ARGUMENTS, &hit);
#endif
    return hit;
}

#endif
