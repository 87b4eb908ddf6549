// The rays of a tile and what is known of their hits, side by side where the rung's rays are float32, else one
// after another. The same arithmetic as in ray.h and triangle.h, four or eight rays at a time.
#ifndef CLG_TILE_RAYS_H
#define CLG_TILE_RAYS_H
#include "lanes.h"
#include "triangle.h"

#if defined(COUNT_STEPS) || defined(QUERY_EACH)
// Each ray is cast alone: its cells are counted, or crossings by cell.
#define ALONE
#endif

#if defined(WIDE_RAYS) || defined(ALONE)

typedef struct {
    Ray rays[TILE_RAYS];
    Projection projections[TILE_RAYS];
    Hit hits[TILE_RAYS];
    ulong valid, reach;  // bits: rays that are rays; those that come near the mesh
    ulong alone;         // those of them that are cast alone
#ifdef RUNG_EXACT
    uint triangle_count; // of the grid
#endif
} Tile;

// Rays first .. first + 3.
void set_rays(Tile *tile, uint first, double given_o[3][4], double given_d[3][4], const double *t_min,
              const double *t_max, __constant const FrameParams *frame)
{
    for (uint i = 0; i < 4; ++i) {
        const double origin[3] = {given_o[0][i], given_o[1][i], given_o[2][i]};
        const double direction[3] = {given_d[0][i], given_d[1][i], given_d[2][i]};
        Ray *ray = &tile->rays[first + i];
        *ray = prepare_ray(origin, direction, t_min[i], t_max[i], frame);
        tile->valid |= (ulong)ray->valid << (first + i);
        tile->reach |= (ulong)ray->reaches << (first + i);
#ifdef RUNG_EXACT
        tile->alone |= (ulong)ray->astray << (first + i);
        if (ray->reaches && !ray->astray)
            tile->projections[first + i] = projection_of(ray);
#else
        if (ray->reaches)
            tile->projections[first + i] = projection_of(ray);
#endif
    }
}

Ray ray_of(const Tile *tile, uint k)
{
    return tile->rays[k];
}

Hit hit_of(const Tile *tile, uint k)
{
    return tile->hits[k];
}

void set_hit(Tile *tile, uint k, Hit hit)
{
    tile->hits[k] = hit;
}

// Triangles of rays k .. k + 3.
uint4 ids_of_4(const Tile *tile, uint k)
{
    return (uint4)(tile->hits[k].id, tile->hits[k + 1].id, tile->hits[k + 2].id, tile->hits[k + 3].id);
}

#else

typedef struct {
    float o[3][TILE_RAYS], d[3][TILE_RAYS];  // local, as in Ray
    double t_min[TILE_RAYS], t_max[TILE_RAYS], t_entry[TILE_RAYS], t_unit[TILE_RAYS];
    float t[TILE_RAYS];                      // of the hit
    uint ids[TILE_RAYS];
    ulong valid, reach, alone;
} Tile;

