// Rays of a tile that share their major axis and the way that they go along it.
#ifndef CLG_BUNDLE_H
#define CLG_BUNDLE_H
#include "way.h"
#include "tile_rays.h"

// What rounding in float32 adds to a t that something is compared with.
#define T_PAD 0x1p-16f
// Local t beyond which a ray is out of the grid, wherever it starts.
#define FARTHEST_T 16.0

#if !defined(RUNG_FAST) && !defined(WIDE_RAYS)
// Bundles whose rays share their origin are told (pinhole.h).
#define PINHOLES
#endif

typedef struct {
    Way way;
    ulong members;                // bits, by number in the tile
    float8 ou[GROUPS], ov[GROUPS], od[GROUPS];  // origins
    float8 su[GROUPS], sv[GROUPS], sd[GROUPS];  // the shear (shear.h)
#ifdef RUNG_FAST
    float8 moment[GROUPS];        // sv ou - su ov, once straightened (bundle_fast.h)
    float8 first[GROUPS];         // depth, times `side`, before which no hit matters
    float8 last[GROUPS];          // the same beyond which; -inf in the lanes of other rays
    float start;                  // depth of the middle line's origin
    float middle[2], tilt[2];     // that origin, and the line's slopes
    float width[2], spread[2];    // half the width of the beam there, and how it grows
    float bounds[4][GROUPS], slopes[4][GROUPS];  // the groups' beams, as seen from there
    uint8 found[GROUPS];          // triangles met
    uint stale;                   // bits: groups whose `deepest` may be less
#else
    float8 dd[GROUPS];            // the directions' largest component
    float8 slack[GROUPS];         // how far behind a hit no other can win
#ifdef WIDE_RAYS
    double shear[3][TILE_RAYS];   // in float64
#endif
    float8 last[GROUPS];          // t beyond which no hit matters; -inf in the lanes of other rays
#endif
#ifdef PINHOLES
    bool is_pinhole;
    float origin[3];              // if it is: of all rays, along u, v and d
    float8 slopes[4];             // of each group: least and greatest su, sv
    float slopes_of_all[4];
#endif
    float8 deepest;               // of each group: depth, times `side`, beyond which no hit matters
    Beams beams;                  // of the groups
} Bundle;

int8 members_of(const Bundle *bundle, uint g)
{
    return lanes_of((uint)(bundle->members >> (LANES * g)) & 0xFFu);
}

void set_deepest(Bundle *bundle, uint g)
{
#ifdef RUNG_FAST
    const float8 depth = bundle->last[g];
#else
    const float8 depth = (bundle->od[g] + bundle->last[g] * bundle->dd[g]) * bundle->way.side;
#endif
    float deepest[GROUPS];
    vstore8(bundle->deepest, 0, deepest);
    deepest[g] = greatest_of(bundle->last[g] == -INFINITY ? (float8)(-INFINITY) : depth) + BEAM_PAD;
    bundle->deepest = vload8(0, deepest);
}

// Groups that a hit at this depth, or deeper, may matter to.
uint groups_alive(Bundle *bundle, float depth)
{
#ifdef RUNG_FAST
    for (; bundle->stale != 0; bundle->stale &= bundle->stale - 1)
        set_deepest(bundle, lowest_of_32(bundle->stale));
#endif
    return bits_of(depth * bundle->way.side - BEAM_PAD <= bundle->deepest);
}

// Least and greatest of each group's own rays.
void ranges_of(const Bundle *bundle, const float8 *v, float8 *least, float8 *greatest)
{
    const float8 none = (float8)(8.0f);
    float8 low[GROUPS], high[GROUPS];
    for (uint g = 0; g < GROUPS; ++g) {
        const int8 own = members_of(bundle, g);
        low[g] = own ? v[g] : none;
        high[g] = own ? -v[g] : none;
    }
    *least = least_of_each(low);
    *greatest = -least_of_each(high);
}

// Least and greatest u and v of each group at a depth.
void ranges_at(const Bundle *bundle, float depth, float8 *bounds)
{
    float8 u[GROUPS], v[GROUPS];
    for (uint g = 0; g < GROUPS; ++g) {
        const float8 ahead = depth - bundle->od[g];
        u[g] = bundle->ou[g] + ahead * bundle->su[g];
        v[g] = bundle->ov[g] + ahead * bundle->sv[g];
    }
    ranges_of(bundle, u, bounds, bounds + 1);
    ranges_of(bundle, v, bounds + 2, bounds + 3);
}

