// The rays of a tile and what is known of their hits, side by side. The same arithmetic as in ray.h and
// triangle.h, four or eight rays at a time.
#ifndef CLG_TILE_RAYS_H
#define CLG_TILE_RAYS_H
#include "lanes.h"
#include "triangle.h"

#if defined(COUNT_STEPS) || defined(QUERY_EACH)
// Each ray is cast alone: its cells are counted, or crossings by cell.
#define ALONE
#endif

typedef struct {
    real o[3][TILE_RAYS], d[3][TILE_RAYS];  // local, as in Ray
    double t_min[TILE_RAYS], t_max[TILE_RAYS], t_entry[TILE_RAYS], t_unit[TILE_RAYS];
    ulong valid, reach;  // bits: rays that are rays; those that come near the mesh
    ulong alone;         // those of them that are cast alone
#ifdef RUNG_EXACT
    double caller_o[3][TILE_RAYS], caller_d[3][TILE_RAYS], offset[3];
    int frame_exponent;
    ulong astray;
    uint triangle_count; // of the grid
#endif
#ifdef ALONE
    Hit hits[TILE_RAYS];
#else
    real t[TILE_RAYS];   // of the hit
    uint ids[TILE_RAYS];
#ifdef RUNG_EXACT
    double errors[TILE_RAYS];
    Corners corners[TILE_RAYS];
    uint decisions[TILE_RAYS];
    ulong certain;
#endif
#endif
} Tile;

#ifdef WIDE_RAYS
// point_at of four.
double4 points_at(double4 o, double4 o_rest, double4 t, double4 d)
{
    const Pairs along = two_products(t, d);
    const Pairs sum = two_sums(o, along.high);
    const double4 sums = sum.high + (sum.low + (o_rest + along.low));
    return fabs(t) > 0x1p+900 ? o + t * d : sums;
}
#endif

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
#ifdef RUNG_EXACT
        vstore4(vload4(0, given_o[a]), 0, tile->caller_o[a] + first);
        vstore4(d[a], 0, tile->caller_d[a] + first);
#endif
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
    long4 distant = farthest > START_LIMIT;
#ifdef RUNG_EXACT
    const long4 astray = valid & (farthest > FARTHEST_ORIGIN);
    distant &= ~astray;
    tile->astray |= bits_of_4(astray) << first;
    tile->alone |= bits_of_4(astray) << first;
#endif
    const bool moved = any(distant & valid);
    if (moved) {
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
        double4 start = o[a];
#ifdef WIDE_RAYS
        if (moved) {
            const Pairs exact = two_sums(vload4(0, given_o[a]), (double4)(-frame->offset[a]));
            start = points_at(o[a], exact.low * frame->scale, t_entry, d[a]);
        }
#else
        start = start + t_entry * d[a];
#endif
        double4 inside = start < -START_LIMIT ? (double4)(-START_LIMIT)
                         : start > START_LIMIT ? (double4)(START_LIMIT) : start;
#ifdef RUNG_EXACT
        inside = astray ? (double4)(0.0) : inside;
        d[a] = astray ? (double4)(0.0) : d[a];
#endif
        vstore4(convert_real4(inside), 0, tile->o[a] + first);
        vstore4(convert_real4(d[a]), 0, tile->d[a] + first);
    }
    vstore4(low, 0, tile->t_min + first);
    vstore4(high, 0, tile->t_max + first);
    vstore4(t_entry, 0, tile->t_entry + first);
    vstore4(t_unit, 0, tile->t_unit + first);
    tile->valid |= bits_of_4(valid) << first;
    tile->reach |= bits_of_4(reach) << first;
}

// 1 / t_unit of four: it is a power of two, so that a product with this is the quotient by that.
double4 per_unit_of_4(const Tile *tile, uint k)
{
    return as_double4(0x7FE0000000000000ul - as_ulong4(vload4(0, tile->t_unit + k)));
}

// Local distances before and after which no accepted t of rays k .. k + 3 can lie.
double4 first_t(const Tile *tile, uint k)
{
    const double4 entry = vload4(0, tile->t_entry + k);
    return vload4(0, tile->t_min + k) * per_unit_of_4(tile, k) - entry - (2.0 * T_SLACK + 0x1p-50 * fabs(entry));
}

double4 last_t(const Tile *tile, uint k)
{
    const double4 entry = vload4(0, tile->t_entry + k);
    return vload4(0, tile->t_max + k) * per_unit_of_4(tile, k) - entry + (2.0 * T_SLACK + 0x1p-50 * fabs(entry));
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
#ifdef RUNG_EXACT
    for (int a = 0; a < 3; ++a) {
        ray.caller_origin[a] = tile->caller_o[a][k];
        ray.caller_direction[a] = tile->caller_d[a][k];
        ray.offset[a] = tile->offset[a];
    }
    ray.frame_exponent = tile->frame_exponent;
    ray.length_exponent = exponent_above(ray.t_unit) - 1 - ray.frame_exponent;
    ray.astray = tile->astray >> k & 1ul;
#endif
    return ray;
}

#ifdef ALONE
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
Hit hit_of(const Tile *tile, uint k)
{
    Hit hit = no_hit();
    hit.meeting.t = tile->t[k];
    hit.id = tile->ids[k];
#ifdef RUNG_EXACT
    hit.meeting.error = tile->errors[k];
    hit.meeting.corners = tile->corners[k];
    hit.meeting.certain = tile->certain >> k & 1ul;
    hit.decisions = tile->decisions[k];
#endif
    return hit;
}

void set_hit(Tile *tile, uint k, Hit hit)
{
    tile->t[k] = hit.meeting.t;
    tile->ids[k] = hit.id;
#ifdef RUNG_EXACT
    tile->errors[k] = hit.meeting.error;
    tile->corners[k] = hit.meeting.corners;
    tile->certain = (tile->certain & ~(1ul << k)) | (ulong)hit.meeting.certain << k;
    tile->decisions[k] = hit.decisions;
#endif
}

uint4 ids_of_4(const Tile *tile, uint k)
{
    return vload4(0, tile->ids + k);
}
#endif

// A tile of no rays yet; every ray starts with a miss.
void start_tile(Tile *tile, __constant const FrameParams *frame, __constant const GridParams *grid)
{
#ifdef RUNG_EXACT
    tile->triangle_count = grid->triangle_count;
    tile->frame_exponent = exponent_above(frame->inverse_scale) - 1;
    for (int a = 0; a < 3; ++a)
        tile->offset[a] = frame->offset[a] * frame->scale;
    tile->astray = 0;
#ifndef ALONE
    tile->certain = 0;
#endif
#endif
    tile->valid = tile->reach = tile->alone = 0;
    for (uint k = 0; k < TILE_RAYS; ++k) {
#ifdef ALONE
        tile->hits[k] = no_hit();
#else
        tile->t[k] = INFINITY;
        tile->ids[k] = NO_HIT;
#ifdef RUNG_EXACT
        tile->decisions[k] = 0;
#endif
#endif
    }
}

#endif
