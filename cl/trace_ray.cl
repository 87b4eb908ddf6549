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

// As cast_alone, of the tile's first ray. False: all triangles are to be tested.
bool trace_grid(Trace *trace, const Tile *tile, const Ray *ray, const Projection *projection, GRID_PARAMETERS,
                MESH_PARAMETERS, Hit *hit)
{
    Entries entries;
    entries.first = TILE_RAYS;
    const bool enter = enters(tile, 0, grid, &entries);
    begin_record(trace, STAGE_BOUNDS, 3, 0);
    put_double(trace, first_t(tile, 0).x);
    put_double(trace, last_t(tile, 0).x);
    put(trace, enter);
    if (!enter)
        return true;
    Walk walk = walk_of(&entries, 0);
    trace_entry(trace, &walk);
    return trace_walk(trace, ray, projection, GRID_ARGUMENTS, MESH_ARGUMENTS, &walk, hit);
}

// As traverse.
Hit trace_traverse(Trace *trace, const Tile *tile, const Ray *ray, GRID_PARAMETERS, MESH_PARAMETERS)
{
    Hit hit = no_hit();
    if (!ray->reaches)
        return hit;
    const Projection projection = projection_of(ray);
    trace_projection(trace, &projection);
#ifdef RUNG_EXACT
    if (ray->astray
        || !trace_grid(trace, tile, ray, &projection, GRID_ARGUMENTS, MESH_ARGUMENTS, &hit)) {
        test_all(ray, &projection, grid, MESH_ARGUMENTS, &hit);
        begin_record(trace, STAGE_ALL, 1, 0);
        put(trace, hit.id);
    }
#else
    trace_grid(trace, tile, ray, &projection, GRID_ARGUMENTS, MESH_ARGUMENTS, &hit);
#endif
    describe_hit(ray, &projection, MESH_ARGUMENTS, &hit);
    return hit;
}

// Rays are set up four at a time.
void set_ray_four_times(Tile *tile, __constant const FrameParams *frame, RAY_PARAMETERS)
{
    double o[3][4], d[3][4], t_min[4], t_max[4];
    for (int a = 0; a < 3; ++a) {
        vstore4((double4)(origins[a]), 0, o[a]);
        vstore4((double4)(directions[a]), 0, d[a]);
    }
    vstore4((double4)(T_BOUNDS(0)[0]), 0, t_min);
    vstore4((double4)(T_BOUNDS(0)[1]), 0, t_max);
    set_rays(tile, 0, o, d, t_min, t_max, frame);
}

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void trace_ray(__constant const FrameParams *frame, GRID_PARAMETERS, MESH_PARAMETERS, RAY_PARAMETERS,
                        __global ulong *words, uint room, __global uint *used)
{
    Trace trace;
    trace.words = words;
    trace.room = room;
    trace.used = 0;
    Tile tile;
    start_tile(&tile, frame, grid);
    set_ray_four_times(&tile, frame, RAY_ARGUMENTS);
    const Ray ray = ray_of(&tile, 0);
    trace_ray_itself(&trace, &ray);
    const Hit hit = trace_traverse(&trace, &tile, &ray, GRID_ARGUMENTS, MESH_ARGUMENTS);
    const bool missed = hit.id == NO_HIT;
    begin_record(&trace, STAGE_HIT, 5, 0);
    put(&trace, hit.id);
    put_double(&trace, missed ? INFINITY : reported_t(&ray, &hit.meeting));
    put_real(&trace, hit.u);
    put_real(&trace, hit.v);
    put_double(&trace, missed ? 0.0 : hit.t_err);
    used[0] = trace.used;
}
