// The weights of the second and third corner at the hits of four rays of a tile: the operations of triangle.h
// in step.
#ifndef CLG_WEIGHTS_H
#define CLG_WEIGHTS_H
#include "tile.h"

typedef struct {
    double4 u, v;
} Weights;

// Coordinates of four corners.
typedef struct {
    real4 x, y, z;
} Corner4;

Corner4 load_corner(MESH_PARAMETERS, uint4 ids, uint corner)
{
    const uint n[4] = {faces[3 * (size_t)ids.x + corner], faces[3 * (size_t)ids.y + corner],
                       faces[3 * (size_t)ids.z + corner], faces[3 * (size_t)ids.w + corner]};
#ifdef WIDE_VERTICES
    const double4 a = (double4)(vload3((size_t)n[0], wide_vertices), 0.0);
    const double4 b = (double4)(vload3((size_t)n[1], wide_vertices), 0.0);
    const double4 c = (double4)(vload3((size_t)n[2], wide_vertices), 0.0);
    const double4 d = (double4)(vload3((size_t)n[3], wide_vertices), 0.0);
#else
    const float4 a = load_vertex(vertices, n[0]), b = load_vertex(vertices, n[1]);
    const float4 c = load_vertex(vertices, n[2]), d = load_vertex(vertices, n[3]);
#endif
    const Corner4 p = {(real4)(a.x, b.x, c.x, d.x), (real4)(a.y, b.y, c.y, d.y), (real4)(a.z, b.z, c.z, d.z)};
    return p;
}

// The axes of each ray's shear; that x and y do not change places (shear.h) negates all edge functions alike.
typedef struct {
    mask4 is_x, is_y;
    real4 ou, ov, od, su, sv, sd;
} Shear4;

real4 on_u(const Shear4 *s, real4 x, real4 y, real4 z)
{
    return s->is_x ? y : s->is_y ? z : x;
}

real4 on_v(const Shear4 *s, real4 x, real4 y, real4 z)
{
    return s->is_x ? z : s->is_y ? x : y;
}

real4 on_d(const Shear4 *s, real4 x, real4 y, real4 z)
{
    return s->is_x ? x : s->is_y ? y : z;
}

Shear4 shear_of_4(const Tile *tile, uint k)
{
    const real4 x = vload4(0, tile->d[0] + k), y = vload4(0, tile->d[1] + k), z = vload4(0, tile->d[2] + k);
    const real4 ox = vload4(0, tile->o[0] + k), oy = vload4(0, tile->o[1] + k), oz = vload4(0, tile->o[2] + k);
    // As shear_of chooses, in float32.
    const float4 ax = fabs(convert_float4(x)), ay = fabs(convert_float4(y)), az = fabs(convert_float4(z));
    Shear4 s;
    s.is_x = convert_mask4((ax >= ay) & (ax >= az));
    s.is_y = ~s.is_x & convert_mask4(~(ax >= ay) & (ay >= az));
    s.ou = on_u(&s, ox, oy, oz);
    s.ov = on_v(&s, ox, oy, oz);
    s.od = on_d(&s, ox, oy, oz);
    const double4 depth = convert_double4(on_d(&s, x, y, z));
    s.su = convert_real4(convert_double4(on_u(&s, x, y, z)) / depth);
    s.sv = convert_real4(convert_double4(on_v(&s, x, y, z)) / depth);
    s.sd = convert_real4(1.0 / depth);
    return s;
}

// Sheared x, y and z of four corners.
void shear_corner(const Shear4 *s, const Corner4 *p, real4 *x, real4 *y, real4 *z)
{
    *z = on_d(s, p->x, p->y, p->z) - s->od;
    *x = (on_u(s, p->x, p->y, p->z) - s->ou) - s->su * *z;
    *y = (on_v(s, p->x, p->y, p->z) - s->ov) - s->sv * *z;
}

#ifdef WIDE_RAYS
Weights weights_of_4(const Tile *tile, uint k, uint4 ids, MESH_PARAMETERS)
{
    const Shear4 s = shear_of_4(tile, k);
    const Corner4 a = load_corner(MESH_ARGUMENTS, ids, 0), b = load_corner(MESH_ARGUMENTS, ids, 1);
    const Corner4 c = load_corner(MESH_ARGUMENTS, ids, 2);
    Sheared4 p;
    shear_corner(&s, &a, &p.ax, &p.ay, &p.az);
    shear_corner(&s, &b, &p.bx, &p.by, &p.bz);
    shear_corner(&s, &c, &p.cx, &p.cy, &p.cz);
    const Crossings crossings = crossings_of(&p, s.sd, (long4)(-1));
    Weights weights = {crossings.u, crossings.v};
    if (any(crossings.unsure)) {
        double u[4], v[4];
        vstore4(weights.u, 0, u);
        vstore4(weights.v, 0, v);
        for (ulong lanes = bits_of_4(crossings.unsure); lanes != 0; lanes &= lanes - 1) {
            const uint i = lowest_of_64(lanes);
            const Hit hit = described_hit(tile, k + i, MESH_ARGUMENTS);
            u[i] = hit.u;
            v[i] = hit.v;
        }
        weights.u = vload4(0, u);
        weights.v = vload4(0, v);
    }
    return weights;
}
#else
Weights weights_of_4(const Tile *tile, uint k, uint4 ids, MESH_PARAMETERS)
{
    const Shear4 s = shear_of_4(tile, k);
    const Corner4 a = load_corner(MESH_ARGUMENTS, ids, 0), b = load_corner(MESH_ARGUMENTS, ids, 1);
    const Corner4 c = load_corner(MESH_ARGUMENTS, ids, 2);
    float4 ax, ay, az, bx, by, bz, cx, cy, cz;
    shear_corner(&s, &a, &ax, &ay, &az);
    shear_corner(&s, &b, &bx, &by, &bz);
    shear_corner(&s, &c, &cx, &cy, &cz);
    const float4 u = cx * by - cy * bx, v = ax * cy - ay * cx, w = bx * ay - by * ax;
    const float4 reach = max(max(max(fabs(ax), fabs(ay)), max(fabs(bx), fabs(by))), max(fabs(cx), fabs(cy)));
    // As finish_hit.
    const int4 hard = (fabs((u + v) + w) < 2.0f * reach * reach * reach)
                      | (min(min(fabs(u), fabs(v)), fabs(w)) < SMALLEST_EDGE);
    double4 u64 = convert_double4(u), v64 = convert_double4(v), w64 = convert_double4(w);
    if (any(hard)) {
        const long4 wide = convert_long4(hard);
        u64 = wide ? difference_of_4(cx, by, cy, bx) : u64;
        v64 = wide ? difference_of_4(ax, cy, ay, cx) : v64;
        w64 = wide ? difference_of_4(bx, ay, by, ax) : w64;
    }
    const double4 det = (u64 + v64) + w64;
    const Weights weights = {convert_double4(convert_float4(v64 / det)), convert_double4(convert_float4(w64 / det))};
    return weights;
}
#endif

#endif
