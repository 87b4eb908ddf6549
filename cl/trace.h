// What a traced ray writes down (trace_ray.cl): records one after another, of words of 64 bits.
//   of each   its stage + 2^32 * its number of values, the cell or triangle that it is of, then the values as bits
// clgrid/locate/stages.py names them.
#ifndef CLG_TRACE_H
#define CLG_TRACE_H
#include "grid.h"
#include "entries.h"

#define STAGE_RAY 1u
#define STAGE_SHEAR 2u
#define STAGE_WIDE_SHEAR 3u
#define STAGE_BOUNDS 4u
#define STAGE_ENTRY 5u
#define STAGE_CELL 6u
#define STAGE_TRIANGLE 7u
#define STAGE_FINISH 8u
#define STAGE_KEPT 9u
#define STAGE_STOP 10u
#define STAGE_ALL 11u
#define STAGE_HIT 12u
#define STAGE_START 13u

typedef struct {
    __global ulong *words;
    uint room, used;  // beyond `room` nothing is written
} Trace;

void put(Trace *trace, ulong word)
{
    if (trace->used < trace->room)
        trace->words[trace->used] = word;
    ++trace->used;
}

void begin_record(Trace *trace, uint stage, uint values, ulong item)
{
    put(trace, (ulong)values << 32 | stage);
    put(trace, item);
}

void put_float(Trace *trace, float value)
{
    put(trace, as_uint(value));
}

void put_double(Trace *trace, double value)
{
    put(trace, as_ulong(value));
}

void put_real(Trace *trace, real value)
{
#ifdef WIDE_RAYS
    put_double(trace, value);
#else
    put_float(trace, value);
#endif
}

void put_ticks(Trace *trace, const Ticks *ticks)
{
    put(trace, (ulong)ticks->x);
    put(trace, (ulong)ticks->y);
    put(trace, (ulong)ticks->z);
}

void trace_ray_itself(Trace *trace, const Ray *ray)
{
    begin_record(trace, STAGE_RAY, 2, 0);
    put(trace, ray->valid);
    put(trace, ray->reaches);
#ifdef RUNG_EXACT
    const bool starts = ray->reaches && !ray->astray;
#else
    const bool starts = ray->reaches;
#endif
    if (!starts)
        return;
    begin_record(trace, STAGE_START, 8, 0);
    put_double(trace, ray->t_unit);
    for (int a = 0; a < 3; ++a)
        put_real(trace, ray->direction[a]);
    put_double(trace, ray->t_entry);
    for (int a = 0; a < 3; ++a)
        put_real(trace, ray->origin[a]);
}

void trace_projection(Trace *trace, const Projection *projection)
{
#ifdef WIDE_RAYS
    const Shear *s = &projection->narrow;
#else
    const Shear *s = projection;
#endif
    begin_record(trace, STAGE_SHEAR, 9, 0);
    put(trace, (ulong)s->kx);
    put(trace, (ulong)s->ky);
    put(trace, (ulong)s->kz);
    put_float(trace, s->ox);
    put_float(trace, s->oy);
    put_float(trace, s->oz);
    put_float(trace, s->sx);
    put_float(trace, s->sy);
    put_float(trace, s->sz);
#ifdef WIDE_RAYS
    begin_record(trace, STAGE_WIDE_SHEAR, 6, 0);
    put_double(trace, projection->ox);
    put_double(trace, projection->oy);
    put_double(trace, projection->oz);
    put_double(trace, projection->sx);
    put_double(trace, projection->sy);
    put_double(trace, projection->sz);
#endif
}

void trace_entry(Trace *trace, const Walk *walk)
{
    begin_record(trace, STAGE_ENTRY, 11, 0);
    put_double(trace, walk->t_in);
    put(trace, (ulong)walk->cell.x);
    put(trace, (ulong)walk->cell.y);
    put(trace, (ulong)walk->cell.z);
    put_ticks(trace, &walk->next);
    put_ticks(trace, &walk->pace);
    put(trace, (ulong)walk->stop);
}

