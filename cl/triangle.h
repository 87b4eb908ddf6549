// Ray and triangle, watertight: Woop, Benthin, Wald 2013, "Watertight Ray/Triangle Intersection".
// A vertex shared by triangles shears to the same 2-D point bit for bit, and the edge functions
// have exact signs (rounding is monotone; zeros are decided in float64), so no ray passes between.
// Weights and t are formed in float64, so that neighbours agree closely on t.
#ifndef CLG_TRIANGLE_H
#define CLG_TRIANGLE_H
#include "ray.h"

typedef struct {
    int kx, ky, kz;          // axes; kz is the direction's largest
    float ox, oy, oz;        // origin, permuted
    float sx, sy, sz;        // shear of x, y and scale of z, each correctly rounded
} Shear;

typedef struct {
    float t;
    uint id;                 // NO_HIT on a miss
    float u, v;              // barycentric weights of the second and third vertex
#ifdef COUNT_STEPS
    uint steps;              // cells looked at
    uint tests;              // triangles tested
    uint batches;            // of up to eight triangles, each tested at once
#endif
} Hit;

Shear shear_of(const Ray *ray)
{
    Shear s;
    const float x = fabs(ray->direction[0]), y = fabs(ray->direction[1]), z = fabs(ray->direction[2]);
    s.kz = x >= y ? (x >= z ? 0 : 2) : (y >= z ? 1 : 2);
    s.kx = s.kz == 2 ? 0 : s.kz + 1;
    s.ky = s.kx == 2 ? 0 : s.kx + 1;
    // Keeps the winding of the projected triangle, whichever way the ray looks.
    if (ray->direction[s.kz] < 0.0f) {
        const int swap = s.kx;
        s.kx = s.ky;
        s.ky = swap;
    }
    s.ox = ray->origin[s.kx];
    s.oy = ray->origin[s.ky];
    s.oz = ray->origin[s.kz];
    // Through float64: correctly rounded also where the device's float32 division is not.
    const double dz = ray->direction[s.kz];
    s.sx = (float)((double)ray->direction[s.kx] / dz);
    s.sy = (float)((double)ray->direction[s.ky] / dz);
    s.sz = (float)(1.0 / dz);
    return s;
}

// The vertices as the ray sees them: relative to the origin, permuted, sheared.
typedef struct {
    float ax, ay, az, bx, by, bz, cx, cy, cz;
} Sheared;

Sheared shear_triangle(const Shear *s, __global const float *vertices, __global const uint *face)
{
    __global const float *a = vertices + 3 * (size_t)face[0];
    __global const float *b = vertices + 3 * (size_t)face[1];
    __global const float *c = vertices + 3 * (size_t)face[2];
    Sheared p;
    p.az = a[s->kz] - s->oz;
    p.bz = b[s->kz] - s->oz;
    p.cz = c[s->kz] - s->oz;
    p.ax = (a[s->kx] - s->ox) - s->sx * p.az;
    p.ay = (a[s->ky] - s->oy) - s->sy * p.az;
    p.bx = (b[s->kx] - s->ox) - s->sx * p.bz;
    p.by = (b[s->ky] - s->oy) - s->sy * p.bz;
    p.cx = (c[s->kx] - s->ox) - s->sx * p.cz;
    p.cy = (c[s->ky] - s->oy) - s->sy * p.cz;
    return p;
}

float min3(float a, float b, float c)
{
    const float m = a < b ? a : b;
    return m < c ? m : c;
}

float max3(float a, float b, float c)
{
    const float m = a > b ? a : b;
    return m > c ? m : c;
}

// Completes a hit whose edge functions u, v, w do not rule it out. False: no hit after all.
// A triangle with two equal vertices never gets here with det != 0. One whose vertices merely lie on a
// line may, within HIT_ERROR: refusing it would open the seam that it closes.
// `weights` gets the barycentric weights of the second and third vertex if it is not null.
bool finish_hit(const Shear *s, const Sheared *p, float u32, float v32, float w32, float *t, float *weights)
{
    double u = u32, v = v32, w = w32;
    const float det32 = fabs((u32 + v32) + w32);
    const float reach = max3(max3(fabs(p->ax), fabs(p->ay), fabs(p->bx)),
                             max3(fabs(p->by), fabs(p->cx), fabs(p->cy)), 0.0f);
    // Too thin for float32 weights: they would name a point that the ray does not pass.
    const bool slender = det32 < 2.0f * reach * reach * reach;
    if (slender || min3(fabs(u32), fabs(v32), fabs(w32)) < SMALLEST_EDGE) {
        // The products of two float32 are exact in float64, hence so are the signs.
        u = (double)p->cx * (double)p->by - (double)p->cy * (double)p->bx;
        v = (double)p->ax * (double)p->cy - (double)p->ay * (double)p->cx;
        w = (double)p->bx * (double)p->ay - (double)p->by * (double)p->ax;
        if ((u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0))
            return false;
    }
    const double det = (u + v) + w;
    if (det == 0.0)
        return false;
    const double at = ((u * (double)p->az + v * (double)p->bz) + w * (double)p->cz) * (double)s->sz / det;
    *t = (float)at;
    if (weights) {
        weights[0] = (float)(v / det);
        weights[1] = (float)(w / det);
    }
    return true;
}

