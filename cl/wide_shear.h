// The shear of shear.h in float64, on the triangle's exact coordinates.
#ifndef CLG_WIDE_SHEAR_H
#define CLG_WIDE_SHEAR_H
#include "mesh.h"
#include "shear.h"

typedef struct {
    Shear narrow;            // for the filter
    int kx, ky, kz;
    double ox, oy, oz;
    double sx, sy, sz;
} Projection;

Projection projection_of(const Ray *ray)
{
    Projection s;
    float origin[3], direction[3];
    for (int a = 0; a < 3; ++a) {
        origin[a] = (float)ray->origin[a];
        direction[a] = (float)ray->direction[a];
    }
    s.narrow = shear_of(origin, direction);
    // The axes of the narrow shear: rounding may make components equal, never swap them, so |sx|, |sy| <= 1 + 2u.
    s.kx = s.narrow.kx;
    s.ky = s.narrow.ky;
    s.kz = s.narrow.kz;
    s.ox = ray->origin[s.kx];
    s.oy = ray->origin[s.ky];
    s.oz = ray->origin[s.kz];
    const double dz = ray->direction[s.kz];
    s.sx = ray->direction[s.kx] / dz;
    s.sy = ray->direction[s.ky] / dz;
    s.sz = 1.0 / dz;
    return s;
}

int8 candidates_of(const Projection *projection, const Corners8 *corners)
{
    return candidates_of_shear(&projection->narrow, corners);
}

int8 candidates_of_soup(const Projection *projection, __global const float *corner, size_t n)
{
    return candidates_of_sheared_soup(&projection->narrow, corner, n);
}

// The vertices as the ray sees them: relative to the origin, permuted, sheared.
typedef struct {
    double ax, ay, az, bx, by, bz, cx, cy, cz;
} Sheared;

Sheared shear_triangle(const Projection *s, const Corners *corners)
{
    const double *a = corners->at[0], *b = corners->at[1], *c = corners->at[2];
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

// Of the edges that are opposite of a, b and c.
void edge_functions(const Sheared *p, double *edges)
{
    const double u = p->cx * p->by - p->cy * p->bx;
    const double v = p->ax * p->cy - p->ay * p->cx;
    const double w = p->bx * p->ay - p->by * p->ax;
    edges[0] = u;
    edges[1] = v;
    edges[2] = w;
}

double reach_of(const Sheared *p)
{
    return fmax(fmax(fmax(fabs(p->ax), fabs(p->ay)), fmax(fabs(p->bx), fabs(p->by))),
                fmax(fabs(p->cx), fabs(p->cy)));
}

// Whether the edge functions, if each is known up to `doubt`, do not all have the same sign.
bool signs_differ(double u, double v, double w, double doubt)
{
    return (u < -doubt || v < -doubt || w < -doubt) && (u > doubt || v > doubt || w > doubt);
}

// Four rays, each with a triangle that it sees; sheared x and y may change places in all lanes alike.
typedef struct {
    double4 ax, ay, az, bx, by, bz, cx, cy, cz;
} Sheared4;

// What is known of their crossings without looking closer. Weights are of the second and third vertex.
typedef struct {
    long4 met, unsure;       // `unsure`: the test of one ray has to decide
    double4 t, u, v;
#ifdef RUNG_EXACT
    double4 error;           // of t
#endif
} Crossings;

double4 reaches_of(const Sheared4 *p)
{
    return max(max(max(fabs(p->ax), fabs(p->ay)), max(fabs(p->bx), fabs(p->by))), max(fabs(p->cx), fabs(p->cy)));
}

long4 signs_differ_of_4(double4 u, double4 v, double4 w, double4 doubt)
{
    return ((u < -doubt) | (v < -doubt) | (w < -doubt)) & ((u > doubt) | (v > doubt) | (w > doubt));
}

#endif
