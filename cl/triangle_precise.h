// Rung `precise`: the test of triangle_robust.h with vertices, rays and arithmetic in float64. The signs of
// the edge functions are exact: a computed sign is right because rounding is monotone, and what may be zero is
// decided with what rounding took from the products (pair.h), or, where those underflow, by integers.
#ifndef CLG_TRIANGLE_PRECISE_H
#define CLG_TRIANGLE_PRECISE_H
#include "big.h"
#include "meeting.h"
#include "t_error.h"
#include "wide_shear.h"

// Products below this may have lost digits to underflow.
#define SMALLEST_PRODUCT 0x1p-900

// p q - r s with the exact sign, and a relative error of some 2^-51, unless it is below 2^-1000.
// Factors are at most 8.
double difference_of_products(double p, double q, double r, double s)
{
    const bool left = p != 0.0 && q != 0.0, right = r != 0.0 && s != 0.0;
    if (!left || !right)
        return left || right ? p * q - r * s + 0x1p-1074 * (left ? sign(p) * sign(q) : -sign(r) * sign(s)) : 0.0;
    const Pair a = two_product(p, q), b = two_product(r, s);
    if (fabs(a.high) < SMALLEST_PRODUCT || fabs(b.high) < SMALLEST_PRODUCT)
        return a.high != b.high ? a.high - b.high : 0x1p-1074 * compare_products(p, q, r, s);
    // a.high - b.high is exact where the low parts count.
    const Pair high = two_sum(a.high, -b.high), low = two_sum(a.low, -b.low);
    const Pair sum = two_sum(high.high, low.high);
    return sum.high + (sum.low + (high.low + low.low));
}

// A power of two that brings the largest of them to about 1, if they are less: an exact factor.
double scale_up(double a, double b, double c)
{
    const double reach = fmax(fmax(fabs(a), fabs(b)), fabs(c));
    return reach == 0.0 ? 1.0 : power_of_two(-clamp(exponent_above(reach), -1020, 0));
}

// t and, if it is not null, `weights` of the second and third vertex and the edge functions' sum, of a
// hit whose edge functions u, v, w do not rule it out. False: no hit after all.
bool finish_hit(const Projection *s, const Sheared *p, double u, double v, double w, double *t, double *weights)
{
    const double reach = reach_of(p);
    const bool slender = fabs((u + v) + w) < 2.0 * reach * reach * reach;
    double x_scale = 1.0, y_scale = 1.0;
    if (slender || fmin(fmin(fabs(u), fabs(v)), fabs(w)) < SMALLEST_PRODUCT) {
        // Each axis to about 1: the weights have their digits however flat the triangle is seen.
        x_scale = scale_up(p->ax, p->bx, p->cx);
        y_scale = scale_up(p->ay, p->by, p->cy);
        const double ax = p->ax * x_scale, bx = p->bx * x_scale, cx = p->cx * x_scale;
        const double ay = p->ay * y_scale, by = p->by * y_scale, cy = p->cy * y_scale;
        u = difference_of_products(cx, by, cy, bx);
        v = difference_of_products(ax, cy, ay, cx);
        w = difference_of_products(bx, ay, by, ax);
        if (signs_differ(u, v, w, 0.0))
            return false;
    }
    const double det = (u + v) + w;
    if (det == 0.0)
        return false;
    *t = ((u / det * p->az + v / det * p->bz) + w / det * p->cz) * s->sz;
    if (weights) {
        weights[0] = v / det;
        weights[1] = w / det;
        weights[2] = det / x_scale / y_scale;
    }
    return true;
}

bool intersect_triangle(const Projection *s, const Sheared *p, double *t, double *weights)
{
    double edges[3];
    edge_functions(p, edges);
    const double u = edges[0], v = edges[1], w = edges[2];
    if (signs_differ(u, v, w, 0.0))
        return false;
    return finish_hit(s, p, u, v, w, t, weights);
}

// Whether the ray's line meets the triangle, and where; an accepted t is within neither interval nor order.
bool meet(const Ray *ray, const Projection *s, MESH_PARAMETERS, uint id, Meeting *meeting)
{
    const Corners corners = corners_of(id, MESH_ARGUMENTS);
    const Sheared p = shear_triangle(s, &corners);
    return intersect_triangle(s, &p, &meeting->t, 0);
}

