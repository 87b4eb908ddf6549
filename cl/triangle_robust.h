// Rung `robust`: the watertight test of Woop, Benthin, Wald 2013 in float32, with exact signs.
// A vertex shared by triangles shears to the same 2-D point bit for bit, and the edge functions
// have exact signs (rounding is monotone; zeros are decided in float64), so no ray passes between.
// Weights and t are formed in float64, so that neighbours agree closely on t.
#ifndef CLG_TRIANGLE_ROBUST_H
#define CLG_TRIANGLE_ROBUST_H
#include "meeting.h"
#include "mesh.h"
#include "shear.h"
#include "t_error.h"

typedef Shear Projection;

Projection projection_of(const Ray *ray)
{
    return shear_of(ray->origin, ray->direction);
}

int8 candidates_of(const Projection *projection, const Corners8 *corners)
{
    return candidates_of_shear(projection, corners);
}

int8 candidates_of_soup(const Projection *projection, __global const float *corner, size_t n)
{
    return candidates_of_sheared_soup(projection, corner, n);
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

// t and, if it is not null, `weights` of the second and third vertex and the edge functions' sum, of a
// hit whose edge functions u, v, w do not rule it out. False: no hit after all.
// A triangle with two equal vertices never gets here with det != 0. One whose vertices merely lie on a
// line may, within HIT_ERROR: refusing it would open the seam that it closes.
bool finish_hit(const Shear *s, const Sheared *p, float u32, float v32, float w32, float *t, double *weights)
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
        weights[0] = v / det;
        weights[1] = w / det;
        weights[2] = det;
    }
    return true;
}

// Of the edges that are opposite of a, b and c.
void edge_functions(const Sheared *p, float *edges)
{
    const float u = p->cx * p->by - p->cy * p->bx;
    const float v = p->ax * p->cy - p->ay * p->cx;
    const float w = p->bx * p->ay - p->by * p->ax;
    edges[0] = u;
    edges[1] = v;
    edges[2] = w;
}

bool intersect_triangle(const Shear *s, const Sheared *p, float *t, double *weights)
{
    float edges[3];
    edge_functions(p, edges);
    const float u = edges[0], v = edges[1], w = edges[2];
    if ((u < 0.0f || v < 0.0f || w < 0.0f) && (u > 0.0f || v > 0.0f || w > 0.0f))
        return false;
    return finish_hit(s, p, u, v, w, t, weights);
}

// Whether the ray's line meets the triangle, and where; an accepted t is within neither interval nor order.
bool meet(const Ray *ray, const Projection *s, MESH_PARAMETERS, uint id, Meeting *meeting)
{
    const Sheared p = shear_triangle(s, vertices, faces + 3 * (size_t)id);
    return intersect_triangle(s, &p, &meeting->t, 0);
}

// Of a hit: the weights of the second and third vertex, from the same arithmetic that accepted it, and the
// error of its t if that is not null.
void describe(const Ray *ray, const Projection *s, MESH_PARAMETERS, uint id, const Meeting *meeting, real *weights,
              double *t_err)
{
    const Sheared p = shear_triangle(s, vertices, faces + 3 * (size_t)id);
    float t;
    double exact[3];
    if (!intersect_triangle(s, &p, &t, exact))
        return;
    weights[0] = (float)exact[0];
    weights[1] = (float)exact[1];
    if (t_err) {
        const Crossing crossing = {{p.ax, p.bx, p.cx}, {p.ay, p.by, p.cy}, {p.az, p.bz, p.cz}, exact[2], t, s->sz};
        const double moved = 0x1p-50 * fabs(ray->t_entry);
        const double error = t_error(&crossing, UNIT_ROUNDOFF + moved, 21 * UNIT_ROUNDOFF + 2 * moved,
                                     20 * UNIT_ROUNDOFF + 2 * moved);
        *t_err = scene_t_error(ray, t, error);
    }
}

#endif