// Tests one triangle; an accepted t is within neither interval nor order: that is the caller's.
bool intersect_triangle(const Shear *s, __global const float *vertices, __global const uint *face,
                        float *t, float *weights)
{
    const Sheared p = shear_triangle(s, vertices, face);
    const float u = p.cx * p.by - p.cy * p.bx;
    const float v = p.ax * p.cy - p.ay * p.cx;
    const float w = p.bx * p.ay - p.by * p.ax;
    if ((u < 0.0f || v < 0.0f || w < 0.0f) && (u > 0.0f || v > 0.0f || w > 0.0f))
        return false;
    return finish_hit(s, &p, u, v, w, t, weights);
}

// Takes triangle `id` as the hit if it is nearer, or as near with a lower id.
// Rare and large: kept out of line, it leaves the walk its registers.
__attribute__((noinline))
void keep_nearest(const Ray *ray, const Shear *s, __global const float *vertices, __global const uint *faces,
                  uint id, Hit *hit)
{
    float t;
    if (intersect_triangle(s, vertices, faces + 3 * (size_t)id, &t, 0)) {
        const bool nearer = t < hit->t || (t == hit->t && id < hit->id);
        if (nearer && within_interval(ray, t)) {
            hit->t = t;
            hit->id = id;
        }
    }
}

// Eight triangles at once: -1 in the lanes that the edge functions do not rule out. The same float32
// operations as in intersect_triangle, so that no lane is ruled out that the scalar test would take.
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
    const int8 negative = (u < 0.0f) | (v < 0.0f) | (w < 0.0f);
    const int8 positive = (u > 0.0f) | (v > 0.0f) | (w > 0.0f);
    return ~(negative & positive);
}

#define GATHER8(corner, axis)                                                                       \
    (float8)(corner[0][axis], corner[1][axis], corner[2][axis], corner[3][axis], corner[4][axis],  \
             corner[5][axis], corner[6][axis], corner[7][axis])

// keep_nearest over 8 triangles; a shorter list is filled up with its last: testing one twice changes nothing.
void keep_nearest_of_8(const Ray *ray, const Shear *s, __global const float *vertices,
                       __global const uint *faces, const uint *ids, uint count, Hit *hit)
{
#ifdef COUNT_STEPS
    hit->tests += count;
    ++hit->batches;
#endif
    __global const float *a[8], *b[8], *c[8];
    for (uint i = 0; i < 8; ++i) {
        __global const uint *face = faces + 3 * (size_t)ids[i];
        a[i] = vertices + 3 * (size_t)face[0];
        b[i] = vertices + 3 * (size_t)face[1];
        c[i] = vertices + 3 * (size_t)face[2];
    }
    const int8 open = candidates(s, GATHER8(a, s->kx), GATHER8(a, s->ky), GATHER8(a, s->kz),
                                 GATHER8(b, s->kx), GATHER8(b, s->ky), GATHER8(b, s->kz),
                                 GATHER8(c, s->kx), GATHER8(c, s->ky), GATHER8(c, s->kz));
    if (any(open)) {
        int lanes[8];
        vstore8(open, 0, lanes);
        for (uint i = 0; i < count; ++i)
            if (lanes[i])
                keep_nearest(ray, s, vertices, faces, ids[i], hit);
    }
}

Hit no_hit(void)
{
#ifdef COUNT_STEPS
    const Hit miss = {INFINITY, NO_HIT, 0.0f, 0.0f, 0u, 0u, 0u};
#else
    const Hit miss = {INFINITY, NO_HIT, 0.0f, 0.0f};
#endif
    return miss;
}

// The weights of the hit, from the same arithmetic that accepted it.
void set_weights(const Shear *s, __global const float *vertices, __global const uint *faces, Hit *hit)
{
    float t, weights[2] = {0.0f, 0.0f};
    if (hit->id != NO_HIT)
        intersect_triangle(s, vertices, faces + 3 * (size_t)hit->id, &t, weights);
    hit->u = weights[0];
    hit->v = weights[1];
}

#endif
