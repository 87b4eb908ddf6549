// Casting through a grid (Lagae & Dutre 2008) of any layout: cells in the ray's order, their lists, what the
// query asks for (triangle.h). Triangles are entered in every cell that their padded bounding box touches.
//   PARTS         the mesh is in several grids: the nearest hit so far comes in (parts.h), and bounds the walk
//   SKIP_EMPTY    rays leave empty bricks of cells unseen (leap.h)
//   COUNT_STEPS   hits tell how many cells, and empty bricks, were looked at, and how many triangles tested
#ifndef CLG_GRID_H
#define CLG_GRID_H
#include "lists.h"
#include "pending.h"
#include "walk.h"
#ifdef SKIP_EMPTY
#include "leap.h"
#endif
#ifdef NESTED
#include "descent.h"
#endif

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

// Local t that a hit's own may exceed and yet be reported as near: where t counts from afar, reported t may be equal
// though local ones are not.
double slack_of(const Ray *ray)
{
    return T_SLACK + 0x1p-51 * fabs(ray->t_entry);
}

// Before a cell's triangles are tested: which of their crossings are counted there, from its tick to the next one's.
void set_cell(const Walk *walk, long entered, long left, Hit *hit)
{
#ifdef QUERY_EACH
    hit->from = entered < 0 ? -INFINITY : t_of_tick(walk, entered);
    hit->to = t_of_tick(walk, left);
#endif
}

// After some were tested: shortens the walk. False: testing all triangles is less work than to go on.
bool go_on(const Ray *ray, __constant const GridParams *grid, const Hit *hit, Walk *walk)
{
#ifdef QUERY_ANY
    walk->stop = settled(hit) ? -1 : walk->stop;
#elif !defined(QUERY_EACH)
    // Later cells may still hold a hit whose computed t is as near (docs/numerics.md).
    if (hit->id != NO_HIT) {
        const long bound = tick_after(walk, (double)hit->meeting.t + slack_of(ray));
        walk->stop = bound < walk->stop ? bound : walk->stop;
    }
#endif
#ifdef RUNG_EXACT
    return hit->decisions <= MOST_DECISIONS(grid->triangle_count);
#else
    return true;
#endif
}

// Tests those that are pending. False: as go_on.
// Out of line: it is large, and asked for in three places of a walk, which has the registers.
__attribute__((noinline))
bool test_pending(const Ray *ray, const Projection *projection, __constant const GridParams *grid, MESH_PARAMETERS,
                  Pending *pending, Walk *walk, Hit *hit)
{
    if (pending->count == 0)
        return true;
    keep_of_8(ray, projection, MESH_ARGUMENTS, pending->ids, pending->count, hit);
    pending->count = 0;
    return go_on(ray, grid, hit, walk);
}

// Takes up the triangles of a list that the ray passes from tick `entered` to `left`; tests them when they are
// eight. False: as go_on.
bool take_list(const Ray *ray, const Projection *projection, List list, long entered, long left, GRID_PARAMETERS,
               MESH_PARAMETERS, Pending *pending, Walk *walk, Hit *hit)
{
    set_cell(walk, entered, left, hit);
    while (list.count != 0) {
        take_up(pending, take_id(&list, LIST_ARGUMENTS), faces);
        if (pending->count == 8 && !test_pending(ray, projection, grid, MESH_ARGUMENTS, pending, walk, hit))
            return false;
    }
#ifdef LIST_BY_LIST
    return test_pending(ray, projection, grid, MESH_ARGUMENTS, pending, walk, hit);
#else
    pending->idle = 0;
    return true;
#endif
}

