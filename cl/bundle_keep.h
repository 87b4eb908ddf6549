// What the rays of a bundle keep of a triangle: candidates by the shear of shear.h, eight rays at a time, then
// the rung's own test (triangle.h), or, for `robust`, the same operations four rays at a time.
//   RUNG_FAST   the rung has a test of its own (bundle_fast.h)
//   WIDE_RAYS   the same in float64 (bundle_wide.h)
#ifndef CLG_BUNDLE_KEEP_H
#define CLG_BUNDLE_KEEP_H
#include "bundle.h"

Triangles along_axes(const Corners8 *p, int kd)
{
    const Triangles x = {p->a.y, p->a.z, p->a.x, p->b.y, p->b.z, p->b.x, p->c.y, p->c.z, p->c.x};
    const Triangles y = {p->a.z, p->a.x, p->a.y, p->b.z, p->b.x, p->b.y, p->c.z, p->c.x, p->c.y};
    const Triangles z = {p->a.x, p->a.y, p->a.z, p->b.x, p->b.y, p->b.z, p->c.x, p->c.y, p->c.z};
    return kd == 0 ? x : kd == 1 ? y : z;
}

#ifdef RUNG_FAST
#include "bundle_fast.h"
#else
// A triangle as eight rays see it (shear.h), and its edge functions.
typedef struct {
    float8 ax, ay, az, bx, by, bz, cx, cy, cz;
    float8 u, v, w;
} Seen;

void set_edges(Seen *s)
{
    s->u = s->cx * s->by - s->cy * s->bx;
    s->v = s->ax * s->cy - s->ay * s->cx;
    s->w = s->bx * s->ay - s->by * s->ax;
}

// The same float32 operations as in the test of one ray and one triangle.
Seen see(const Bundle *bundle, uint g, const Triangle *p)
{
    const float8 ou = bundle->ou[g], ov = bundle->ov[g], od = bundle->od[g];
    const float8 su = bundle->su[g], sv = bundle->sv[g];
    Seen s;
    s.az = p->ad - od;
    s.bz = p->bd - od;
    s.cz = p->cd - od;
    s.ax = (p->au - ou) - su * s.az;
    s.ay = (p->av - ov) - sv * s.az;
    s.bx = (p->bu - ou) - su * s.bz;
    s.by = (p->bv - ov) - sv * s.bz;
    s.cx = (p->cu - ou) - su * s.cz;
    s.cy = (p->cv - ov) - sv * s.cz;
    set_edges(&s);
    return s;
}

float8 reach_of_lanes(const Seen *s)
{
    return max(max(max(fabs(s->ax), fabs(s->ay)), max(fabs(s->bx), fabs(s->by))), max(fabs(s->cx), fabs(s->cy)));
}

// The lanes that the edge functions do not rule out, nor that the triangle lies behind all that matters.
int8 open_lanes(const Bundle *bundle, uint g, const Seen *s)
{
#ifdef WIDE_RAYS
    const float8 doubt = DOUBT_OF_FILTER(reach_of_lanes(s));
#else
    const float doubt = 0.0f;
#endif
    const int8 negative = (s->u < -doubt) | (s->v < -doubt) | (s->w < -doubt);
    const int8 positive = (s->u > doubt) | (s->v > doubt) | (s->w > doubt);
    const float8 sd = bundle->sd[g], last = bundle->last[g];
    const float8 nearest = min(min(s->az * sd, s->bz * sd), s->cz * sd);
    return ~(negative & positive) & (nearest <= last) & (last > -INFINITY);
}

#ifdef WIDE_RAYS
#include "bundle_wide.h"
#else
// Half of what eight rays see.
typedef struct {
    float4 ax, ay, az, bx, by, bz, cx, cy, cz;
    float4 u, v, w;
} Seen4;

Seen4 low_half(const Seen *s)
{
    const Seen4 four = {s->ax.lo, s->ay.lo, s->az.lo, s->bx.lo, s->by.lo, s->bz.lo,
                        s->cx.lo, s->cy.lo, s->cz.lo, s->u.lo, s->v.lo, s->w.lo};
    return four;
}

Seen4 high_half(const Seen *s)
{
    const Seen4 four = {s->ax.hi, s->ay.hi, s->az.hi, s->bx.hi, s->by.hi, s->bz.hi,
                        s->cx.hi, s->cy.hi, s->cz.hi, s->u.hi, s->v.hi, s->w.hi};
    return four;
}

