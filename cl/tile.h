// Tiles of up to 64 rays, cast together where they keep together. Rays of one major axis go through the grid
// slice by slice, a slice being a layer of cells across that axis: the triangles of the cells that any of them may
// pass are brought in once for all (after Wald et al. 2006). Rays that spread too far go one by one. What is
// kept of the triangles is a matter of triangle.h, so the hits are the same bits either way.
#ifndef CLG_TILE_H
#define CLG_TILE_H
#include "beam.h"
#include "grid.h"
#include "tile_rays.h"

// What rounding in float32 adds to a t that something is compared with.
#define T_PAD 0x1p-16f

// Cells of a slice that rays of a tile may spread over; beyond, they go one by one.
#ifndef WIDEST_SLICE
#define WIDEST_SLICE 128.0f
#endif
#ifndef SEEN
#define SEEN 128u
#endif

// The rays of a tile with one major axis and one direction along it, side by side. Lanes of other rays have
// `last` -inf.
typedef struct {
    int ku, kv, kd;      // axes; kd is the major one
    float side;          // 1 if the rays climb it, or -1
    float8 ou[GROUPS], ov[GROUPS], od[GROUPS], dd[GROUPS];
    float8 su[GROUPS], sv[GROUPS], sd[GROUPS];  // the shear
    float8 slack[GROUPS];// beyond a hit that no other can win
    float8 last[GROUPS]; // t beyond which no hit matters
    Beams beams;         // of the groups
    Beam beam;           // of all
    float from, to;      // depths between which the bounds hold
    float8 deepest;      // of each group: depth along the rays, times `side`, beyond which no hit matters
    ulong members;
} Bundle;

int8 members_of(const Bundle *bundle, uint g)
{
    return lanes_of((uint)(bundle->members >> (LANES * g)) & 0xFFu);
}

void set_deepest(Bundle *bundle, uint g)
{
    const float8 depth = (bundle->od[g] + bundle->last[g] * bundle->dd[g]) * bundle->side;
    float deepest[GROUPS];
    vstore8(bundle->deepest, 0, deepest);
    deepest[g] = greatest_of(bundle->last[g] == -INFINITY ? (float8)(-INFINITY) : depth) + BEAM_PAD;
    bundle->deepest = vload8(0, deepest);
}

// Sets the bounds. False: the rays miss the grid.
bool set_beams(Bundle *bundle, __constant const GridParams *grid)
{
    float at[4][GROUPS], slope[4][GROUPS];
    const float span = bundle->to - bundle->from;
    for (uint g = 0; g < GROUPS; ++g) {
        const float8 near = bundle->from - bundle->od[g], far = bundle->to - bundle->od[g];
        const float8 u0 = bundle->ou[g] + near * bundle->su[g], u1 = bundle->ou[g] + far * bundle->su[g];
        const float8 v0 = bundle->ov[g] + near * bundle->sv[g], v1 = bundle->ov[g] + far * bundle->sv[g];
        const int8 own = members_of(bundle, g);
        const float8 none = (float8)(2.0f * START_LIMIT);
        const float first[4] = {least_of(own ? u0 : none) - BEAM_PAD, greatest_of(own ? u0 : -none) + BEAM_PAD,
                                least_of(own ? v0 : none) - BEAM_PAD, greatest_of(own ? v0 : -none) + BEAM_PAD};
        const float second[4] = {least_of(own ? u1 : none) - BEAM_PAD, greatest_of(own ? u1 : -none) + BEAM_PAD,
                                 least_of(own ? v1 : none) - BEAM_PAD, greatest_of(own ? v1 : -none) + BEAM_PAD};
        for (int i = 0; i < 4; ++i) {
            slope[i][g] = (second[i] - first[i]) / span;
            at[i][g] = first[i] - slope[i][g] * bundle->from;
        }
    }
    for (int i = 0; i < 4; ++i) {
        bundle->beams.at[i] = vload8(0, at[i]);
        bundle->beams.slope[i] = vload8(0, slope[i]);
        const float8 near = bundle->beams.at[i] + bundle->beams.slope[i] * bundle->from;
        const float8 far = bundle->beams.at[i] + bundle->beams.slope[i] * bundle->to;
        const float first = i & 1 ? greatest_of(near) + BEAM_PAD : least_of(near) - BEAM_PAD;
        const float second = i & 1 ? greatest_of(far) + BEAM_PAD : least_of(far) - BEAM_PAD;
        bundle->beam.slope[i] = (second - first) / span;
        bundle->beam.at[i] = first - bundle->beam.slope[i] * bundle->from;
    }
    return true;
}