// What finish_hit makes of edge functions that do not rule the triangle out, or crosses of the triangle.
void trace_finish(Trace *trace, const Ray *ray, const Projection *projection, MESH_PARAMETERS, uint id,
                  const Sheared *p, const real *edges)
{
#ifdef RUNG_EXACT
    Meeting meeting;
    real weights[2] = {0, 0};
    meeting.t = meeting.error = 0.0;
    meeting.corners = corners_of(id, MESH_ARGUMENTS);
    const bool met = crosses(ray, projection, &meeting, weights);
    begin_record(trace, STAGE_FINISH, 6, id);
    put(trace, meeting.certain);
    put(trace, met);
    put_double(trace, met ? weights[0] : 0.0);
    put_double(trace, met ? weights[1] : 0.0);
    put_double(trace, met ? meeting.t : 0.0);
    put_double(trace, met ? meeting.error : 0.0);
#else
    if ((edges[0] < 0 || edges[1] < 0 || edges[2] < 0) && (edges[0] > 0 || edges[1] > 0 || edges[2] > 0))
        return;
    real t = 0;
    double weights[3] = {0.0, 0.0, 0.0};
    const bool met = finish_hit(projection, p, edges[0], edges[1], edges[2], &t, weights);
    begin_record(trace, STAGE_FINISH, 5, id);
    put(trace, met);
    put_double(trace, met ? weights[2] : 0.0);
    put_double(trace, met ? weights[0] : 0.0);
    put_double(trace, met ? weights[1] : 0.0);
    put_real(trace, met ? t : 0);
#endif
}

void trace_triangle(Trace *trace, const Ray *ray, const Projection *projection, MESH_PARAMETERS, uint id, int open)
{
#ifdef WIDE_RAYS
    const Corners corners = corners_of(id, MESH_ARGUMENTS);
    const Sheared p = shear_triangle(projection, &corners);
#else
    const Sheared p = shear_triangle(projection, vertices, faces + 3 * (size_t)id);
#endif
    real edges[3];
    edge_functions(&p, edges);
    begin_record(trace, STAGE_TRIANGLE, 13, id);
    put_real(trace, p.az);
    put_real(trace, p.bz);
    put_real(trace, p.cz);
    put_real(trace, p.ax);
    put_real(trace, p.ay);
    put_real(trace, p.bx);
    put_real(trace, p.by);
    put_real(trace, p.cx);
    put_real(trace, p.cy);
    for (int i = 0; i < 3; ++i)
        put_real(trace, edges[i]);
    put(trace, open != 0);
    if (open)
        trace_finish(trace, ray, projection, MESH_ARGUMENTS, id, &p, edges);
}

// keep, and what it kept.
void trace_keep(Trace *trace, const Ray *ray, const Projection *projection, MESH_PARAMETERS, uint id, Hit *hit)
{
    keep(ray, projection, MESH_ARGUMENTS, id, hit);
    begin_record(trace, STAGE_KEPT, 3, id);
    put(trace, hit->id == id);
    put_real(trace, hit->id == NO_HIT ? (real)INFINITY : hit->meeting.t);
    put_double(trace, hit->id == NO_HIT ? INFINITY : reported_t(ray, &hit->meeting));
}

// The list of a cell that the ray passes from tick `entered` to `due`, tested by itself. False: as go_on.
bool trace_list(Trace *trace, const Ray *ray, const Projection *projection, List list, long entered, long due,
                GRID_PARAMETERS, MESH_PARAMETERS, Walk *walk, Hit *hit)
{
    set_cell(walk, entered, due, hit);
    while (list.count != 0) {
        uint ids[8], count = 0;
        int lanes[8];
        while (count < 8 && list.count != 0)
            ids[count++] = take_id(&list, LIST_ARGUMENTS);
        for (uint i = count; i < 8; ++i)
            ids[i] = ids[count - 1];
        const Corners8 corners = gather_corners(vertices, faces, ids, count);
        vstore8(candidates_of(projection, &corners), 0, lanes);
        for (uint i = 0; i < count; ++i) {
            trace_triangle(trace, ray, projection, MESH_ARGUMENTS, ids[i], lanes[i]);
            if (lanes[i])
                trace_keep(trace, ray, projection, MESH_ARGUMENTS, ids[i], hit);
        }
    }
    const bool more = go_on(ray, grid, hit, walk);
    begin_record(trace, STAGE_STOP, 2, 0);
    put(trace, (ulong)walk->stop);
    put(trace, more);
    return more;
}

#endif
