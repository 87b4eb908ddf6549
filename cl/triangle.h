// What rays keep of the triangles that they meet, for any rung of the accuracy ladder and any query.
//   (none)        the nearest: least t, then least id
//   QUERY_ANY     whether there is one
//   QUERY_COUNT   how many there are
//   QUERY_ALL     each, in the order of cells
//   COUNT_STEPS   and how many cells, triangles and batches of triangles were looked at
//   WITH_UVS, WITH_T_ERR, WITH_CERTAIN   of the nearest or of all: weights, the error of t, who decided
#ifndef CLG_TRIANGLE_H
#define CLG_TRIANGLE_H
#include "lanes.h"
#if defined(RUNG_FAST)
#include "triangle_fast.h"
#elif defined(RUNG_PRECISE)
#include "triangle_precise.h"
#elif defined(RUNG_EXACT)
#include "triangle_exact.h"
#else
#include "triangle_robust.h"
#endif

#if defined(QUERY_COUNT) || defined(QUERY_ALL)
#define QUERY_EACH
#endif
#ifdef QUERY_ALL
#include "records.h"
#endif

typedef struct {
    Meeting meeting;  // of the nearest
    uint id;          // NO_HIT on a miss
    real u, v;        // barycentric weights of the second and third vertex
    double t_err;     // of the reported t
#ifdef QUERY_EACH
    uint count;       // of the triangles met
    double from, to;  // only those with from <= t < to are counted: those of the cell that holds t
#endif
#ifdef QUERY_ALL
    Records records;
#endif
#ifdef RUNG_EXACT
    uint decisions;   // by integers
#endif
#ifdef COUNT_STEPS
    uint steps;       // cells looked at
    uint tests;       // triangles tested
    uint batches;     // of up to eight triangles, each tested at once
#endif
} Hit;

Hit no_hit(void)
{
    Hit miss;
    miss.meeting.t = INFINITY;
    miss.id = NO_HIT;
    miss.u = miss.v = 0;
    miss.t_err = 0.0;
#ifdef QUERY_EACH
    miss.count = 0;
    miss.from = -INFINITY;
    miss.to = INFINITY;
#endif
#ifdef RUNG_EXACT
    miss.meeting.error = 0.0;
    miss.meeting.certain = true;
    miss.decisions = 0;
#endif
#ifdef COUNT_STEPS
    miss.steps = miss.tests = miss.batches = 0;
#endif
    return miss;
}

// Whether no further triangle matters.
bool settled(const Hit *hit)
{
#ifdef QUERY_ANY
    return hit->id != NO_HIT;
#else
    return false;
#endif
}

// Tests triangle `id`, and keeps what the query asks for.
// Rare and large: kept out of line, it leaves the walk its registers.
__attribute__((noinline))
void keep(const Ray *ray, const Projection *projection, MESH_PARAMETERS, uint id, Hit *hit)
{
    Meeting meeting;
    if (settled(hit))
        return;
    const bool met = meet(ray, projection, MESH_ARGUMENTS, id, &meeting);
#ifdef RUNG_EXACT
    hit->decisions += meeting.certain ? 0u : 1u;
#endif
    if (!met)
        return;
#ifdef QUERY_EACH
    const double t = meeting.t;
    if (!(t >= hit->from && (t < hit->to || hit->to == INFINITY)) || !within(ray, &meeting))
        return;
#ifdef QUERY_ALL
    record(&hit->records, ray, projection, MESH_ARGUMENTS, id, &meeting, hit->count);
#endif
    ++hit->count;
#elif defined(QUERY_ANY)
    if (within(ray, &meeting))
        hit->id = id;
#else
    if (before(ray, id, &meeting, hit->id, &hit->meeting) && within(ray, &meeting)) {
        hit->meeting = meeting;
        hit->id = id;
    }
#endif
}

// keep over 1 to 8 triangles.
void keep_of_8(const Ray *ray, const Projection *projection, MESH_PARAMETERS, const uint *ids, uint count, Hit *hit)
{
#ifdef COUNT_STEPS
    hit->tests += count;
    ++hit->batches;
#endif
    const Corners8 corners = gather_corners(vertices, faces, ids, count);
    uint open = bits_of(candidates_of(projection, &corners)) & (0xFFu >> (8 - count));
    for (; open != 0; open &= open - 1)
        keep(ray, projection, MESH_ARGUMENTS, ids[lowest_of_32(open)], hit);
}

// What else is asked for of the nearest hit.
void describe_hit(const Ray *ray, const Projection *projection, MESH_PARAMETERS, Hit *hit)
{
#if defined(WITH_UVS) || defined(WITH_T_ERR)
    if (hit->id == NO_HIT)
        return;
    real weights[2] = {0, 0};
#ifdef WITH_T_ERR
    describe(ray, projection, MESH_ARGUMENTS, hit->id, &hit->meeting, weights, &hit->t_err);
#else
    describe(ray, projection, MESH_ARGUMENTS, hit->id, &hit->meeting, weights, 0);
#endif
    hit->u = weights[0];
    hit->v = weights[1];
#endif
}

#endif
