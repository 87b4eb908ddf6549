// Rung `fast`: bundles in float32. A ray is told from the bundle's middle line: at depth z beyond `start`, as seen
// along that line, it is at (u + su z, v + sv z). These are small numbers, and a vertex that triangles share is the
// same point to all. A triangle's weights are linear in (su, sv, u, v, m), m = sv u - su v (Moeller & Trumbore 1997, in
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
    const float8 dd = vload8(g, tile->d[bundle->way.kd]), inverse = 1.0f / dd, od = vload8(g, tile->o[bundle->way.kd]);
    bundle->ou[g] = vload8(g, tile->o[bundle->way.ku]);
    bundle->ov[g] = vload8(g, tile->o[bundle->way.kv]);
    bundle->od[g] = od;
    bundle->su[g] = vload8(g, tile->d[bundle->way.ku]) * inverse;
    bundle->sv[g] = vload8(g, tile->d[bundle->way.kv]) * inverse;
    bundle->sd[g] = inverse;
    bundle->found[g] = (uint8)(NO_HIT);
    const int8 own = members_of(bundle, g);
    const float8 end = min(local_t(tile, g, tile->t_max), vload8(g, tile->t));
    bundle->first[g] = (od + local_t(tile, g, tile->t_min) * dd) * bundle->way.side;
    bundle->last[g] = own ? (od + end * dd) * bundle->way.side : (float8)(-INFINITY);
    *least = own ? min(*least, bundle->first[g]) : *least;
    *greatest = max(*greatest, bundle->last[g]);
}