#ifdef PINHOLES
// Whether all rays start at one point; if so, notes it and the slopes.
bool set_pinhole(const Tile *tile, Bundle *bundle)
{
    const uint first = lowest_of_64(bundle->members);
    const float ou = tile->o[bundle->way.ku][first], ov = tile->o[bundle->way.kv][first];
    const float od = tile->o[bundle->way.kd][first];
    // Where they do not, the first and the last mostly tell.
    const uint last = 63u - (uint)clz(bundle->members);
    if (tile->o[bundle->way.ku][last] != ou || tile->o[bundle->way.kv][last] != ov
        || tile->o[bundle->way.kd][last] != od)
        return false;
    int8 apart = (int8)(0);
    for (uint g = 0; g < GROUPS; ++g)
        apart |= members_of(bundle, g) & ((bundle->ou[g] != ou) | (bundle->ov[g] != ov) | (bundle->od[g] != od));
    if (any(apart))
        return false;
    bundle->origin[0] = ou;
    bundle->origin[1] = ov;
    bundle->origin[2] = od;
    ranges_of(bundle, bundle->su, bundle->slopes, bundle->slopes + 1);
    ranges_of(bundle, bundle->sv, bundle->slopes + 2, bundle->slopes + 3);
    for (int i = 0; i < 4; ++i)
        bundle->slopes_of_all[i] = i & 1 ? greatest_of(bundle->slopes[i]) : least_of(bundle->slopes[i]);
    return true;
}

// ranges_at, by the slopes.
void ranges_of_pinhole(const Bundle *bundle, float depth, float8 *bounds)
{
    const float ahead = depth - bundle->origin[2];
    const int swap = ahead < 0.0f ? 1 : 0;
    for (int i = 0; i < 4; ++i)
        bounds[i] = bundle->origin[i >> 1] + ahead * bundle->slopes[i ^ swap];
}
#endif

void set_beams(Bundle *bundle)
{
    const float start = bundle->way.from, end = max(bundle->way.to, start + SHORTEST_SPAN);
    const float span = end - start;
    float8 first[4], second[4];
#ifdef PINHOLES
    if (bundle->is_pinhole) {
        ranges_of_pinhole(bundle, start, first);
        ranges_of_pinhole(bundle, end, second);
    } else
#endif
    {
        ranges_at(bundle, start, first);
        ranges_at(bundle, end, second);
    }
    for (int i = 0; i < 4; ++i) {
        const float pad = i & 1 ? BEAM_PAD : -BEAM_PAD;
        const float8 from = first[i] + pad, to = second[i] + pad;
        const float8 tilt = (to - from) / span, bound = from - tilt * start;
        const float8 near = bound + tilt * start, far = bound + tilt * end;
        const float least = (i & 1 ? greatest_of(near) : least_of(near)) + pad;
        const float greatest = (i & 1 ? greatest_of(far) : least_of(far)) + pad;
        bundle->beams.at[i] = bound;
        bundle->beams.slope[i] = tilt;
        bundle->way.beam.slope[i] = (greatest - least) / span;
        bundle->way.beam.at[i] = least - bundle->way.beam.slope[i] * start;
    }
}

