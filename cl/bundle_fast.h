// Rung `fast`: bundles in float32. A ray is told from the bundle's middle line: at depth z beyond `start`, as seen along
// that line, it is at (u + su z, v + sv z). These are small numbers, and a vertex that triangles share is the same
// point to all. A triangle's weights are linear in (su, sv, u, v, m), m = sv u - su v (Moeller & Trumbore 1997, in
// Pluecker's coordinates): what they are made of is computed for eight triangles at once, and shared by all rays.
#ifndef CLG_BUNDLE_FAST_H
#define CLG_BUNDLE_FAST_H
#include "bundle.h"
#include "gather.h"

// Local t of eight scene t, within what the grid can be of.
float8 local_t(const Tile *tile, uint g, const double *scene)
{
    double4 t[2];
    for (uint i = 0; i < 2; ++i) {
        // By 1 / t_unit, a power of two.
        const double4 per_unit = as_double4(0x7FE0000000000000ul - as_ulong4(vload4(2 * g + i, tile->t_unit)));
        t[i] = vload4(2 * g + i, scene) * per_unit - vload4(2 * g + i, tile->t_entry);
        t[i] = clamp(t[i], -FARTHEST_T, FARTHEST_T);
    }
    return narrowed(t[0], t[1]);
}

// Sets a group's rays; widens the sided coordinates that they pass.
void load_group(const Tile *tile, Bundle *bundle, uint g, float8 *least, float8 *greatest)
{
    const float8 dd = vload8(g, tile->d[bundle->kd]), inverse = 1.0f / dd, od = vload8(g, tile->o[bundle->kd]);
    bundle->ou[g] = vload8(g, tile->o[bundle->ku]);
    bundle->ov[g] = vload8(g, tile->o[bundle->kv]);
    bundle->od[g] = od;
    bundle->su[g] = vload8(g, tile->d[bundle->ku]) * inverse;
    bundle->sv[g] = vload8(g, tile->d[bundle->kv]) * inverse;
    bundle->sd[g] = inverse;
    const int8 own = members_of(bundle, g);
    const float8 end = min(local_t(tile, g, tile->t_max), vload8(g, tile->t));
    bundle->first[g] = (od + local_t(tile, g, tile->t_min) * dd) * bundle->side;
    bundle->last[g] = own ? (od + end * dd) * bundle->side : (float8)(-INFINITY);
    *least = own ? min(*least, bundle->first[g]) : *least;
    *greatest = max(*greatest, bundle->last[g]);
}

// From now on seen along the middle of the beam, from `from` on.
void straighten(Bundle *bundle)
{
    const Beam *beam = &bundle->beam;
    const float start = bundle->from;
    bundle->start = start;
    for (int i = 0; i < 2; ++i) {
        const float tilt = 0.5f * (beam->slope[2 * i] + beam->slope[2 * i + 1]);
        const float middle = 0.5f * (beam->at[2 * i] + beam->at[2 * i + 1]) + tilt * start;
        bundle->tilt[i] = tilt;
        bundle->middle[i] = middle;
        bundle->spread[i] = 0.5f * (beam->slope[2 * i + 1] - beam->slope[2 * i]);
        bundle->width[i] = 0.5f * (beam->at[2 * i + 1] - beam->at[2 * i]) + bundle->spread[i] * start;
        for (int j = 2 * i; j < 2 * i + 2; ++j) {
            bundle->beams.at[j] = bundle->beams.at[j] + bundle->beams.slope[j] * start - middle;
            bundle->beams.slope[j] = bundle->beams.slope[j] - tilt;
        }
    }
    for (uint g = 0; g < GROUPS; ++g) {
        const float8 ahead = start - bundle->od[g];
        bundle->ou[g] = (bundle->ou[g] - bundle->middle[0]) + ahead * bundle->su[g];
        bundle->ov[g] = (bundle->ov[g] - bundle->middle[1]) + ahead * bundle->sv[g];
        bundle->su[g] -= bundle->tilt[0];
        bundle->sv[g] -= bundle->tilt[1];
        bundle->moment[g] = bundle->sv[g] * bundle->ou[g] - bundle->su[g] * bundle->ov[g];
    }
}