// Four rays, from `k` on, and a triangle that their edge functions do not rule out: finish_hit, within and before
// in step. `hard` lanes need edge functions in float64.
void keep_of_4(Tile *tile, uint k, int4 open, int4 hard, const Seen4 *s, float4 sd, uint id)
{
    double4 u = convert_double4(s->u), v = convert_double4(s->v), w = convert_double4(s->w);
    long4 refused = (long4)(0);
    if (any(hard)) {
        const long4 wide = convert_long4(hard);
        u = wide ? difference_of_4(s->cx, s->by, s->cy, s->bx) : u;
        v = wide ? difference_of_4(s->ax, s->cy, s->ay, s->cx) : v;
        w = wide ? difference_of_4(s->bx, s->ay, s->by, s->ax) : w;
        refused = wide & ((u < 0.0) | (v < 0.0) | (w < 0.0)) & ((u > 0.0) | (v > 0.0) | (w > 0.0));
    }
    const double4 det = (u + v) + w;
    const double4 at = ((u * convert_double4(s->az) + v * convert_double4(s->bz)) + w * convert_double4(s->cz))
                       * convert_double4(sd) / det;
    const float4 t = convert_float4(at), best = vload4(0, tile->t + k);
    const uint4 ids = vload4(0, tile->ids + k);
    const double4 entry = vload4(0, tile->t_entry + k), unit = vload4(0, tile->t_unit + k);
    const double4 scene = (entry + convert_double4(t)) * unit;
    long4 taken = ~refused & (det != 0.0);
    taken &= (scene >= vload4(0, tile->t_min + k)) & (scene <= vload4(0, tile->t_max + k));
#ifndef QUERY_ANY
    const double4 least = (entry + convert_double4(best)) * unit;
    taken &= (scene < least) | ((scene == least) & convert_long4((uint4)(id) < ids));
#endif
    const int4 takes = open & convert_int4(taken);
    vstore4(takes ? t : best, 0, tile->t + k);
    vstore4(takes ? (uint4)(id) : ids, 0, tile->ids + k);
}

void keep_of_lanes(Tile *tile, Bundle *bundle, uint g, const Seen *s, int8 open, uint id, MESH_PARAMETERS)
{
    // As finish_hit.
    const float8 reach = reach_of_lanes(s);
    const int8 hard = (fabs((s->u + s->v) + s->w) < 2.0f * reach * reach * reach)
                      | (min(min(fabs(s->u), fabs(s->v)), fabs(s->w)) < SMALLEST_EDGE);
    const float8 sd = bundle->sd[g];
    if (any(open.lo)) {
        const Seen4 four = low_half(s);
        keep_of_4(tile, g * LANES, open.lo, hard.lo, &four, sd.lo, id);
    }
    if (any(open.hi)) {
        const Seen4 four = high_half(s);
        keep_of_4(tile, g * LANES + 4, open.hi, hard.hi, &four, sd.hi, id);
    }
#ifdef QUERY_ANY
    bundle->last[g] = vload8(g, tile->ids) == NO_HIT ? bundle->last[g] : (float8)(-INFINITY);
#else
    bundle->last[g] = min(bundle->last[g], vload8(g, tile->t) + bundle->slack[g]);
#endif
}
#endif

void keep_of_group(Tile *tile, Bundle *bundle, uint g, const Seen *seen, uint id, MESH_PARAMETERS)
{
    const int8 open = open_lanes(bundle, g, seen);
    if (!any(open))
        return;
    keep_of_lanes(tile, bundle, g, seen, open, id, MESH_ARGUMENTS);
    set_deepest(bundle, g);
}

#ifdef PINHOLES
#include "pinhole.h"
#endif

// 1 to 8 triangles, for the groups whose bits are set in `alive`.
__attribute__((noinline))
void keep_of_bundle(Tile *tile, Bundle *bundle, uint alive, const Triangles *p, const uint *ids, uint count,
                    MESH_PARAMETERS)
{
#ifdef PINHOLES
    if (bundle->is_pinhole) {
        keep_of_pinhole(tile, bundle, alive, p, ids, count, MESH_ARGUMENTS);
        return;
    }
#endif
    uint near = bits_of(may_meet(&bundle->way.beam, p)) & ((1u << count) - 1u);
    if (near == 0)
        return;
    float of[9][LANES];
    vstore8(p->au, 0, of[0]);
    vstore8(p->av, 0, of[1]);
    vstore8(p->ad, 0, of[2]);
    vstore8(p->bu, 0, of[3]);
    vstore8(p->bv, 0, of[4]);
    vstore8(p->bd, 0, of[5]);
    vstore8(p->cu, 0, of[6]);
    vstore8(p->cv, 0, of[7]);
    vstore8(p->cd, 0, of[8]);
    for (; near != 0; near &= near - 1) {
        const uint i = lowest_of_32(near);
        const Triangle one = {of[0][i], of[1][i], of[2][i], of[3][i], of[4][i], of[5][i], of[6][i], of[7][i], of[8][i]};
        for (uint groups = alive & bits_of(may_be_met(&bundle->beams, &one)); groups != 0; groups &= groups - 1) {
            const uint g = lowest_of_32(groups);
            const Seen seen = see(bundle, g, &one);
            keep_of_group(tile, bundle, g, &seen, ids[i], MESH_ARGUMENTS);
        }
    }
}

#endif
#endif