#ifndef RUNG_FAST
// Sets a group's rays; gives t where they start, and where they end if there is no hit.
void load_group(const Tile *tile, Bundle *bundle, uint g, double *first, double *last)
{
    const uint k = g * LANES;
    const int ku = bundle->way.ku, kv = bundle->way.kv, kd = bundle->way.kd;
    double4 su[2], sv[2], sd[2];
    for (uint i = 0; i < 2; ++i) {
        const uint at = k + 4 * i;
        const double4 depth = convert_double4(vload4(0, tile->d[kd] + at));
        su[i] = convert_double4(vload4(0, tile->d[ku] + at)) / depth;
        sv[i] = convert_double4(vload4(0, tile->d[kv] + at)) / depth;
        sd[i] = 1.0 / depth;
#ifdef WIDE_RAYS
        vstore4(su[i], 0, bundle->shear[0] + at);
        vstore4(sv[i], 0, bundle->shear[1] + at);
        vstore4(sd[i], 0, bundle->shear[2] + at);
#endif
        vstore4(first_t(tile, at), i, first);
        vstore4(min(last_t(tile, at), convert_double4(vload4(0, tile->t + at))), i, last);
    }
    bundle->ou[g] = eight_of(tile->o[ku] + k);
    bundle->ov[g] = eight_of(tile->o[kv] + k);
    bundle->od[g] = eight_of(tile->o[kd] + k);
    bundle->dd[g] = eight_of(tile->d[kd] + k);
    // Through float64, as shear_of.
    bundle->su[g] = narrowed(su[0], su[1]);
    bundle->sv[g] = narrowed(sv[0], sv[1]);
    bundle->sd[g] = narrowed(sd[0], sd[1]);
    const double4 entry_low = vload4(0, tile->t_entry + k), entry_high = vload4(1, tile->t_entry + k);
    bundle->slack[g] = narrowed(T_SLACK + 0x1p-51 * fabs(entry_low), T_SLACK + 0x1p-51 * fabs(entry_high)) + T_PAD;
}

float8 within_reach(const double *t)
{
    const double4 low = clamp(vload4(0, t), -FARTHEST_T, FARTHEST_T);
    return narrowed(low, clamp(vload4(1, t), -FARTHEST_T, FARTHEST_T));
}

// Sets up the bundle of the rays `members`, which share `class`. False: none of them is in the grid's depths.
bool set_bundle(const Tile *tile, ulong members, uint class, __constant const GridParams *grid, Bundle *bundle)
{
    name_axes(&bundle->way, class);
    bundle->members = members;
    float8 least = (float8)(INFINITY), greatest = (float8)(-INFINITY);
    for (uint g = 0; g < GROUPS; ++g) {
        double first[LANES], last[LANES];
        load_group(tile, bundle, g, first, last);
        const int8 own = members_of(bundle, g);
        bundle->last[g] = own ? within_reach(last) + bundle->slack[g] : (float8)(-INFINITY);
        const float8 near = bundle->od[g] + within_reach(first) * bundle->dd[g];
        const float8 far = bundle->od[g] + bundle->last[g] * bundle->dd[g];
        least = min(least, own ? min(near, far) : (float8)(INFINITY));
        greatest = max(greatest, own ? max(near, far) : (float8)(-INFINITY));
    }
    const float lower = (float)grid->lower[bundle->way.kd], upper = (float)grid->upper[bundle->way.kd];
    bundle->way.from = max(least_of(least) - T_PAD, lower - BEAM_PAD);
    bundle->way.to = min(greatest_of(greatest) + T_PAD, upper + BEAM_PAD);
    if (!(bundle->way.from < bundle->way.to))
        return false;
    for (uint g = 0; g < GROUPS; ++g)
        set_deepest(bundle, g);
#ifdef PINHOLES
    bundle->is_pinhole = set_pinhole(tile, bundle);
#endif
    set_beams(bundle);
    return true;
}
#endif

// Of the rays `pending`, those of the first one's class: its major axis, twice, plus one if it descends it.
ulong take_class(const Tile *tile, ulong pending, uint *class)
{
    uint classes[TILE_RAYS];
    for (uint g = 0; g < GROUPS; ++g) {
        const uint k = g * LANES;
        const float8 x = eight_of(tile->d[0] + k), y = eight_of(tile->d[1] + k), z = eight_of(tile->d[2] + k);
        // As shear_of chooses.
        const int8 over_y = fabs(x) >= fabs(y), over_z = fabs(x) >= fabs(z);
        const int8 is_x = over_y & over_z, is_y = ~over_y & (fabs(y) >= fabs(z));
        const float8 major = is_x ? x : is_y ? y : z;
        const int8 axis = is_x ? (int8)(0) : is_y ? (int8)(2) : (int8)(4);
        vstore8(as_uint8(axis + (major < 0.0f ? (int8)(1) : (int8)(0))), g, classes);
    }
    *class = classes[lowest_of_64(pending)];
    ulong members = 0;
    for (uint g = 0; g < GROUPS; ++g)
        members |= (ulong)bits_of(vload8(g, classes) == *class) << (LANES * g);
    return members & pending;
}
#endif
