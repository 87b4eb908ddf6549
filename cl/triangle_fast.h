// Rung `fast`: Moeller & Trumbore 1997 in float32. It promises nothing; a ray may pass between triangles that
// share an edge, seldom for want of OUTSIDE. Rays of a bundle take the same test in another form (bundle_fast.h).
#ifndef CLG_TRIANGLE_FAST_H
#define CLG_TRIANGLE_FAST_H
#include "gather.h"
#include "meeting.h"
#include "ray.h"

// How far outside, in barycentric weights, still hits: rays through a shared edge then seldom miss both sides.
#define OUTSIDE 0x1p-19f

typedef struct {
    float ox, oy, oz, dx, dy, dz;
} Projection;

Projection projection_of(const Ray *ray)
{
    const Projection line = {ray->origin[0], ray->origin[1], ray->origin[2],
                             ray->direction[0], ray->direction[1], ray->direction[2]};
    return line;
}

// t and the weights of the second and third vertex, for eight triangles: where the planes are met.
typedef struct {
    float8 t, u, v;
} Meetings;

Meetings meet_planes(const Projection *line, Points a, Points b, Points c)
{
    const float8 ex = b.x - a.x, ey = b.y - a.y, ez = b.z - a.z;
    const float8 fx = c.x - a.x, fy = c.y - a.y, fz = c.z - a.z;
    const float8 sx = line->ox - a.x, sy = line->oy - a.y, sz = line->oz - a.z;
    const float dx = line->dx, dy = line->dy, dz = line->dz;
    const float8 px = dy * fz - dz * fy, py = dz * fx - dx * fz, pz = dx * fy - dy * fx;
    const float8 qx = sy * ez - sz * ey, qy = sz * ex - sx * ez, qz = sx * ey - sy * ex;
    const float8 inverse = 1.0f / (ex * px + ey * py + ez * pz);
    Meetings m;
    m.u = (sx * px + sy * py + sz * pz) * inverse;
    m.v = (dx * qx + dy * qy + dz * qz) * inverse;
    m.t = (fx * qx + fy * qy + fz * qz) * inverse;
    return m;
}

int8 are_inside(float8 u, float8 v)
{
    return (u >= -OUTSIDE) & (v >= -OUTSIDE) & (u + v <= 1.0f + OUTSIDE);
}

int8 candidates_of(const Projection *line, const Corners8 *p)
{
    const Meetings m = meet_planes(line, p->a, p->b, p->c);
    return are_inside(m.u, m.v);
}

Points points_of_soup(__global const float *corner, size_t n)
{
    const Points p = {vload8(0, corner), vload8(0, corner + n), vload8(0, corner + 2 * n)};
    return p;
}

int8 candidates_of_soup(const Projection *line, __global const float *corner, size_t n)
{
    const Corners8 corners = {points_of_soup(corner, n), points_of_soup(corner + 3 * n, n),
                              points_of_soup(corner + 6 * n, n)};
    return candidates_of(line, &corners);
}

// A triangle alone, by the same operations.
Meetings meet_one(const Projection *line, MESH_PARAMETERS, uint id)
{
    const Corners8 p = gather_corners(vertices, faces, &id, 1);
    return meet_planes(line, p.a, p.b, p.c);
}

bool meet(const Ray *ray, const Projection *line, MESH_PARAMETERS, uint id, Meeting *meeting)
{
    const Meetings m = meet_one(line, MESH_ARGUMENTS, id);
    meeting->t = m.t.s0;
    return are_inside(m.u, m.v).s0 != 0 && isfinite(m.t.s0);
}

// The weights of the second and third vertex; this rung knows no error of t.
void describe(const Ray *ray, const Projection *line, MESH_PARAMETERS, uint id, const Meeting *meeting, real *weights,
              double *t_err)
{
    const Meetings m = meet_one(line, MESH_ARGUMENTS, id);
    weights[0] = m.u.s0;
    weights[1] = m.v.s0;
}

#endif