// Eight triangles' or one's corners, along the axes of a bundle.
typedef struct {
    float au, av, ad, bu, bv, bd, cu, cv, cd;
} Corner;

#ifdef WIDE_RAYS
// Tests triangle `id` for the lanes that are open, and keeps what the query asks for.
void keep_of_lanes(Tile *tile, Bundle *bundle, uint g, uint open, uint id, MESH_PARAMETERS)
{
    float last[LANES], slack[LANES];
    vstore8(bundle->last[g], 0, last);
    vstore8(bundle->slack[g], 0, slack);
    for (; open != 0; open &= open - 1) {
        const uint lane = lowest_bit(open), k = g * LANES + lane;
        Hit *hit = &tile->hits[k];
        keep(&tile->rays[k], &tile->projections[k], MESH_ARGUMENTS, id, hit);
        last[lane] = settled(hit) ? -INFINITY : min(last[lane], (float)hit->meeting.t + slack[lane]);
    }
    bundle->last[g] = vload8(0, last);
    set_deepest(bundle, g);
}
#else
// Four lanes' hit with a triangle whose edge functions do not rule it out: finish_hit, within and before in step.
void take_4(Tile *tile, uint k, int4 open, float4 u32, float4 v32, float4 w32, float4 az, float4 bz, float4 cz,
            float4 sz, uint id)
{
    const double4 u = convert_double4(u32), v = convert_double4(v32), w = convert_double4(w32);
    const double4 det = (u + v) + w;
    const double4 at = ((u * convert_double4(az) + v * convert_double4(bz)) + w * convert_double4(cz))
                       * convert_double4(sz) / det;
    const float4 t = convert_float4(at), best = vload4(0, tile->t + k);
    const uint4 ids = vload4(0, tile->ids + k);
    const double4 entry = vload4(0, tile->t_entry + k), unit = vload4(0, tile->t_unit + k);
    const double4 scene = (entry + convert_double4(t)) * unit;
    long4 taken = (det != 0.0) & (scene >= vload4(0, tile->t_min + k)) & (scene <= vload4(0, tile->t_max + k));
#ifndef QUERY_ANY
    const double4 least = (entry + convert_double4(best)) * unit;
    taken &= (scene < least) | ((scene == least) & convert_long4((uint4)(id) < ids));
#endif
    const int4 takes = open & convert_int4(taken);
    vstore4(takes ? t : best, 0, tile->t + k);
    vstore4(takes ? (uint4)(id) : ids, 0, tile->ids + k);
}

