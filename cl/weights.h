// The weights of the second and third corner at the hits of four rays of a tile: those of triangle.h, or for
// `robust` the same operations in step.
#ifndef CLG_WEIGHTS_H
#define CLG_WEIGHTS_H
#include "tile.h"

typedef struct {
    double4 u, v;
} Weights;

#if defined(WIDE_RAYS) || defined(ALONE)
Weights weights_of_4(const Tile *tile, uint k, uint4 ids, MESH_PARAMETERS)
{
    double u[4], v[4];
    for (uint i = 0; i < 4; ++i) {
        const Hit hit = described_hit(tile, k + i, MESH_ARGUMENTS);
        u[i] = (double)hit.u;
        v[i] = (double)hit.v;
    }
    const Weights weights = {vload4(0, u), vload4(0, v)};
    return weights;
}
#else
// Coordinates of four corners.
typedef struct {
    float4 x, y, z;
} Corner4;

Corner4 load_corner(__global const float *vertices, __global const uint *faces, uint4 ids, uint corner)
{
    const float4 a = load_vertex(vertices, faces[3 * (size_t)ids.x + corner]);
    const float4 b = load_vertex(vertices, faces[3 * (size_t)ids.y + corner]);
    const float4 c = load_vertex(vertices, faces[3 * (size_t)ids.z + corner]);
    const float4 d = load_vertex(vertices, faces[3 * (size_t)ids.w + corner]);
    const Corner4 p = {(float4)(a.x, b.x, c.x, d.x), (float4)(a.y, b.y, c.y, d.y), (float4)(a.z, b.z, c.z, d.z)};
    return p;
}

// The axes of each ray's shear; that x and y do not change places (shear.h) negates all edge functions alike.
typedef struct {
    int4 is_x, is_y;
    float4 ou, ov, od, su, sv;
} Shear4;

float4 on_u(const Shear4 *s, float4 x, float4 y, float4 z)
{
    return s->is_x ? y : s->is_y ? z : x;
}

float4 on_v(const Shear4 *s, float4 x, float4 y, float4 z)
{
    return s->is_x ? z : s->is_y ? x : y;
}

float4 on_d(const Shear4 *s, float4 x, float4 y, float4 z)
{
    return s->is_x ? x : s->is_y ? y : z;
}

Shear4 shear_of_4(const Tile *tile, uint k)
{
    const float4 x = vload4(0, tile->d[0] + k), y = vload4(0, tile->d[1] + k), z = vload4(0, tile->d[2] + k);
    const float4 ox = vload4(0, tile->o[0] + k), oy = vload4(0, tile->o[1] + k), oz = vload4(0, tile->o[2] + k);
    Shear4 s;
    s.is_x = (fabs(x) >= fabs(y)) & (fabs(x) >= fabs(z));
    s.is_y = ~(fabs(x) >= fabs(y)) & (fabs(y) >= fabs(z));
    s.ou = on_u(&s, ox, oy, oz);
    s.ov = on_v(&s, ox, oy, oz);
    s.od = on_d(&s, ox, oy, oz);
    const double4 depth = convert_double4(on_d(&s, x, y, z));
    s.su = convert_float4(convert_double4(on_u(&s, x, y, z)) / depth);
    s.sv = convert_float4(convert_double4(on_v(&s, x, y, z)) / depth);
    return s;
}

// Sheared x and y of four corners.
void shear_corner(const Shear4 *s, const Corner4 *p, float4 *x, float4 *y)
{
    const float4 depth = on_d(s, p->x, p->y, p->z) - s->od;
    *x = (on_u(s, p->x, p->y, p->z) - s->ou) - s->su * depth;
    *y = (on_v(s, p->x, p->y, p->z) - s->ov) - s->sv * depth;
}

Weights weights_of_4(const Tile *tile, uint k, uint4 ids, MESH_PARAMETERS)
{
    const Shear4 s = shear_of_4(tile, k);
    const Corner4 a = load_corner(vertices, faces, ids, 0), b = load_corner(vertices, faces, ids, 1);
    const Corner4 c = load_corner(vertices, faces, ids, 2);
    float4 ax, ay, bx, by, cx, cy;
    shear_corner(&s, &a, &ax, &ay);
    shear_corner(&s, &b, &bx, &by);
    shear_corner(&s, &c, &cx, &cy);
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
