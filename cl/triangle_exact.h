// Rung `exact`: the answers of rational arithmetic on the caller's rays and vertices. A filter in float64
// decides with a bound on its error, or hands over to integers (exact.h). Docs/numerics.md, "Exact".
#ifndef CLG_TRIANGLE_EXACT_H
#define CLG_TRIANGLE_EXACT_H
#include "exact.h"
#include "t_error.h"
#include "wide_shear.h"

// The origin, where the ray was moved to, is off by at most this.
#define ORIGIN_ERROR (4 * 0x1p-53)
// So far are sheared coordinates off on either axis.
#define SHEAR_ERROR (20 * 0x1p-53)
// So far may an edge function be off, by the largest sheared coordinate.
#define DOUBT(reach) (0x1p-46 * (reach) + 0x1p-95)
// A t that is off by more is computed in integers: the walk counts on less than T_SLACK.
#define LARGEST_T_ERROR 0x1p-30

// So many decisions by integers on one walk cost about as much as testing all triangles once would.
#define MOST_DECISIONS(triangles) (64u + (triangles) / 256u)

typedef struct {
    double t, error;   // |t - the exact one| <= error
    bool certain;      // the filter decided whether the ray crosses the triangle
    Corners corners;
} Meeting;

__attribute__((noinline))
bool crosses_exactly(const Ray *ray, Meeting *meeting, double *weights)
{
    Exact e;
    meeting->certain = false;
    set_exact(&e, ray, &meeting->corners, unit_of(ray, &meeting->corners));
    if (!crossed(&e))
        return false;
    meeting->t = local_t(&e, ray);
    meeting->error = 0x1p-50 * fabs(meeting->t) + 0x1p-1060;
    if (weights) {
        weights[0] = quotient(&e.edge[1], &e.under, 0);
        weights[1] = quotient(&e.edge[2], &e.under, 0);
    }
    return true;
}

// Whether the ray's line crosses the triangle whose corners the meeting has.
bool crosses(const Ray *ray, const Projection *s, Meeting *meeting, double *weights)
{
    if (ray->astray)
        return crosses_exactly(ray, meeting, weights);
    meeting->certain = true;
    const Sheared p = shear_triangle(s, &meeting->corners);
    double edges[3];
    edge_functions(&p, edges);
    const double u = edges[0], v = edges[1], w = edges[2];
    const double reach = reach_of(&p), doubt = DOUBT(reach);
    if (signs_differ(u, v, w, doubt))
        return false;
    if (fmin(fmin(fabs(u), fabs(v)), fabs(w)) <= doubt)
        return crosses_exactly(ray, meeting, weights);
    const double det = (u + v) + w;
    const double t = ((u / det * p.az + v / det * p.bz) + w / det * p.cz) * s->sz;
    const Crossing crossing = {{p.ax, p.bx, p.cx}, {p.ay, p.by, p.cy}, {p.az, p.bz, p.cz}, det, t, s->sz};
    const double aside = SHEAR_ERROR + 12 * 0x1p-53 * (reach * reach * reach / fabs(det));
    const double error = t_error(&crossing, 0x1p-53, aside, 0x1p-46);
    if (!(error <= LARGEST_T_ERROR))
        return crosses_exactly(ray, meeting, weights);
    meeting->t = t;
    meeting->error = error;
    if (weights) {
        weights[0] = v / det;
        weights[1] = w / det;
    }
    return true;
}

bool meet(const Ray *ray, const Projection *s, MESH_PARAMETERS, uint id, Meeting *meeting)
{
    meeting->corners = corners_of(id, MESH_ARGUMENTS);
    return crosses(ray, s, meeting, 0);
}

__attribute__((noinline))
bool within_exactly(const Ray *ray, const Meeting *meeting)
{
    Exact e;
    set_exact(&e, ray, &meeting->corners, unit_of(ray, &meeting->corners));
#ifdef OPEN_START
    const int side = e.over.sign * e.under.sign;
    return side > 0 || (side == 0 && starts_before(&e));
#else
    return (isinf(ray->t_min) ? ray->t_min < 0.0 : compare_with_bound(&e, ray, ray->t_min) >= 0)
           && (isinf(ray->t_max) ? ray->t_max > 0.0 : compare_with_bound(&e, ray, ray->t_max) <= 0);
#endif
}

