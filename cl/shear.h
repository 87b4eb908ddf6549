// The shear that makes the ray the z axis: Woop, Benthin, Wald 2013, "Watertight Ray/Triangle Intersection".
// In float32; and the filter by it, eight triangles at once.
#ifndef CLG_SHEAR_H
#define CLG_SHEAR_H
#include "gather.h"
#include "ray.h"

typedef struct {
    int kx, ky, kz;          // axes; kz is the direction's largest
    float ox, oy, oz;        // origin, permuted
    float sx, sy, sz;        // shear of x, y and scale of z, each correctly rounded
} Shear;

Shear shear_of(const float *origin, const float *direction)
{
    Shear s;
    const float x = fabs(direction[0]), y = fabs(direction[1]), z = fabs(direction[2]);
    s.kz = x >= y ? (x >= z ? 0 : 2) : (y >= z ? 1 : 2);
    s.kx = s.kz == 2 ? 0 : s.kz + 1;
    s.ky = s.kx == 2 ? 0 : s.kx + 1;
    // Keeps the winding of the projected triangle, whichever way the ray looks.
    if (direction[s.kz] < 0.0f) {
        const int swap = s.kx;
        s.kx = s.ky;
        s.ky = swap;
    }
    s.ox = origin[s.kx];
    s.oy = origin[s.ky];
    s.oz = origin[s.kz];
    // Through float64: correctly rounded also where the device's float32 division is not.
    const double dz = direction[s.kz];
    s.sx = (float)((double)direction[s.kx] / dz);
    s.sy = (float)((double)direction[s.ky] / dz);
    s.sz = (float)(1.0 / dz);
    return s;
}

// How far below zero an edge function must be for its sign to count, by the largest sheared coordinate.
// Wide rungs: the sheared triangle is off by what rounding to float32 does to ray, vertices and shear
// (docs/numerics.md, "The filter"). `robust` decides by the very same float32 operations: no doubt.
#ifdef WIDE_RAYS
#define DOUBT_OF_FILTER(reach) ((reach) * (float)(100 * UNIT_ROUNDOFF) + 0x1p-38f)
#endif

// Eight triangles at once: -1 in the lanes that the edge functions do not rule out. The same float32
// operations as in the test of one, so that no lane is ruled out that the test would take.
int8 candidates(const Shear *s, float8 akx, float8 aky, float8 akz, float8 bkx, float8 bky, float8 bkz,
                float8 ckx, float8 cky, float8 ckz)
{
    const float8 az = akz - s->oz, bz = bkz - s->oz, cz = ckz - s->oz;
    const float8 ax = (akx - s->ox) - s->sx * az, ay = (aky - s->oy) - s->sy * az;
    const float8 bx = (bkx - s->ox) - s->sx * bz, by = (bky - s->oy) - s->sy * bz;
    const float8 cx = (ckx - s->ox) - s->sx * cz, cy = (cky - s->oy) - s->sy * cz;
    const float8 u = cx * by - cy * bx;
    const float8 v = ax * cy - ay * cx;
    const float8 w = bx * ay - by * ax;
#ifdef WIDE_RAYS
    const float8 doubt = DOUBT_OF_FILTER(fmax(fmax(fmax(fabs(ax), fabs(ay)), fmax(fabs(bx), fabs(by))),
                                              fmax(fabs(cx), fabs(cy))));
#else
    const float doubt = 0.0f;
#endif
    const int8 negative = (u < -doubt) | (v < -doubt) | (w < -doubt);
    const int8 positive = (u > doubt) | (v > doubt) | (w > doubt);
    return ~(negative & positive);
}

// The same for gathered corners. Whether x and y change places, which keeps the winding, does not matter to
// signs that differ: all three edge functions are negated.
int8 candidates_of_shear(const Shear *s, const Corners8 *p)
{
    Shear w = *s;
    if (s->kx != (s->kz == 2 ? 0 : s->kz + 1)) {
        w.ox = s->oy;
        w.oy = s->ox;
        w.sx = s->sy;
        w.sy = s->sx;
    }
    const Points a = p->a, b = p->b, c = p->c;
    if (s->kz == 0)
        return candidates(&w, a.y, a.z, a.x, b.y, b.z, b.x, c.y, c.z, c.x);
    if (s->kz == 1)
        return candidates(&w, a.z, a.x, a.y, b.z, b.x, b.y, c.z, c.x, c.y);
    return candidates(&w, a.x, a.y, a.z, b.x, b.y, b.z, c.x, c.y, c.z);
}

// The same for eight triangles of a soup: nine arrays of n coordinates, 3 * corner + axis.
int8 candidates_of_sheared_soup(const Shear *s, __global const float *corner, size_t n)
{
    return candidates(s, vload8(0, corner + s->kx * n), vload8(0, corner + s->ky * n),
                      vload8(0, corner + s->kz * n), vload8(0, corner + (3 + s->kx) * n),
                      vload8(0, corner + (3 + s->ky) * n), vload8(0, corner + (3 + s->kz) * n),
                      vload8(0, corner + (6 + s->kx) * n), vload8(0, corner + (6 + s->ky) * n),
                      vload8(0, corner + (6 + s->kz) * n));
}

#endif
