// Bundles whose rays share their origin. Seen from there a ray is its two slopes, and a triangle's edge functions are
// linear in them: over the slopes of a group of rays they are greatest at a corner of that range. What is known of
// triangles is made for eight at once, then eight groups are held against each (docs/numerics.md, "Tiles"). Part of
// bundle_keep.h.
#ifndef CLG_PINHOLE_H
#define CLG_PINHOLE_H

// Pairs of a group and a triangle to be tested, from which on the edges are asked first: they cost as much as some
// tests, and small triangles are seldom left out by them.
#ifndef FEWEST_OUTLINED
#define FEWEST_OUTLINED 16
#endif

// What is known of eight triangles, one by one: corners less the origin, least and greatest slopes to them, the depth
// that no corner comes before.
typedef struct {
    float corners[9][LANES], ends[4][LANES], depth[LANES];
} Views;

// Edge functions (of su, of sv, constant), and at which end of the slopes' ranges they are greatest.
typedef struct {
    float edges[9][LANES];
    int places[6][LANES];
} Outlines;

// The triangles seen from the origin.
Triangles from_origin(const Bundle *bundle, const Triangles *p)
{
    const float ou = bundle->origin[0], ov = bundle->origin[1], od = bundle->origin[2];
    const Triangles q = {p->au - ou, p->av - ov, p->ad - od, p->bu - ou, p->bv - ov, p->bd - od,
                         p->cu - ou, p->cv - ov, p->cd - od};
    return q;
}

// Edge function of corners p and q: coefficients of su, of sv, and the constant.
typedef struct {
    float8 u, v, d;
} Edge8;

Edge8 edge_of(float8 pu, float8 pv, float8 pd, float8 qu, float8 qv, float8 qd)
{
    const Edge8 e = {pv * qd - pd * qv, pd * qu - pu * qd, pu * qv - pv * qu};
    return e;
}

float8 greatest_over(const Bundle *bundle, const Edge8 *e)
{
    const float *s = bundle->slopes_of_all;
    return e->d + max(e->u * s[0], e->u * s[1]) + max(e->v * s[2], e->v * s[3]);
}

float8 least_over(const Bundle *bundle, const Edge8 *e)
{
    const float *s = bundle->slopes_of_all;
    return e->d + min(e->u * s[0], e->u * s[1]) + min(e->v * s[2], e->v * s[3]);
}

float8 largest_of(float8 u, float8 v, float8 d)
{
    return max(max(fabs(u), fabs(v)), fabs(d));
}

// 1 if all rays of the bundle see the triangles' corners go round one way, -1 if the other, 0 if it is not sure.
float8 sense_of(const Bundle *bundle, const Triangles *q, float8 reach)
{
    const float8 eu = q->cu - q->au, ev = q->cv - q->av, ed = q->cd - q->ad;
    const float8 fu = q->bu - q->au, fv = q->bv - q->av, fd = q->bd - q->ad;
    const Edge8 area = edge_of(eu, ev, ed, fu, fv, fd);
    const float8 size = max(largest_of(eu, ev, ed), largest_of(fu, fv, fd));
    const float8 slack = reach * (size + reach * 0x1p-22f) * AREA_SLACK + LEAST_SLACK;
    return least_over(bundle, &area) > slack ? (float8)(1.0f)
           : greatest_over(bundle, &area) < -slack ? (float8)(-1.0f) : (float8)(0.0f);
}

// Least and greatest of the slopes to three corners, where all are ahead; the slopes to others say nothing.
void ends_of(int8 ahead, float8 a, float8 b, float8 c, float8 *least, float8 *greatest)
{
    *least = ahead ? min(min(a, b), c) - SLOPE_PAD : (float8)(-INFINITY);
    *greatest = ahead ? max(max(a, b), c) + SLOPE_PAD : (float8)(INFINITY);
}

// Bits: those of eight triangles whose corners are not all beside the rays; and what is known of them.
uint view_of(const Bundle *bundle, const Triangles *q, Views *views)
{
    const float side = bundle->way.side;
    const float *s = bundle->slopes_of_all;
    const float8 nearest = min(min(q->ad * side, q->bd * side), q->cd * side);
    const int8 ahead = nearest > 0x1p-20f;
    const float8 a = 1.0f / q->ad, b = 1.0f / q->bd, c = 1.0f / q->cd;
    float8 ends[4];
    ends_of(ahead, q->au * a, q->bu * b, q->cu * c, ends, ends + 1);
    ends_of(ahead, q->av * a, q->bv * b, q->cv * c, ends + 2, ends + 3);
    const uint near = bits_of(~((ends[0] > s[1]) | (ends[1] < s[0]) | (ends[2] > s[3]) | (ends[3] < s[2])));
    if (near == 0)
        return 0;
    for (int i = 0; i < 4; ++i)
        vstore8(ends[i], 0, views->ends[i]);
    vstore8(nearest + (bundle->origin[2] * side - BEAM_PAD), 0, views->depth);
    vstore8(q->au, 0, views->corners[0]);
    vstore8(q->av, 0, views->corners[1]);
    vstore8(q->ad, 0, views->corners[2]);
    vstore8(q->bu, 0, views->corners[3]);
    vstore8(q->bv, 0, views->corners[4]);
    vstore8(q->bd, 0, views->corners[5]);
    vstore8(q->cu, 0, views->corners[6]);
    vstore8(q->cv, 0, views->corners[7]);
    vstore8(q->cd, 0, views->corners[8]);
    return near;
}