// Eight rays and one triangle: the same float32 operations as in the test of one.
void keep_of_group(Tile *tile, Bundle *bundle, uint g, const Corner *p, uint id, MESH_PARAMETERS)
{
    const float8 ou = bundle->ou[g], ov = bundle->ov[g], od = bundle->od[g];
    const float8 su = bundle->su[g], sv = bundle->sv[g], sd = bundle->sd[g];
    const float8 az = p->ad - od, bz = p->bd - od, cz = p->cd - od;
    const float8 ax = (p->au - ou) - su * az, ay = (p->av - ov) - sv * az;
    const float8 bx = (p->bu - ou) - su * bz, by = (p->bv - ov) - sv * bz;
    const float8 cx = (p->cu - ou) - su * cz, cy = (p->cv - ov) - sv * cz;
    const float8 u = cx * by - cy * bx;
    const float8 v = ax * cy - ay * cx;
    const float8 w = bx * ay - by * ax;
    const int8 negative = (u < 0.0f) | (v < 0.0f) | (w < 0.0f);
    const int8 positive = (u > 0.0f) | (v > 0.0f) | (w > 0.0f);
    const float8 least = min(min(az * sd, bz * sd), cz * sd);
    const int8 open = ~(negative & positive) & (least <= bundle->last[g]);
    if (!any(open))
        return;
    const float8 reach = max(max(max(fabs(ax), fabs(ay)), max(fabs(bx), fabs(by))), max(fabs(cx), fabs(cy)));
    const int8 hard = (fabs((u + v) + w) < 2.0f * reach * reach * reach)
                      | (min(min(fabs(u), fabs(v)), fabs(w)) < SMALLEST_EDGE);
    const uint k = g * LANES;
    const int8 easy = open & ~hard;
    if (any(easy.lo))
        take_4(tile, k, easy.lo, u.lo, v.lo, w.lo, az.lo, bz.lo, cz.lo, sd.lo, id);
    if (any(easy.hi))
        take_4(tile, k + 4, easy.hi, u.hi, v.hi, w.hi, az.hi, bz.hi, cz.hi, sd.hi, id);
    for (uint lanes = bits_of(open & hard); lanes != 0; lanes &= lanes - 1) {
        const uint lane = k + lowest_bit(lanes);
        const Ray ray = ray_of(tile, lane);
        const Projection projection = projection_of(&ray);
        Hit hit = hit_of(tile, lane);
        keep(&ray, &projection, MESH_ARGUMENTS, id, &hit);
        set_hit(tile, lane, hit);
    }
#ifdef QUERY_ANY
    bundle->last[g] = vload8(g, tile->ids) != NO_HIT ? (float8)(-INFINITY) : bundle->last[g];
#else
    bundle->last[g] = min(bundle->last[g], vload8(g, tile->t) + bundle->slack[g]);
#endif
    set_deepest(bundle, g);
}
#endif

// The nearest of up to eight triangles, for the rays of the bundle.
__attribute__((noinline))
void keep_of_bundle(Tile *tile, Bundle *bundle, uint alive, const uint *ids, uint count, MESH_PARAMETERS)
{
    const Corners8 p = gather_corners(vertices, faces, ids, count);
    float8 au, av, ad, bu, bv, bd, cu, cv, cd;
    if (bundle->kd == 0) {
        au = p.a.y, av = p.a.z, ad = p.a.x, bu = p.b.y, bv = p.b.z, bd = p.b.x, cu = p.c.y, cv = p.c.z, cd = p.c.x;
    } else if (bundle->kd == 1) {
        au = p.a.z, av = p.a.x, ad = p.a.y, bu = p.b.z, bv = p.b.x, bd = p.b.y, cu = p.c.z, cv = p.c.x, cd = p.c.y;
    } else {
        au = p.a.x, av = p.a.y, ad = p.a.z, bu = p.b.x, bv = p.b.y, bd = p.b.z, cu = p.c.x, cv = p.c.y, cd = p.c.z;
    }
    uint met = bits_of(may_meet(&bundle->beam, au, av, ad, bu, bv, bd, cu, cv, cd)) & ((1u << count) - 1u);
    if (met == 0)
        return;
    float of[9][LANES];
    vstore8(au, 0, of[0]);
    vstore8(av, 0, of[1]);
    vstore8(ad, 0, of[2]);
    vstore8(bu, 0, of[3]);
    vstore8(bv, 0, of[4]);
    vstore8(bd, 0, of[5]);
    vstore8(cu, 0, of[6]);
    vstore8(cv, 0, of[7]);
    vstore8(cd, 0, of[8]);
    for (; met != 0; met &= met - 1) {
        const uint i = lowest_bit(met);
        const Corner corner = {of[0][i], of[1][i], of[2][i], of[3][i], of[4][i], of[5][i], of[6][i], of[7][i], of[8][i]};
        uint groups = alive & bits_of(may_be_met(&bundle->beams, of[0][i], of[1][i], of[2][i], of[3][i], of[4][i],
                                                 of[5][i], of[6][i], of[7][i], of[8][i]));
        for (; groups != 0; groups &= groups - 1)
            keep_of_group(tile, bundle, lowest_bit(groups), &corner, ids[i], MESH_ARGUMENTS);
    }
}