// Sets up the bundle of the rays `members`, which share `class`. False: none of them is in the grid's depths.
bool set_bundle(const Tile *tile, ulong members, uint class, __constant const GridParams *grid, Bundle *bundle)
{
    name_axes(bundle, members, class);
    float8 least = (float8)(INFINITY), greatest = (float8)(-INFINITY);
    for (uint g = 0; g < GROUPS; ++g)
        load_group(tile, bundle, g, &least, &greatest);
    const float near = least_of(least) - T_PAD, far = greatest_of(greatest) + T_PAD;
    const bool climbs = bundle->side > 0.0f;
    bundle->from = max(climbs ? near : -far, (float)grid->lower[bundle->kd] - BEAM_PAD);
    bundle->to = min(climbs ? far : -near, (float)grid->upper[bundle->kd] + BEAM_PAD);
    if (!(bundle->from < bundle->to))
        return false;
    for (uint g = 0; g < GROUPS; ++g)
        set_deepest(bundle, g);
    set_beams(bundle);
    straighten(bundle);
    return true;
}

// A function of a ray: at[0] + at[1] su + at[2] sv + at[3] u + at[4] v + at[5] m.
typedef struct {
    float8 at[6];
} Forms;

// Boxes of eight triangles as seen along the middle line, and what their weights and depths are made of.
typedef struct {
    float8 low[3], high[3];
    Forms second, third;              // weights times the determinant
    float8 nu, nv, nz, plane;         // normal; its product with the corners
} Prepared;

// The side of a ray on which the edge from p to q passes.
Forms edge_forms(float8 pu, float8 pv, float8 pz, float8 qu, float8 qv, float8 qz)
{
    Forms f;
    f.at[0] = pu * qv - pv * qu;
    f.at[1] = pv * qz - pz * qv;
    f.at[2] = pz * qu - pu * qz;
    f.at[3] = pv - qv;
    f.at[4] = qu - pu;
    f.at[5] = qz - pz;
    return f;
}

Prepared prepare(const Bundle *bundle, const Triangles *p)
{
    const float8 az = p->ad - bundle->start, bz = p->bd - bundle->start, cz = p->cd - bundle->start;
    const float8 au = (p->au - bundle->middle[0]) - bundle->tilt[0] * az;
    const float8 av = (p->av - bundle->middle[1]) - bundle->tilt[1] * az;
    const float8 bu = (p->bu - bundle->middle[0]) - bundle->tilt[0] * bz;
    const float8 bv = (p->bv - bundle->middle[1]) - bundle->tilt[1] * bz;
    const float8 cu = (p->cu - bundle->middle[0]) - bundle->tilt[0] * cz;
    const float8 cv = (p->cv - bundle->middle[1]) - bundle->tilt[1] * cz;
    Prepared e;
    e.low[0] = min(min(au, bu), cu);
    e.low[1] = min(min(av, bv), cv);
    e.low[2] = min(min(az, bz), cz);
    e.high[0] = max(max(au, bu), cu);
    e.high[1] = max(max(av, bv), cv);
    e.high[2] = max(max(az, bz), cz);
    e.second = edge_forms(cu, cv, cz, au, av, az);
    e.third = edge_forms(au, av, az, bu, bv, bz);
    const float8 eu = bu - au, ev = bv - av, ez = bz - az, fu = cu - au, fv = cv - av, fz = cz - az;
    e.nu = ev * fz - ez * fv;
    e.nv = ez * fu - eu * fz;
    e.nz = eu * fv - ev * fu;
    e.plane = e.nu * au + e.nv * av + e.nz * az;
    return e;
}

// Which of eight triangles may come near a ray of the bundle.
uint near_beam(const Bundle *bundle, const Prepared *p)
{
    int8 apart = (int8)(0);
    for (int i = 0; i < 2; ++i) {
        const float8 width = bundle->width[i] + max(bundle->spread[i] * p->low[2], bundle->spread[i] * p->high[2]);
        apart |= (p->low[i] > width) | (p->high[i] < -width);
    }
    return bits_of(~apart);
}