// Of a hit: the weights of the second and third vertex, from the same arithmetic that accepted it, and the
// error of its t if that is not null.
void describe(const Ray *ray, const Projection *s, MESH_PARAMETERS, uint id, const Meeting *meeting, real *weights,
              double *t_err)
{
    const Corners corners = corners_of(id, MESH_ARGUMENTS);
    const Sheared p = shear_triangle(s, &corners);
    double t, exact[3];
    if (!intersect_triangle(s, &p, &t, exact))
        return;
    weights[0] = exact[0];
    weights[1] = exact[1];
    if (t_err) {
        const Crossing crossing = {{p.ax, p.bx, p.cx}, {p.ay, p.by, p.cy}, {p.az, p.bz, p.cz}, exact[2], t, s->sz};
        const double unit = 0x1p-53, moved = 0x1p-96 * fabs(ray->t_entry);
        *t_err = scene_t_error(ray, t, t_error(&crossing, unit + moved, 24 * unit + 2 * moved, 64 * unit + 2 * moved));
    }
}

// difference_of_products of four; `unsure` where products may underflow.
double4 differences_of_products(double4 p, double4 q, double4 r, double4 s, long4 *unsure)
{
    const Pairs a = two_products(p, q), b = two_products(r, s);
    *unsure |= ((fabs(a.high) < SMALLEST_PRODUCT) & (p != 0.0) & (q != 0.0))
               | ((fabs(b.high) < SMALLEST_PRODUCT) & (r != 0.0) & (s != 0.0));
    const Pairs high = two_sums(a.high, -b.high), low = two_sums(a.low, -b.low);
    const Pairs sum = two_sums(high.high, low.high);
    return sum.high + (sum.low + (high.low + low.low));
}

double4 scales_up(double4 a, double4 b, double4 c)
{
    const double4 reach = max(max(fabs(a), fabs(b)), fabs(c));
    // power_of_two(-clamp(exponent_above(reach), -1020, 0)).
    const long4 exponent = clamp((as_long4(reach) >> 52 & 0x7FFl) - 1022l, -1020l, 0l);
    return reach == 0.0 ? (double4)(1.0) : as_double4((1023l - exponent) << 52);
}

// intersect_triangle of four rays, for the lanes that are `open`.
Crossings crossings_of(const Sheared4 *p, double4 sz, long4 open)
{
    Crossings c;
    double4 u = p->cx * p->by - p->cy * p->bx;
    double4 v = p->ax * p->cy - p->ay * p->cx;
    double4 w = p->bx * p->ay - p->by * p->ax;
    long4 apart = signs_differ_of_4(u, v, w, (double4)(0.0));
    c.unsure = (long4)(0);
    const double4 reach = reaches_of(p);
    const long4 hard = ~apart & open
                       & ((fabs((u + v) + w) < 2.0 * reach * reach * reach)
                          | (min(min(fabs(u), fabs(v)), fabs(w)) < SMALLEST_PRODUCT));
    if (any(hard)) {
        const double4 x_scale = scales_up(p->ax, p->bx, p->cx), y_scale = scales_up(p->ay, p->by, p->cy);
        const double4 ax = p->ax * x_scale, bx = p->bx * x_scale, cx = p->cx * x_scale;
        const double4 ay = p->ay * y_scale, by = p->by * y_scale, cy = p->cy * y_scale;
        u = hard ? differences_of_products(cx, by, cy, bx, &c.unsure) : u;
        v = hard ? differences_of_products(ax, cy, ay, cx, &c.unsure) : v;
        w = hard ? differences_of_products(bx, ay, by, ax, &c.unsure) : w;
        c.unsure &= hard;
        apart |= hard & signs_differ_of_4(u, v, w, (double4)(0.0));
    }
    const double4 det = (u + v) + w;
    c.met = ~apart & ~c.unsure & (det != 0.0);
    c.u = v / det;
    c.v = w / det;
    c.t = ((u / det * p->az + c.u * p->bz) + c.v * p->cz) * sz;
    return c;
}

#endif
