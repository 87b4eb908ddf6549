// Tiles of up to 64 rays, cast together where they keep together: the triangles of the cells that any of them
// may pass are brought in once for all (slices.h). Rays that spread too far go each its own way. What is kept of a
// triangle is the same either way (triangle.h), and so are the bits of all hits.
//   IN_TURNS   where they do, so many at once take turns (herd.h): worth it for meshes that caches do not hold
// Numbers that are tuned, in upper case, come from clgrid/tuning.py.
#ifndef CLG_TILE_H
#define CLG_TILE_H
// Tiles that a work-item casts: their rays go together where they keep together.
#ifndef TILES_TOGETHER
#define TILES_TOGETHER 1
#endif

#include "grid.h"
#ifdef IN_TURNS
#include "herd.h"
#endif
#include "entries.h"
#include "tile_rays.h"
#ifndef ALONE
#include "slices.h"
#endif

// Fewer rays of a major axis go one by one.
#ifndef FEWEST_TOGETHER
#define FEWEST_TOGETHER 12
#endif

// Whether the walk cannot follow ray k: all triangles are tested.
bool is_astray(const Tile *tile, uint k)
{
#ifdef RUNG_EXACT
    return tile->astray >> k & 1ul;
#else
    return false;
#endif
}

// Casts rays of the tile each its own way.
#ifdef IN_TURNS
void cast_alone(Tile *tile, ulong members, GRID_PARAMETERS, MESH_PARAMETERS)
{
    Walker herd[HERD];
    uint count = 0;
    Entries entries;
    entries.first = TILE_RAYS;
    while (count != 0 || members != 0) {
        for (; count < HERD && members != 0; members &= members - 1) {
            const uint k = lowest_of_64(members);
            if (!enters(tile, k, grid, &entries) && !is_astray(tile, k))
                continue;
            const Ray ray = ray_of(tile, k);
            const Walk walk = walk_of(&entries, k);
            set_out(herd + count++, k, &ray, &walk, hit_of(tile, k), grid);
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
    Entries entries;
    entries.first = TILE_RAYS;
    for (; members != 0; members &= members - 1) {
        const uint k = lowest_of_64(members);
        if (!enters(tile, k, grid, &entries) && !is_astray(tile, k))
            continue;
        const Ray ray = ray_of(tile, k);
        Walk walk = walk_of(&entries, k);
        set_hit(tile, k, traverse(&ray, &walk, hit_of(tile, k), GRID_ARGUMENTS, MESH_ARGUMENTS));
    }
}
#endif

#ifndef ALONE
#ifdef ORDERED
// Cells that starts of a tile's rays may spread over, across any axis; else its rays go one by one, without a look at
// where they go: rays without order are seldom worth one.
#ifndef WIDEST_START
#define WIDEST_START 32.0f
#endif

// Whether the rays of a tile start far apart.
bool starts_apart(const Tile *tile, __constant const GridParams *grid)
{
    float cells[3];
    for (int a = 0; a < 3; ++a) {
        float8 least = eight_of(tile->o[a]), greatest = least;
        for (uint g = 1; g < GROUPS; ++g) {
            const float8 o = eight_of(tile->o[a] + g * LANES);
            least = o < least ? o : least;
            greatest = o > greatest ? o : greatest;
        }
        cells[a] = (greatest_of(greatest) - least_of(least)) * grid->cells_per_unit[a] + 1.0f;
    }
    return cells[0] * cells[1] > WIDEST_START && cells[1] * cells[2] > WIDEST_START && cells[2] * cells[0] > WIDEST_START;
}
#endif

// Bundles of one class of the rays `pending` of `count` tiles, which no longer are; how many. Few rays go alone.
uint gather_company(Company *company, Tile *tiles, uint count, ulong *pending, __constant const GridParams *grid)
{
    uint size = 0, class = 0;
    bool found = false;
    for (uint i = 0; i < count; ++i) {
        uint own;
        if (pending[i] == 0)
            continue;
        const ulong members = take_class(tiles + i, pending[i], &own);
        class = found ? class : own;
        found = true;
        if (own != class)
            continue;
        pending[i] &= ~members;
        company->tiles[size] = tiles + i;
        if (popcount(members) < FEWEST_TOGETHER)
            tiles[i].alone |= members;
        else if (set_bundle(tiles + i, members, class, grid, company->bundles + size))
            ++size;
    }
    return size;
}

// Casts the bundles of a company together, or else each by itself, or else each ray.
void cast_company(Company *company, uint size, GRID_PARAMETERS, MESH_PARAMETERS)
{
    if (size == 0 || (size > 1 && walk_slices(company, 0, size, GRID_ARGUMENTS, MESH_ARGUMENTS)))
        return;
    for (uint b = 0; b < size; ++b)
        if (!walk_slices(company, b, b + 1, GRID_ARGUMENTS, MESH_ARGUMENTS))
            company->tiles[b]->alone |= company->bundles[b].members;
}
#endif

// What the query asks for of the triangles that the rays of `count` tiles meet, but for weights and the like.
void cast_tiles(Tile *tiles, uint count, GRID_PARAMETERS, MESH_PARAMETERS)
{
#ifdef ALONE
    for (uint i = 0; i < count; ++i)
        cast_alone(tiles + i, tiles[i].reach, GRID_ARGUMENTS, MESH_ARGUMENTS);
#else
#ifdef ORDERED
    for (uint i = 0; i < count; ++i)
        tiles[i].alone |= starts_apart(tiles + i, grid) ? tiles[i].reach : 0;
#endif
    ulong pending[TILES_TOGETHER];
    for (uint i = 0; i < count; ++i)
        pending[i] = tiles[i].reach & ~tiles[i].alone;
    Company company;
    ulong left = 0;
    for (uint i = 0; i < count; ++i)
        left |= pending[i];
    while (left != 0) {
        const uint size = gather_company(&company, tiles, count, pending, grid);
        cast_company(&company, size, GRID_ARGUMENTS, MESH_ARGUMENTS);
#ifdef RUNG_FAST
        for (uint b = 0; b < size; ++b)
            settle(company.tiles[b], company.bundles + b);
#endif
        left = 0;
        for (uint i = 0; i < count; ++i)
            left |= pending[i];
    }
    for (uint i = 0; i < count; ++i)
        cast_alone(tiles + i, tiles[i].alone & tiles[i].reach, GRID_ARGUMENTS, MESH_ARGUMENTS);
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