// Whether the crossing lies in the caller's closed interval; with OPEN_START, ahead of the moved origin.
bool within(const Ray *ray, const Meeting *meeting)
{
    const double at = scene_t(ray, meeting->t), off = scene_t_error(ray, meeting->t, meeting->error);
    if (at - off > ray->t_min && at + off < ray->t_max)
        return true;
    if (at + off < ray->t_min || at - off > ray->t_max)
        return false;
    return within_exactly(ray, meeting);
}

bool same_corners(const Corners *a, const Corners *b)
{
    for (int i = 0; i < 3; ++i)
        for (int k = 0; k < 3; ++k)
            if (a->at[i][k] != b->at[i][k])
                return false;
    return true;
}

// The sign of the difference in t.
__attribute__((noinline))
int compare_exactly(const Ray *ray, const Corners *a, const Corners *b)
{
    if (same_corners(a, b))
        return 0;
    Exact e, other;
    const int unit = min(unit_of(ray, a), unit_of(ray, b));
    set_exact(&e, ray, a, unit);
    set_exact(&other, ray, b, unit);
    return compare_t(&e, &other);
}

// Whether the meeting with triangle `id` comes before that with `other`: ties go to the lowest id.
bool before(const Ray *ray, uint id, const Meeting *meeting, uint other, const Meeting *best)
{
    if (other == NO_HIT || meeting->t + meeting->error < best->t - best->error)
        return true;
    if (meeting->t - meeting->error > best->t + best->error)
        return false;
    const int order = compare_exactly(ray, &meeting->corners, &best->corners);
    return order < 0 || (order == 0 && id < other);
}

// The t that is reported: rounding does not take it out of an interval that the exact one is in.
double reported_t(const Ray *ray, const Meeting *meeting)
{
    const double at = scene_t(ray, meeting->t);
    return at < ray->t_min ? ray->t_min : at > ray->t_max ? ray->t_max : at;
}

// Of a hit: the weights of the second and third vertex, and the error of its t if that is not null.
void describe(const Ray *ray, const Projection *s, MESH_PARAMETERS, uint id, const Meeting *meeting, real *weights,
              double *t_err)
{
    Meeting again = *meeting;
    crosses(ray, s, &again, weights);
    if (t_err)
        *t_err = scene_t_error(ray, meeting->t, meeting->error);
}

// crosses of four rays, by the filter alone.
Crossings crossings_of(const Sheared4 *p, double4 sz, long4 open)
{
    Crossings c;
    const double4 u = p->cx * p->by - p->cy * p->bx;
    const double4 v = p->ax * p->cy - p->ay * p->cx;
    const double4 w = p->bx * p->ay - p->by * p->ax;
    const double4 reach = reaches_of(p), doubt = DOUBT(reach);
    const long4 apart = signs_differ_of_4(u, v, w, doubt);
    const double4 det = (u + v) + w;
    c.u = v / det;
    c.v = w / det;
    c.t = ((u / det * p->az + c.u * p->bz) + c.v * p->cz) * sz;
    const double4 aside = SHEAR_ERROR + 12 * 0x1p-53 * (reach * reach * reach / fabs(det));
    const double4 x[3] = {p->ax, p->bx, p->cx}, y[3] = {p->ay, p->by, p->cy}, z[3] = {p->az, p->bz, p->cz};
    c.error = t_errors(x, y, z, det, c.t, sz, 0x1p-53, aside, 0x1p-46);
    c.unsure = open & ~apart & ((min(min(fabs(u), fabs(v)), fabs(w)) <= doubt) | ~(c.error <= LARGEST_T_ERROR));
    c.met = ~apart & ~c.unsure;
    return c;
}

#endif