// Triangles that wait to be tested, eight at a time, and those that were seen lately.
typedef struct {
    uint ids[LANES];
    uint seen[SEEN];
} Waiting;

// Takes up the triangles of the cells first .. last of a row; tests all that have become eight. Returns how many wait.
uint take_run(Tile *tile, Bundle *bundle, uint alive, Waiting *waiting, uint count, uint first, uint last,
              GRID_PARAMETERS, MESH_PARAMETERS)
{
#if defined(LAYOUT_HASHED) || defined(LAYOUT_LINKED_LIST) || defined(LAYOUT_DYNAMIC_ARRAY)
    for (uint cell = first; cell <= last; ++cell) {
        List list = find_list(cell, grid, LIST_ARGUMENTS);
#else
    {
        // The lists of consecutive cells follow each other.
        List list = {cells[first], (uint)(cells[last + 1] - cells[first])};
#endif
#ifdef LAYOUT_LINKED_LIST
        for (ref_index node = list.begin; node != NO_REFERENCE; node = next[node]) {
            const uint id = triangles[node];
#else
#ifdef LAYOUT_DYNAMIC_ARRAY
        __global const uint *entries = pool + list.begin;
#else
        __global const uint *entries = references + list.begin;
#endif
        for (uint i = 0; i < list.count; ++i) {
            const uint id = entries[i];
#endif
            const uint at = id % SEEN;
            waiting->ids[count] = id;
            count += waiting->seen[at] != id ? 1 : 0;
            waiting->seen[at] = id;
            if (count == LANES) {
                keep_of_bundle(tile, bundle, alive, waiting->ids, LANES, MESH_ARGUMENTS);
                count = 0;
            }
        }
    }
    return count;
}

// Index of the cell along an axis that holds x, which may be outside.
float cell_of(__constant const GridParams *grid, int axis, float x)
{
    return (x - grid->lower_f[axis]) * grid->cells_per_unit[axis];
}

// Narrows the depths to where the bundle's bounds overlap the grid. False: nowhere.
bool clip_depths(Bundle *bundle, __constant const GridParams *grid)
{
    for (int i = 0; i < 4; ++i) {
        const int axis = i < 2 ? bundle->ku : bundle->kv;
        // A least coordinate is to be below the upper side, a greatest one above the lower.
        const float sign = i & 1 ? -1.0f : 1.0f;
        const float side = (float)(i & 1 ? grid->lower[axis] : grid->upper[axis]) + sign * BEAM_PAD;
        const float slope = sign * bundle->beam.slope[i], room = sign * (side - bundle->beam.at[i]);
        // slope * depth <= room
        const float depth = room / slope;
        if (slope > 0x1p-20f)
            bundle->to = min(bundle->to, depth + BEAM_PAD + fabs(depth) * 0x1p-20f);
        else if (slope < -0x1p-20f)
            bundle->from = max(bundle->from, depth - BEAM_PAD - fabs(depth) * 0x1p-20f);
        else if (room < -0x1p-16f)
            return false;
    }
    return bundle->from < bundle->to;
}

// Casts the rays of the bundle. False: they spread too far.
bool walk_slices(Tile *tile, Bundle *bundle, GRID_PARAMETERS, MESH_PARAMETERS)
{
    const int ku = bundle->ku, kv = bundle->kv, kd = bundle->kd;
    const int mu = (int)grid->resolution[ku], mv = (int)grid->resolution[kv], md = (int)grid->resolution[kd];
    const bool climbs = bundle->side > 0.0f;
    const float u_scale = grid->cells_per_unit[ku], v_scale = grid->cells_per_unit[kv];
    const Beam beam = bundle->beam;
    if (!clip_depths(bundle, grid))
        return true;
    for (int end = 0; end < 2; ++end) {
        const float depth = end ? bundle->to : bundle->from;
        const float us = (beam.at[1] - beam.at[0] + (beam.slope[1] - beam.slope[0]) * depth) * u_scale;
        const float vs = (beam.at[3] - beam.at[2] + (beam.slope[3] - beam.slope[2]) * depth) * v_scale;
        if ((us + 1.0f) * (vs + 1.0f) > WIDEST_SLICE)
            return false;
    }
    const float lower = grid->lower_f[kd], cell = (float)grid->cell_size[kd];
    const float start = climbs ? bundle->from : bundle->to, end = climbs ? bundle->to : bundle->from;
    int slice = clamp((int)((start - lower) * grid->cells_per_unit[kd] + (climbs ? -0.01f : 0.01f)), 0, md - 1);
    const int last_slice = clamp((int)((end - lower) * grid->cells_per_unit[kd] + (climbs ? 0.01f : -0.01f)), 0, md - 1);
    Waiting waiting;
    for (uint i = 0; i < SEEN; i += LANES)
        vstore8((uint8)(NO_HIT), 0, waiting.seen + i);
    const int step = climbs ? 1 : -1;
    for (;; slice += step) {
        const float near = lower + (float)(climbs ? slice : slice + 1) * cell;
        const float far = lower + (float)(climbs ? slice + 1 : slice) * cell;
        const uint alive = bits_of(near * bundle->side - BEAM_PAD <= bundle->deepest);
        if (alive == 0)
            break;
        const float u0 = min(beam.at[0] + beam.slope[0] * near, beam.at[0] + beam.slope[0] * far);
        const float u1 = max(beam.at[1] + beam.slope[1] * near, beam.at[1] + beam.slope[1] * far);
        const float v0 = min(beam.at[2] + beam.slope[2] * near, beam.at[2] + beam.slope[2] * far);
        const float v1 = max(beam.at[3] + beam.slope[3] * near, beam.at[3] + beam.slope[3] * far);
        const float lu = cell_of(grid, ku, u0 - BEAM_PAD), hu = cell_of(grid, ku, u1 + BEAM_PAD);
        const float lv = cell_of(grid, kv, v0 - BEAM_PAD), hv = cell_of(grid, kv, v1 + BEAM_PAD);
        if (hu >= 0.0f && hv >= 0.0f && lu < (float)mu && lv < (float)mv) {
            int low[3], high[3];
            low[ku] = (int)max(lu, 0.0f);
            high[ku] = (int)min(hu, (float)(mu - 1));
            low[kv] = (int)max(lv, 0.0f);
            high[kv] = (int)min(hv, (float)(mv - 1));
            low[kd] = high[kd] = slice;
            uint count = 0;
            for (int z = low[2]; z <= high[2]; ++z)
                for (int y = low[1]; y <= high[1]; ++y) {
                    const uint row = ((uint)z * grid->resolution[1] + (uint)y) * grid->resolution[0];
                    count = take_run(tile, bundle, alive, &waiting, count, row + (uint)low[0], row + (uint)high[0],
                                     GRID_ARGUMENTS, MESH_ARGUMENTS);
                }
            if (count != 0)
                keep_of_bundle(tile, bundle, alive, waiting.ids, count, MESH_ARGUMENTS);
        }
        if (slice == last_slice)
            break;
    }
    return true;
}

#ifdef WIDE_RAYS
void load_group(const Tile *tile, Bundle *bundle, uint g, double *first, double *last)
{
    float ou[LANES], ov[LANES], od[LANES], dd[LANES], su[LANES], sv[LANES], sd[LANES], slack[LANES];
    for (uint lane = 0; lane < LANES; ++lane) {
        const uint k = g * LANES + lane;
        ou[lane] = ov[lane] = od[lane] = dd[lane] = su[lane] = sv[lane] = sd[lane] = slack[lane] = 0.0f;
        first[lane] = last[lane] = 0.0;
        if (!(bundle->members >> k & 1ul))
            continue;
        const Ray *ray = &tile->rays[k];
        const Shear *s = &tile->projections[k].narrow;
        ou[lane] = (float)ray->origin[bundle->ku];
        ov[lane] = (float)ray->origin[bundle->kv];
        od[lane] = (float)ray->origin[bundle->kd];
        dd[lane] = (float)ray->direction[bundle->kd];
        su[lane] = s->kx == bundle->ku ? s->sx : s->sy;
        sv[lane] = s->kx == bundle->ku ? s->sy : s->sx;
        sd[lane] = s->sz;
        slack[lane] = (float)(T_SLACK + 0x1p-51 * fabs(ray->t_entry)) + T_PAD;
        first[lane] = first_t(ray);
        last[lane] = fmin(last_t(ray), (double)tile->hits[k].meeting.t);
    }
    bundle->ou[g] = vload8(0, ou);
    bundle->ov[g] = vload8(0, ov);
    bundle->od[g] = vload8(0, od);
    bundle->dd[g] = vload8(0, dd);
    bundle->su[g] = vload8(0, su);
    bundle->sv[g] = vload8(0, sv);
    bundle->sd[g] = vload8(0, sd);
    bundle->slack[g] = vload8(0, slack);
}
#else
// first_t and last_t.
double4 first_4(const Tile *tile, uint k)
{
    const double4 entry = vload4(0, tile->t_entry + k);
    return vload4(0, tile->t_min + k) / vload4(0, tile->t_unit + k) - entry - (2.0 * T_SLACK + 0x1p-50 * fabs(entry));
}

double4 last_4(const Tile *tile, uint k)
{
    const double4 entry = vload4(0, tile->t_entry + k);
    const double4 last = vload4(0, tile->t_max + k) / vload4(0, tile->t_unit + k) - entry
                         + (2.0 * T_SLACK + 0x1p-50 * fabs(entry));
    return min(last, convert_double4(vload4(0, tile->t + k)));
}

void load_group(const Tile *tile, Bundle *bundle, uint g, double *first, double *last)
{
    const uint k = g * LANES;
    bundle->ou[g] = vload8(g, tile->o[bundle->ku]);
    bundle->ov[g] = vload8(g, tile->o[bundle->kv]);
    bundle->od[g] = vload8(g, tile->o[bundle->kd]);
    const float8 du = vload8(g, tile->d[bundle->ku]), dv = vload8(g, tile->d[bundle->kv]);
    const float8 dd = vload8(g, tile->d[bundle->kd]);
    const double4 low = convert_double4(dd.lo), high = convert_double4(dd.hi);
    bundle->dd[g] = dd;
    bundle->su[g] = narrowed(convert_double4(du.lo) / low, convert_double4(du.hi) / high);
    bundle->sv[g] = narrowed(convert_double4(dv.lo) / low, convert_double4(dv.hi) / high);
    bundle->sd[g] = narrowed(1.0 / low, 1.0 / high);
    const double4 entry_low = vload4(0, tile->t_entry + k), entry_high = vload4(0, tile->t_entry + k + 4);
    bundle->slack[g] = narrowed(T_SLACK + 0x1p-51 * fabs(entry_low), T_SLACK + 0x1p-51 * fabs(entry_high)) + T_PAD;
    vstore4(first_4(tile, k), 0, first);
    vstore4(first_4(tile, k + 4), 1, first);
    vstore4(last_4(tile, k), 0, last);
    vstore4(last_4(tile, k + 4), 1, last);
}
#endif

// Sets up the bundle of the rays `members`, which share `class`. False: none of them passes the grid.
bool set_bundle(const Tile *tile, ulong members, uint class, __constant const GridParams *grid, Bundle *bundle)
{
    bundle->members = members;
    bundle->kd = (int)(class >> 1);
    bundle->ku = bundle->kd == 2 ? 0 : bundle->kd + 1;
    bundle->kv = bundle->ku == 2 ? 0 : bundle->ku + 1;
    bundle->side = class & 1 ? -1.0f : 1.0f;
    const float lower = (float)grid->lower[bundle->kd] - BEAM_PAD, upper = (float)grid->upper[bundle->kd] + BEAM_PAD;
    float8 least = (float8)(INFINITY), greatest = (float8)(-INFINITY);
    for (uint g = 0; g < GROUPS; ++g) {
        double first[LANES], last[LANES];
        load_group(tile, bundle, g, first, last);
        const int8 own = members_of(bundle, g);
        // Beyond what a ray can be inside for, t does not matter, and infinities would be in the way.
        const float8 start = narrowed(clamp(vload4(0, first), -16.0, 16.0), clamp(vload4(1, first), -16.0, 16.0));
        const float8 end = narrowed(clamp(vload4(0, last), -16.0, 16.0), clamp(vload4(1, last), -16.0, 16.0));
        bundle->last[g] = own ? end + bundle->slack[g] : (float8)(-INFINITY);
        const float8 near = bundle->od[g] + start * bundle->dd[g], far = bundle->od[g] + bundle->last[g] * bundle->dd[g];
        least = min(least, own ? min(near, far) : (float8)(INFINITY));
        greatest = max(greatest, own ? max(near, far) : (float8)(-INFINITY));
    }
    bundle->from = max(least_of(least) - BEAM_PAD, lower);
    bundle->to = min(greatest_of(greatest) + BEAM_PAD, upper);
    if (!(bundle->from < bundle->to))
        return false;
    for (uint g = 0; g < GROUPS; ++g)
        set_deepest(bundle, g);
    return set_beams(bundle, grid);
}

#ifdef WIDE_RAYS
// Major axis, twice, plus one if the ray descends it.
uint class_of(const Shear *s)
{
    return 2 * (uint)s->kz + (s->sz < 0.0f ? 1 : 0);
}

// The rays, among `pending`, of one class, which is told too.
ulong take_class(const Tile *tile, ulong pending, uint *class)
{
    ulong members = 0;
    for (uint k = 0; k < TILE_RAYS; ++k) {
        if (!(pending >> k & 1ul))
            continue;
        const uint own = class_of(&tile->projections[k].narrow);
        *class = members == 0 ? own : *class;
        members |= own == *class ? 1ul << k : 0ul;
    }
    return members;
}
#else
ulong take_class(const Tile *tile, ulong pending, uint *class)
{
    uint classes[TILE_RAYS];
    for (uint g = 0; g < GROUPS; ++g) {
        const float8 x = vload8(g, tile->d[0]), y = vload8(g, tile->d[1]), z = vload8(g, tile->d[2]);
        const float8 ax = fabs(x), ay = fabs(y), az = fabs(z);
        const int8 is_x = (ax >= ay) & (ax >= az), is_y = ~(ax >= ay) & (ay >= az);
        const float8 major = is_x ? x : is_y ? y : z;
        const int8 axis = is_x ? (int8)(0) : is_y ? (int8)(2) : (int8)(4);
        vstore8(as_uint8(axis + (major < 0.0f ? (int8)(1) : (int8)(0))), g, classes);
    }
    const uint first = (uint)pending != 0 ? lowest_bit((uint)pending) : 32 + lowest_bit((uint)(pending >> 32));
    *class = classes[first];
    ulong members = 0;
    for (uint g = 0; g < GROUPS; ++g)
        members |= (ulong)bits_of(vload8(g, classes) == *class) << (LANES * g);
    return members & pending;
}
#endif

// What the query asks for of the triangles that the tile's rays meet; the hits are no_hit() or bounds (PARTS).
void cast_tile(Tile *tile, GRID_PARAMETERS, MESH_PARAMETERS)
{
    ulong pending = tile->reach;
    while (pending != 0) {
        uint class;
        const ulong members = take_class(tile, pending, &class);
        pending &= ~members;
        Bundle bundle;
        if (!set_bundle(tile, members, class, grid, &bundle)
            || walk_slices(tile, &bundle, GRID_ARGUMENTS, MESH_ARGUMENTS))
            continue;
        for (uint k = 0; k < TILE_RAYS; ++k)
            if (members >> k & 1ul) {
                const Ray ray = ray_of(tile, k);
                set_hit(tile, k, traverse(&ray, hit_of(tile, k), GRID_ARGUMENTS, MESH_ARGUMENTS));
            }
    }
}

#endif