// Bits: those of eight triangles that not all rays pass outside one edge; and their edges.
uint outline(const Bundle *bundle, const Triangles *q, Outlines *out)
{
    const float8 reach = max(max(largest_of(q->au, q->av, q->ad), largest_of(q->bu, q->bv, q->bd)),
                             largest_of(q->cu, q->cv, q->cd));
    const float8 sense = sense_of(bundle, q, reach), slack = reach * reach * EDGE_SLACK + LEAST_SLACK;
    Edge8 edges[3];
    edges[0] = edge_of(q->cu, q->cv, q->cd, q->bu, q->bv, q->bd);
    edges[1] = edge_of(q->au, q->av, q->ad, q->cu, q->cv, q->cd);
    edges[2] = edge_of(q->bu, q->bv, q->bd, q->au, q->av, q->ad);
    int8 outside = (int8)(0);
    for (int i = 0; i < 3; ++i) {
        Edge8 *e = edges + i;
        e->u *= sense;
        e->v *= sense;
        e->d = e->d * sense + slack;
        outside |= greatest_over(bundle, e) < 0.0f;
        vstore8(e->u, 0, out->edges[3 * i]);
        vstore8(e->v, 0, out->edges[3 * i + 1]);
        vstore8(e->d, 0, out->edges[3 * i + 2]);
        vstore8(e->u > 0.0f ? (int8)(1) : (int8)(0), 0, out->places[2 * i]);
        vstore8(e->v > 0.0f ? (int8)(3) : (int8)(2), 0, out->places[2 * i + 1]);
    }
    return bits_of(~outside);
}

// Edge function e of triangle i, where it is greatest over the slopes of each group.
float8 greatest_of_edge(const Bundle *bundle, const Outlines *out, uint i, int e)
{
    return out->edges[3 * e + 2][i] + out->edges[3 * e][i] * bundle->slopes[out->places[2 * e][i]]
           + out->edges[3 * e + 1][i] * bundle->slopes[out->places[2 * e + 1][i]];
}

// -1: the groups that triangle i is beside of, or behind all that matters to them.
int8 groups_beside(const Bundle *bundle, const Views *views, uint i)
{
    const float8 *s = bundle->slopes;
    return (views->ends[0][i] > s[1]) | (views->ends[1][i] < s[0]) | (views->ends[2][i] > s[3])
           | (views->ends[3][i] < s[2]) | (views->depth[i] > bundle->deepest);
}

// -1: the groups that pass outside an edge of triangle i.
int8 groups_outside(const Bundle *bundle, const Outlines *out, uint i)
{
    return min(min(greatest_of_edge(bundle, out, i, 0), greatest_of_edge(bundle, out, i, 1)),
               greatest_of_edge(bundle, out, i, 2)) < 0.0f;
}

// see, of triangle i.
Seen see_view(const Bundle *bundle, uint g, const Views *views, uint i)
{
    const float8 su = bundle->su[g], sv = bundle->sv[g];
    Seen s;
    s.az = (float8)(views->corners[2][i]);
    s.bz = (float8)(views->corners[5][i]);
    s.cz = (float8)(views->corners[8][i]);
    s.ax = views->corners[0][i] - su * s.az;
    s.ay = views->corners[1][i] - sv * s.az;
    s.bx = views->corners[3][i] - su * s.bz;
    s.by = views->corners[4][i] - sv * s.bz;
    s.cx = views->corners[6][i] - su * s.cz;
    s.cy = views->corners[7][i] - sv * s.cz;
    set_edges(&s);
    return s;
}

// As keep_of_bundle.
void keep_of_pinhole(Tile *tile, Bundle *bundle, uint alive, const Triangles *p, const uint *ids, uint count,
                     MESH_PARAMETERS)
{
    Views views;
    const Triangles q = from_origin(bundle, p);
    const uint near = view_of(bundle, &q, &views) & ((1u << count) - 1u);
    if (near == 0)
        return;
    // Lane g, bit i: group g is not to be tested against triangle i.
    int8 apart = (int8)((int)~near) | ~lanes_of(alive);
    for (uint left = near; left != 0; left &= left - 1)
        apart |= groups_beside(bundle, &views, lowest_of_32(left)) & (int8)((int)(left & (0u - left)));
    // Bit 8 * g + i.
    ulong pairs = as_ulong(convert_uchar8(~apart & 0xFF));
    if (popcount(pairs) >= FEWEST_OUTLINED) {
        Outlines out;
        const uint inside = near & outline(bundle, &q, &out);
        apart |= (int8)((int)~inside);
        for (uint left = inside; left != 0; left &= left - 1)
            apart |= groups_outside(bundle, &out, lowest_of_32(left)) & (int8)((int)(left & (0u - left)));
        pairs = as_ulong(convert_uchar8(~apart & 0xFF));
    }
    for (; pairs != 0; pairs &= pairs - 1) {
        const uint pair = lowest_of_64(pairs), g = pair / LANES, i = pair % LANES;
        const Seen seen = see_view(bundle, g, &views, i);
        keep_of_group(tile, bundle, g, &seen, ids[i], MESH_ARGUMENTS);
    }
}

#endif