// prepare_ray for rays first .. first + 3.
void set_rays(Tile *tile, uint first, double given_o[3][4], double given_d[3][4], const double *t_min,
              const double *t_max, __constant const FrameParams *frame)
{
    double4 o[3], d[3];
    double4 longest = (double4)(0.0), farthest = (double4)(0.0);
    const double4 low = vload4(0, t_min), high = vload4(0, t_max);
    long4 valid = (low == low) & (high == high);
    for (int a = 0; a < 3; ++a) {
        o[a] = (vload4(0, given_o[a]) - frame->offset[a]) * frame->scale;
        d[a] = vload4(0, given_d[a]);
        longest = fabs(d[a]) > longest ? fabs(d[a]) : longest;
        farthest = fabs(o[a]) > farthest ? fabs(o[a]) : farthest;
        valid &= (fabs(o[a]) < INFINITY) & (fabs(d[a]) < INFINITY);
    }
    valid &= longest > 0.0;
    const double4 first_factor = longest < 0x1p-600 ? (double4)(0x1p+400)
                                 : longest > 0x1p+600 ? (double4)(0x1p-400) : (double4)(1.0);
    // power_of_two(-exponent_above(x)).
    const ulong4 exponent = (as_ulong4(longest * first_factor) >> 52) & 0x7FFul;
    const double4 second_factor = as_double4((2045ul - exponent) << 52);
    const double4 t_unit = frame->inverse_scale * first_factor * second_factor;
    valid &= (t_unit >= 0x1p-960) & (t_unit <= 0x1p+960);
    for (int a = 0; a < 3; ++a)
        d[a] = d[a] * first_factor * second_factor;
    long4 reach = valid;
    double4 t_entry = (double4)(0.0);
    const long4 distant = farthest > START_LIMIT;
    if (any(distant & valid)) {
        double4 t_near = (double4)(-INFINITY), t_far = (double4)(INFINITY);
        long4 apart = (long4)(0);
        for (int a = 0; a < 3; ++a) {
            const long4 moves = d[a] != 0.0;
            const double4 side = d[a] > 0.0 ? (double4)(ENTRY_CUBE) : (double4)(-ENTRY_CUBE);
            const double4 t0 = (-side - o[a]) / d[a], t1 = (side - o[a]) / d[a];
            t_near = (moves & (t0 > t_near)) ? t0 : t_near;
            t_far = (moves & (t1 < t_far)) ? t1 : t_far;
            apart |= ~moves & (fabs(o[a]) > ENTRY_CUBE);
        }
        apart |= ~(t_near <= t_far) | (t_near == INFINITY);
        reach &= ~(distant & apart);
        t_entry = (distant & ~apart) ? t_near : t_entry;
    }
    for (int a = 0; a < 3; ++a) {
        const double4 start = o[a] + t_entry * d[a];
        const double4 inside = start < -START_LIMIT ? (double4)(-START_LIMIT)
                               : start > START_LIMIT ? (double4)(START_LIMIT) : start;
        vstore4(convert_float4(inside), 0, tile->o[a] + first);
        vstore4(convert_float4(d[a]), 0, tile->d[a] + first);
    }
    vstore4(low, 0, tile->t_min + first);
    vstore4(high, 0, tile->t_max + first);
    vstore4(t_entry, 0, tile->t_entry + first);
    vstore4(t_unit, 0, tile->t_unit + first);
    tile->valid |= bits_of_4(valid) << first;
    tile->reach |= bits_of_4(reach) << first;
}

Ray ray_of(const Tile *tile, uint k)
{
    Ray ray;
    for (int a = 0; a < 3; ++a) {
        ray.origin[a] = tile->o[a][k];
        ray.direction[a] = tile->d[a][k];
    }
    ray.t_min = tile->t_min[k];
    ray.t_max = tile->t_max[k];
    ray.t_entry = tile->t_entry[k];
    ray.t_unit = tile->t_unit[k];
    ray.valid = tile->valid >> k & 1ul;
    ray.reaches = tile->reach >> k & 1ul;
    return ray;
}

Hit hit_of(const Tile *tile, uint k)
{
    Hit hit = no_hit();
    hit.meeting.t = tile->t[k];
    hit.id = tile->ids[k];
    return hit;
}

void set_hit(Tile *tile, uint k, Hit hit)
{
    tile->t[k] = hit.meeting.t;
    tile->ids[k] = hit.id;
}

uint4 ids_of_4(const Tile *tile, uint k)
{
    return vload4(0, tile->ids + k);
}

#endif

// A tile of no rays yet; every ray starts with a miss.
void start_tile(Tile *tile, __constant const GridParams *grid)
{
#ifdef RUNG_EXACT
    tile->triangle_count = grid->triangle_count;
#endif
    tile->valid = tile->reach = tile->alone = 0;
    for (uint k = 0; k < TILE_RAYS; ++k)
        set_hit(tile, k, no_hit());
}

#endif