// From now on seen along the middle of the beam, from `from` on.
void straighten(Bundle *bundle)
{
    const Beam *beam = &bundle->way.beam;
    const float start = bundle->way.from;
    bundle->start = start;
    for (int i = 0; i < 2; ++i) {
        const float tilt = 0.5f * (beam->slope[2 * i] + beam->slope[2 * i + 1]);
        const float middle = 0.5f * (beam->at[2 * i] + beam->at[2 * i + 1]) + tilt * start;
        bundle->tilt[i] = tilt;
        bundle->middle[i] = middle;
        bundle->spread[i] = 0.5f * (beam->slope[2 * i + 1] - beam->slope[2 * i]);
        bundle->width[i] = 0.5f * (beam->at[2 * i + 1] - beam->at[2 * i]) + bundle->spread[i] * start;
        for (int j = 2 * i; j < 2 * i + 2; ++j) {
            vstore8(bundle->beams.at[j] + bundle->beams.slope[j] * start - middle, 0, bundle->bounds[j]);
            vstore8(bundle->beams.slope[j] - tilt, 0, bundle->slopes[j]);
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
    name_axes(&bundle->way, class);
    bundle->members = members;
    float8 least = (float8)(INFINITY), greatest = (float8)(-INFINITY);
    for (uint g = 0; g < GROUPS; ++g)
        load_group(tile, bundle, g, &least, &greatest);
    const float near = least_of(least) - T_PAD, far = greatest_of(greatest) + T_PAD;
    const bool climbs = bundle->way.side > 0.0f;
    bundle->way.from = max(climbs ? near : -far, (float)grid->lower[bundle->way.kd] - BEAM_PAD);
    bundle->way.to = min(climbs ? far : -near, (float)grid->upper[bundle->way.kd] + BEAM_PAD);
    if (!(bundle->way.from < bundle->way.to))
        return false;
    bundle->stale = (1u << GROUPS) - 1u;
    set_beams(bundle);
    straighten(bundle);
    return true;
}

// A function of a ray: at[0] + at[1] su + at[2] sv + at[3] u + at[4] v + at[5] m.
typedef struct {
    float8 at[6];
} Forms;

// Boxes of eight triangles as seen along the middle line (u, v, depth), and what weights and depths are made of.
typedef struct {
    float8 low[3], high[3];
    Forms second, third;              // weights times the determinant
    float8 nu, nv, nz, plane;         // normal; its product with the corners
} Prepared;

// On which side of a ray the edge from p to q passes, as six times the volume of the tetrahedron between them.
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

// Which of eight triangles may come near a ray of a group.
uint near_group(const Bundle *bundle, uint g, const Prepared *p)
{
    int8 apart = (int8)(0);
    for (int i = 0; i < 2; ++i) {
        const float low = bundle->slopes[2 * i][g], high = bundle->slopes[2 * i + 1][g];
        apart |= p->high[i] < bundle->bounds[2 * i][g] + min(low * p->low[2], low * p->high[2]);
        apart |= p->low[i] > bundle->bounds[2 * i + 1][g] + max(high * p->low[2], high * p->high[2]);
    }
    return bits_of(~apart);
}

#define NUMBERS 16  // of a triangle in Prepared that rays need

void store_numbers(const Prepared *p, float numbers[NUMBERS][LANES])
{
    for (int i = 0; i < 6; ++i) {
        vstore8(p->second.at[i], 0, numbers[i]);
        vstore8(p->third.at[i], 0, numbers[6 + i]);
    }
    vstore8(p->nu, 0, numbers[12]);
    vstore8(p->nv, 0, numbers[13]);
    vstore8(p->nz, 0, numbers[14]);
    vstore8(p->plane, 0, numbers[15]);
}

// The nearest is kept of each ray of a group that meets triangle i; ties go to the lowest id. Without branches: half
// of the tests find something.
void keep_of_group(Bundle *bundle, uint g, float numbers[NUMBERS][LANES], uint i, uint id)
{
    const float8 u = bundle->ou[g], v = bundle->ov[g], su = bundle->su[g], sv = bundle->sv[g], m = bundle->moment[g];
    const float8 inverse = 1.0f / (numbers[12][i] * su + numbers[13][i] * sv + numbers[14][i]);
    const float8 second = numbers[0][i] + numbers[1][i] * su + numbers[2][i] * sv + numbers[3][i] * u
                          + numbers[4][i] * v + numbers[5][i] * m;
    const float8 third = numbers[6][i] + numbers[7][i] * su + numbers[8][i] * sv + numbers[9][i] * u
                         + numbers[10][i] * v + numbers[11][i] * m;
    const float8 z = (numbers[15][i] - numbers[12][i] * u - numbers[13][i] * v) * inverse;
    const float8 depth = (z + bundle->start) * bundle->way.side, last = bundle->last[g];
    const uint8 found = bundle->found[g];
    const int8 takes = are_inside(second * inverse, third * inverse) & (depth >= bundle->first[g])
                       & ((depth < last) | ((depth == last) & ((uint8)(id) < found)));
    bundle->found[g] = takes ? (uint8)(id) : found;
#ifdef QUERY_ANY
    bundle->last[g] = takes ? (float8)(-INFINITY) : last;
#else
    bundle->last[g] = takes ? depth : last;
#endif
}

// 1 to 8 triangles, for the groups whose bits are set in `alive`.
__attribute__((noinline))
void keep_of_bundle(Tile *tile, Bundle *bundle, uint alive, const Triangles *triangles, const uint *ids, uint count,
                    MESH_PARAMETERS)
{
    if (!any(may_meet(&bundle->way.beam, triangles)))
        return;
    const Prepared p = prepare(bundle, triangles);
    const uint near = near_beam(bundle, &p) & ((1u << count) - 1u);
    if (near == 0)
        return;
    // Bit 8 * g + i: group g and triangle i. In one loop: the ends of many short ones could not be foretold.
    ulong pairs = 0;
    for (uint g = 0; g < GROUPS; ++g)
        pairs |= (ulong)(near_group(bundle, g, &p) & (0u - (alive >> g & 1u)) & near) << (LANES * g);
    float numbers[NUMBERS][LANES];
    store_numbers(&p, numbers);
    for (; pairs != 0; pairs &= pairs - 1) {
        const uint pair = lowest_of_64(pairs), g = pair / LANES, i = pair % LANES;
        keep_of_group(bundle, g, numbers, i, ids[i]);
        bundle->stale |= 1u << g;
    }
}

// Gives the tile what the bundle's rays found.
void settle(Tile *tile, const Bundle *bundle)
{
    for (uint g = 0; g < GROUPS; ++g) {
        const uint8 found = bundle->found[g], ids = vload8(g, tile->ids);
        const int8 has = found != NO_HIT;
        const float8 t = (bundle->last[g] * bundle->way.side - bundle->od[g]) * bundle->sd[g];
        vstore8(has ? found : ids, g, tile->ids);
        vstore8(has ? t : vload8(g, tile->t), g, tile->t);
    }
}

#endif