// To which groups a box may be near.
uint near_groups(const Beams *beams, const float *low, const float *high)
{
    int8 apart = (int8)(0);
    for (int i = 0; i < 2; ++i) {
        const float8 least = beams->at[2 * i] + min(beams->slope[2 * i] * low[2], beams->slope[2 * i] * high[2]);
        const float8 greatest = beams->at[2 * i + 1]
                                + max(beams->slope[2 * i + 1] * low[2], beams->slope[2 * i + 1] * high[2]);
        apart |= (low[i] > greatest) | (high[i] < least);
    }
    return bits_of(~apart);
}

#define NUMBERS 22  // of a triangle in Prepared

void store_numbers(const Prepared *p, float numbers[NUMBERS][LANES])
{
    for (int i = 0; i < 3; ++i) {
        vstore8(p->low[i], 0, numbers[i]);
        vstore8(p->high[i], 0, numbers[3 + i]);
    }
    for (int i = 0; i < 6; ++i) {
        vstore8(p->second.at[i], 0, numbers[6 + i]);
        vstore8(p->third.at[i], 0, numbers[12 + i]);
    }
    vstore8(p->nu, 0, numbers[18]);
    vstore8(p->nv, 0, numbers[19]);
    vstore8(p->nz, 0, numbers[20]);
    vstore8(p->plane, 0, numbers[21]);
}

// The nearest becomes the hit of each ray of a group that meets triangle i. Ties go to the lowest id.
void keep_of_group(Tile *tile, Bundle *bundle, uint g, float numbers[NUMBERS][LANES], uint i, uint id)
{
    const float8 u = bundle->ou[g], v = bundle->ov[g], su = bundle->su[g], sv = bundle->sv[g], m = bundle->moment[g];
    const float8 inverse = 1.0f / (numbers[18][i] * su + numbers[19][i] * sv + numbers[20][i]);
    const float8 second = numbers[6][i] + numbers[7][i] * su + numbers[8][i] * sv + numbers[9][i] * u + numbers[10][i] * v
                          + numbers[11][i] * m;
    const float8 third = numbers[12][i] + numbers[13][i] * su + numbers[14][i] * sv + numbers[15][i] * u
                         + numbers[16][i] * v + numbers[17][i] * m;
    const float8 z = (numbers[21][i] - numbers[18][i] * u - numbers[19][i] * v) * inverse;
    const float8 coordinate = z + bundle->start, depth = coordinate * bundle->side, last = bundle->last[g];
    const int8 open = are_inside(second * inverse, third * inverse) & (depth >= bundle->first[g]) & (depth <= last);
    if (!any(open))
        return;
    const uint8 ids = vload8(g, tile->ids);
    const int8 takes = open & ((depth < last) | as_int8((uint8)(id) < ids));
    vstore8(takes ? (coordinate - bundle->od[g]) * bundle->sd[g] : vload8(g, tile->t), g, tile->t);
    vstore8(takes ? (uint8)(id) : ids, g, tile->ids);
#ifdef QUERY_ANY
    bundle->last[g] = takes ? (float8)(-INFINITY) : last;
#else
    bundle->last[g] = takes ? depth : last;
#endif
    set_deepest(bundle, g);
}

// 1 to 8 triangles, for the groups whose bits are set in `alive`.
__attribute__((noinline))
void keep_of_bundle(Tile *tile, Bundle *bundle, uint alive, const uint *ids, uint count, MESH_PARAMETERS)
{
    const Corners8 corners = gather_corners(vertices, faces, ids, count);
    const Triangles along = along_axes(&corners, bundle->kd);
    const Prepared p = prepare(bundle, &along);
    uint near = near_beam(bundle, &p) & ((1u << count) - 1u);
    if (near == 0)
        return;
    float numbers[NUMBERS][LANES];
    store_numbers(&p, numbers);
    for (; near != 0; near &= near - 1) {
        const uint i = lowest_of_32(near);
        const float low[3] = {numbers[0][i], numbers[1][i], numbers[2][i]};
        const float high[3] = {numbers[3][i], numbers[4][i], numbers[5][i]};
        for (uint groups = alive & near_groups(&bundle->beams, low, high); groups != 0; groups &= groups - 1)
            keep_of_group(tile, bundle, lowest_of_32(groups), numbers, i, ids[i]);
    }
}

#endif
