// Casting through a grid (Lagae & Dutre 2008) of any layout: cells in the ray's order, their lists, what the
// query asks for (triangle.h). Triangles are entered in every cell that their padded bounding box touches.
//   PARTS         the mesh is in several grids: the nearest hit so far comes in (parts.h), and bounds the walk
//   SKIP_EMPTY    rays leave empty bricks of cells unseen (leap.h)
//   COUNT_STEPS   hits tell how many cells, and empty bricks, were looked at, and how many triangles tested
#ifndef CLG_GRID_H
#define CLG_GRID_H
#include "lists.h"
#include "triangle.h"
#include "walk.h"
#ifdef SKIP_EMPTY
#include "leap.h"
#endif

// One step of the walk. False: the ray is out of the grid, or past `stop`. With SKIP_EMPTY it tells whether
// the step led into another brick.
bool walk_on(Axis *axis, int resolution, double stop, uint *cell, bool *entered)
{
    const bool inside = axis->t_next <= stop && step(axis, cell);
#ifdef SKIP_EMPTY
    *entered = enters_brick(axis, resolution);
#endif
    return inside;
}

#ifdef RUNG_EXACT
// Tests every triangle: for a ray that the walk cannot follow, or that lies in so many triangles, each in so many
// cells, that this is less work.
void test_all(const Ray *ray, const Projection *projection, __constant const GridParams *grid, MESH_PARAMETERS,
              Hit *hit)
{
#ifdef QUERY_EACH
    hit->count = 0;
    hit->from = -INFINITY;
    hit->to = INFINITY;
#endif
    for (uint id = 0; id < grid->triangle_count && !settled(hit); ++id)
        keep(ray, projection, MESH_ARGUMENTS, id, hit);
}
#endif

// Walks the grid for `hit`: no_hit(), or bound_of() the nearest so far: what is not nearer than that is no
// hit. The answer is, bit for bit, that of testing every triangle (docs/numerics.md, "Lossless grid"). False: that
// had better be done.
bool walk(const Ray *ray, const Projection *projection, GRID_PARAMETERS, MESH_PARAMETERS, Hit *hit)
{
    Axis x, y, z;
    double t_in = first_t(ray), t_out = last_t(ray);
    const double ox = ray->origin[0], oy = ray->origin[1], oz = ray->origin[2];
    const double dx = climb_rate(ray->direction[0]), dy = climb_rate(ray->direction[1]);
    const double dz = climb_rate(ray->direction[2]);
    const int mx = (int)grid->resolution[0], my = (int)grid->resolution[1], mz = (int)grid->resolution[2];
    if (!enter_slab(&x, ox, dx, grid->lower[0], grid->upper[0], grid->cell_size[0], mx, &t_in, &t_out)
        || !enter_slab(&y, oy, dy, grid->lower[1], grid->upper[1], grid->cell_size[1], my, &t_in, &t_out)
        || !enter_slab(&z, oz, dz, grid->lower[2], grid->upper[2], grid->cell_size[2], mz, &t_in, &t_out)
        || t_in > t_out)
        return true;

    const int ix = start_cell(&x, ox, dx, grid->lower[0], grid->cell_size[0], mx, t_in);
    const int iy = start_cell(&y, oy, dy, grid->lower[1], grid->cell_size[1], my, t_in);
    const int iz = start_cell(&z, oz, dz, grid->lower[2], grid->cell_size[2], mz, t_in);
    uint cell = ((uint)iz * (uint)my + (uint)iy) * (uint)mx + (uint)ix;
    x.stride = dx < 0.0 ? -1 : 1;
    y.stride = dy < 0.0 ? -mx : mx;
    z.stride = dz < 0.0 ? -mx * my : mx * my;

    double stop = t_out;  // no hit beyond it can win
    // Where t counts from afar, reported t may be equal though local ones are not.
    const double slack = T_SLACK + 0x1p-51 * fabs(ray->t_entry);
#ifdef PARTS
    stop = fmin(stop, (double)hit->meeting.t + slack);
#endif
    bool entered = true, full = true;  // the cell's brick was just entered; may hold references
#ifdef QUERY_EACH
    double crossed = -INFINITY;  // where the ray entered the cell
#endif
    for (;;) {
#ifdef COUNT_STEPS
        hit->steps += entered || full ? 1 : 0;
#endif
#ifdef SKIP_EMPTY
        if (entered) {
            const int distance = brick_distance(grid, distances, &x, &y, &z);
            full = distance == 0;
            if (distance > 1) {
                double left_at;
                if (!leap(grid, ray, distance, stop, &x, &y, &z, &cell, &left_at))
                    break;
#ifdef QUERY_EACH
                crossed = left_at;
#endif
                continue;
            }
        }
#endif
#ifdef QUERY_EACH
        const double leaves = fmin(fmin(x.t_next, y.t_next), z.t_next);
#endif
        List list = {0, 0};
        if (full)
            list = find_list(cell, grid, LIST_ARGUMENTS);
        if (list.count != 0) {
#ifdef QUERY_EACH
            hit->from = crossed;
            hit->to = leaves;
#endif
            while (list.count != 0) {
                uint ids[8];
                const uint count = take_ids(&list, LIST_ARGUMENTS, ids);
                keep_of_8(ray, projection, MESH_ARGUMENTS, ids, count, hit);
            }
            if (settled(hit))
                break;
#ifdef RUNG_EXACT
            if (hit->decisions > MOST_DECISIONS(grid->triangle_count))
                return false;
#endif
#ifndef QUERY_EACH
            // Later cells may still hold a hit whose computed t is as near (docs/numerics.md).
            const double bound = (double)hit->meeting.t + slack;
            stop = bound < stop ? bound : stop;
#endif
        }
        bool inside;
#ifdef QUERY_EACH
        crossed = leaves;
#endif
        if (x.t_next < y.t_next ? x.t_next < z.t_next : false)
            inside = walk_on(&x, mx, stop, &cell, &entered);
        else if (y.t_next < z.t_next)
            inside = walk_on(&y, my, stop, &cell, &entered);
        else
            inside = walk_on(&z, mz, stop, &cell, &entered);
        if (!inside)
            break;
    }
    return true;
}

// What the query asks for of the triangles that the ray meets.
Hit traverse(const Ray *ray, Hit hit, GRID_PARAMETERS, MESH_PARAMETERS)
{
    if (!ray->reaches)
        return hit;
    const Projection projection = projection_of(ray);
#ifdef RUNG_EXACT
    if (ray->astray || !walk(ray, &projection, GRID_ARGUMENTS, MESH_ARGUMENTS, &hit))
        test_all(ray, &projection, grid, MESH_ARGUMENTS, &hit);
#else
    walk(ray, &projection, GRID_ARGUMENTS, MESH_ARGUMENTS, &hit);
#endif
    describe_hit(ray, &projection, MESH_ARGUMENTS, &hit);
    return hit;
}

#endif
