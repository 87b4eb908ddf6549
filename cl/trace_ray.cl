// One ray through a grid, with all that is computed on its way written down (trace.h): set-up, projection, entry,
// cells, triangles, hit. The functions are those of the kernels that cast, called step by step.
//   words[room]   the records
//   used          words that they take; if more than there is room for, the rest is lost
#include "trace.h"
#include "rays_in_out.h"

void trace_cell(Trace *trace, uint cell, long entered, long due, const List *list)
{
    begin_record(trace, STAGE_CELL, 3, cell);
    put(trace, (ulong)entered);
    put(trace, (ulong)due);
    put(trace, list->count);
}

#ifdef NESTED
// As walk_nest.
bool trace_walk(Trace *trace, const Ray *ray, const Projection *projection, GRID_PARAMETERS, MESH_PARAMETERS,
                Walk *walk, Hit *hit)
{
    Level around[MOST_LEVELS - 1], level = top_level(walk, grid);
    uint depth = 0;
    long entered = -1;
    for (;;) {
        const long due = least_tick(&level.next);
        const List list = find_list(level.cell, grid, LIST_ARGUMENTS);
        trace_cell(trace, level.cell, entered, due, &list);
        if (list.count != 0) {
            const uint first = references[list.begin];
            if (first >= grid->first_subgrid) {
                around[depth++] = level;
                level = enter_subgrid(around + depth - 1, walk, subgrids + (first - (uint)grid->first_subgrid),
                                      max(entered, 0L));
                continue;
            }
            if (!trace_list(trace, ray, projection, list, entered, due, GRID_ARGUMENTS, MESH_ARGUMENTS, walk, hit))
                return false;
        }
        if (due >= walk->stop)
            return true;
        entered = due;
        while (due >= level.left)
            level = around[--depth];
        level.cell += (uint)step_over(&level.next, &level.pace, (long)(int)level.x, (long)(int)level.y,
                                      (long)(int)level.z);
    }
}
#else
// As walk_cells; what is leapt over with SKIP_EMPTY has no lists.
bool trace_walk(Trace *trace, const Ray *ray, const Projection *projection, GRID_PARAMETERS, MESH_PARAMETERS,
                Walk *walk, Hit *hit)
{
    const long row = grid->resolution[0], layer = row * grid->resolution[1];
    const long x = walk->up_x ? 1 : -1, y = walk->up_y ? row : -row, z = walk->up_z ? layer : -layer;
    Ticks ahead = walk->next;
    uint cell = first_cell(walk, grid);
    long entered = -1;
    for (;;) {
        const long due = least_tick(&ahead);
        const List list = find_list(cell, grid, LIST_ARGUMENTS);
        trace_cell(trace, cell, entered, due, &list);
        if (list.count != 0
            && !trace_list(trace, ray, projection, list, entered, due, GRID_ARGUMENTS, MESH_ARGUMENTS, walk, hit))
            return false;
        if (due >= walk->stop)
            return true;
        entered = due;
        cell += (uint)step_over(&ahead, &walk->pace, x, y, z);
    }
}
#endif

// As begin_walk, then the walk. False: all triangles are to be tested.
bool trace_grid(Trace *trace, const Ray *ray, const Projection *projection, GRID_PARAMETERS, MESH_PARAMETERS,
                Hit *hit)
{
    Walk walk;
    const double first = first_t(ray), last = last_t(ray);
    const bool enters = enter_grid(ray, grid, first, last, &walk);
    begin_record(trace, STAGE_BOUNDS, 3, 0);
    put_double(trace, first);
    put_double(trace, last);
    put(trace, enters);
    if (!enters)
        return true;
    trace_entry(trace, &walk);
    return trace_walk(trace, ray, projection, GRID_ARGUMENTS, MESH_ARGUMENTS, &walk, hit);
}

// As traverse.
Hit trace_traverse(Trace *trace, const Ray *ray, GRID_PARAMETERS, MESH_PARAMETERS)
{
    Hit hit = no_hit();
    if (!ray->reaches)
        return hit;
    const Projection projection = projection_of(ray);
    trace_projection(trace, &projection);
#ifdef RUNG_EXACT
    if (ray->astray
        || !trace_grid(trace, ray, &projection, GRID_ARGUMENTS, MESH_ARGUMENTS, &hit)) {
        test_all(ray, &projection, grid, MESH_ARGUMENTS, &hit);
        begin_record(trace, STAGE_ALL, 1, 0);
        put(trace, hit.id);
    }
#else
    trace_grid(trace, ray, &projection, GRID_ARGUMENTS, MESH_ARGUMENTS, &hit);
#endif
    describe_hit(ray, &projection, MESH_ARGUMENTS, &hit);
    return hit;
}

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void trace_ray(__constant const FrameParams *frame, GRID_PARAMETERS, MESH_PARAMETERS, RAY_PARAMETERS,
                        __global ulong *words, uint room, __global uint *used)
{
    Trace trace;
    trace.words = words;
    trace.room = room;
    trace.used = 0;
    const Ray ray = load_ray(0, frame, RAY_ARGUMENTS);
    trace_ray_itself(&trace, &ray);
    const Hit hit = trace_traverse(&trace, &ray, GRID_ARGUMENTS, MESH_ARGUMENTS);
    const bool missed = hit.id == NO_HIT;
    begin_record(&trace, STAGE_HIT, 5, 0);
    put(&trace, hit.id);
    put_double(&trace, missed ? INFINITY : reported_t(&ray, &hit.meeting));
    put_real(&trace, hit.u);
    put_real(&trace, hit.v);
    put_double(&trace, missed ? 0.0 : hit.t_err);
    used[0] = trace.used;
}