#ifdef NESTED
// Walks from cell to cell through the top grid and its subgrids, until nothing matters any more. False: as go_on.
bool walk_nest(const Ray *ray, const Projection *projection, GRID_PARAMETERS, MESH_PARAMETERS, Walk *walk, Hit *hit)
{
    Level around[MOST_LEVELS - 1], level = top_level(walk, grid);
    Pending pending;
    start_pending(&pending);
    uint depth = 0;
    long entered = -1;
    for (;;) {
        const long due = least_tick(&level.next);
#ifdef COUNT_STEPS
        ++hit->steps;
#endif
        const List list = find_list(level.cell, grid, LIST_ARGUMENTS);
        if (list.count != 0) {
            const uint first = references[list.begin];
            if (first >= grid->first_subgrid) {
                around[depth++] = level;
                level = enter_subgrid(around + depth - 1, walk, subgrids + (first - (uint)grid->first_subgrid),
                                      max(entered, 0L));
                continue;
            }
            if (!take_list(ray, projection, list, entered, due, GRID_ARGUMENTS, MESH_ARGUMENTS, &pending, walk, hit))
                return false;
        } else if (is_due(&pending) && !test_pending(ray, projection, grid, MESH_ARGUMENTS, &pending, walk, hit)) {
            return false;
        }
        if (due >= walk->stop)
            return test_pending(ray, projection, grid, MESH_ARGUMENTS, &pending, walk, hit);
        entered = due;
        while (due >= level.left)
            level = around[--depth];
        level.cell += (uint)step_over(&level.next, &level.pace, (long)(int)level.x, (long)(int)level.y,
                                      (long)(int)level.z);
    }
}
#else
// Walks from cell to cell, from tick `entered` until `end` or nothing matters any more. False: as go_on.
bool walk_cells(const Ray *ray, const Projection *projection, uint cell, Ticks ahead, long entered, long end,
                GRID_PARAMETERS, MESH_PARAMETERS, Pending *pending, Walk *walk, Hit *hit)
{
    const long row = grid->resolution[0], layer = row * grid->resolution[1];
    const long x = walk->up_x ? 1 : -1, y = walk->up_y ? row : -row, z = walk->up_z ? layer : -layer;
    for (;;) {
        const long due = least_tick(&ahead);
#ifdef COUNT_STEPS
        ++hit->steps;
#endif
        const List list = find_list(cell, grid, LIST_ARGUMENTS);
        if (list.count != 0) {
            if (!take_list(ray, projection, list, entered, due, GRID_ARGUMENTS, MESH_ARGUMENTS, pending, walk, hit))
                return false;
        } else if (is_due(pending) && !test_pending(ray, projection, grid, MESH_ARGUMENTS, pending, walk, hit)) {
            return false;
        }
        if (due >= end || due >= walk->stop)
            return true;
        entered = due;
        cell += (uint)step_over(&ahead, &walk->pace, x, y, z);
    }
}
#endif

uint first_cell(const Walk *walk, __constant const GridParams *grid)
{
    return ((uint)walk->cell.z * grid->resolution[1] + (uint)walk->cell.y) * grid->resolution[0] + (uint)walk->cell.x;
}

// Walks the grid for `hit`: no_hit(), or bound_of() the nearest so far: what is not nearer than that is no
// hit. The answer is, bit for bit, that of testing every triangle (docs/numerics.md, "Lossless grid"). False: that
// had better be done.
bool walk_grid(const Ray *ray, const Projection *projection, GRID_PARAMETERS, MESH_PARAMETERS, Walk *walk, Hit *hit)
{
#if defined(NESTED)
    return walk_nest(ray, projection, GRID_ARGUMENTS, MESH_ARGUMENTS, walk, hit);
#elif defined(SKIP_EMPTY)
    Bricks bricks = bricks_of(walk, grid);
    Pending pending;
    start_pending(&pending);
    long entered = -1;
    for (;;) {
        const long due = least_tick(&bricks.next);
        const uint distance = distances[brick_number(&bricks)];
        if (distance == 0) {
            Ticks ahead;
            const uint cell = enter_brick(&bricks, walk, grid, max(entered, 0L), &ahead);
            if (!walk_cells(ray, projection, cell, ahead, entered, due, GRID_ARGUMENTS, MESH_ARGUMENTS, &pending, walk,
                            hit))
                return false;
            leave_brick(&bricks, walk);
            entered = due;
        } else {
#ifdef COUNT_STEPS
            ++hit->steps;
#endif
            if (!test_pending(ray, projection, grid, MESH_ARGUMENTS, &pending, walk, hit))
                return false;
            entered = leave_empty(&bricks, walk, distance, due);
        }
        if (entered >= walk->stop)
            return test_pending(ray, projection, grid, MESH_ARGUMENTS, &pending, walk, hit);
    }
#else
    Pending pending;
    start_pending(&pending);
    return walk_cells(ray, projection, first_cell(walk, grid), walk->next, -1, walk->stop, GRID_ARGUMENTS,
                      MESH_ARGUMENTS, &pending, walk, hit)
           && test_pending(ray, projection, grid, MESH_ARGUMENTS, &pending, walk, hit);
#endif
}

// What the query asks for of the triangles that the ray meets on a walk, but for what describe_hit adds.
Hit traverse(const Ray *ray, Walk *walk, Hit hit, GRID_PARAMETERS, MESH_PARAMETERS)
{
    const Projection projection = projection_of(ray);
#ifdef RUNG_EXACT
    if (ray->astray || !walk_grid(ray, &projection, GRID_ARGUMENTS, MESH_ARGUMENTS, walk, &hit))
        test_all(ray, &projection, grid, MESH_ARGUMENTS, &hit);
#else
    walk_grid(ray, &projection, GRID_ARGUMENTS, MESH_ARGUMENTS, walk, &hit);
#endif
    return hit;
}

#endif
