// Rays of a work-item walk the grid in turns, so that each waits for memory while the others work: what a
// turn reads was asked for by the step before it. Rays without order would do little but wait. The cells that
// a ray looks at and the triangles that it tests are those of walk_grid.
//   HERD    rays under way at once: IN_TURNS
//   PATH    cells whose lists are asked for at once
#ifndef CLG_HERD_H
#define CLG_HERD_H
#include "grid.h"

#define HERD IN_TURNS
#ifdef SKIP_EMPTY
#define PATH (3 * BRICK - 2)  // cells of a brick that a line meets
#else
#define PATH 8
#endif

typedef struct {
    Ray ray;
    Projection projection;
    Hit hit;
    Walk walk;
    uint number;               // the ray's, for the kernel
    bool over;                 // nothing is left to look at
    bool given_up;             // testing all triangles is less work
    long entered;              // tick from which no path is known
#ifdef SKIP_EMPTY
    Bricks bricks;             // there
#else
    Ticks next;
    uint cell;
#endif
    uint cells[PATH];          // the next ones on the way
    long ticks[PATH + 1];      // when each is entered, and the last left
    uint at, end;              // what is left of them
    List list;                 // what is left of the list of cell `at` - 1
    Pending pending;           // of the lists so far
    bool tests;                // in this turn
} Walker;

// Sets out on ray `number`, which enters the grid or is astray, with the hit that is given.
void set_out(Walker *w, uint number, const Ray *ray, const Walk *walk, Hit hit, __constant const GridParams *grid)
{
    w->number = number;
    w->ray = *ray;
    w->hit = hit;
    w->over = false;
    w->given_up = false;
    w->list.count = 0;
    w->at = w->end = 0;
    start_pending(&w->pending);
    w->projection = projection_of(ray);
#ifdef RUNG_EXACT
    w->over = w->given_up = ray->astray;
    if (w->over)
        return;
#endif
    w->walk = *walk;
    w->entered = -1;
#ifdef SKIP_EMPTY
    w->bricks = bricks_of(&w->walk, grid);
#else
    w->next = w->walk.next;
    w->cell = first_cell(&w->walk, grid);
#endif
}

// Notes the next cells on the way, up to tick `end`, and asks for their lists; what comes after, and when.
long note_cells(Walker *w, uint *cell, Ticks *planes, long entered, long end, GRID_PARAMETERS)
{
    const long row = grid->resolution[0], layer = row * grid->resolution[1];
    const long x = w->walk.up_x ? 1 : -1, y = w->walk.up_y ? row : -row, z = w->walk.up_z ? layer : -layer;
    const Ticks pace = w->walk.pace;
    Ticks ahead = *planes;
    uint here = *cell, n = 0;
#pragma unroll 1
    while (n < PATH && entered < end) {
        ask_for_list(here, grid, LIST_ARGUMENTS);
        w->cells[n] = here;
        w->ticks[n] = entered;
        ++n;
        entered = least_tick(&ahead);
        here += (uint)step_over(&ahead, &pace, x, y, z);
    }
    w->ticks[n] = entered;
    w->at = 0;
    w->end = n;
    *planes = ahead;
    *cell = here;
    return entered;
}

// Finds the next cells to look at: with SKIP_EMPTY those of the next brick that is not empty.
// Out of line, its loop has the registers.
__attribute__((noinline))
void find_path(Walker *w, GRID_PARAMETERS)
{
    const long stop = w->walk.stop;
#ifdef SKIP_EMPTY
    Bricks bricks = w->bricks;
    long entered = w->entered, due = least_tick(&bricks.next);
    while (entered < stop) {
        const uint distance = distances[brick_number(&bricks)];
        if (distance == 0)
            break;
#ifdef COUNT_STEPS
        ++w->hit.steps;
#endif
        entered = leave_empty(&bricks, &w->walk, distance, due);
        due = least_tick(&bricks.next);
    }
    if (entered < stop) {
        Ticks planes;
        uint cell = enter_brick(&bricks, &w->walk, grid, max(entered, 0L), &planes);
        note_cells(w, &cell, &planes, entered, min(due, stop), GRID_ARGUMENTS);
        leave_brick(&bricks, &w->walk);
        entered = due;
    } else {
        w->over = true;
    }
    w->bricks = bricks;
    w->entered = entered;
#else
    w->over = w->entered >= stop;
    w->entered = note_cells(w, &w->cell, &w->next, w->entered, stop, GRID_ARGUMENTS);
#endif
}

// Goes on along the path to the next list, and asks for it.
void find_list_on_path(Walker *w, GRID_PARAMETERS)
{
    const long stop = w->walk.stop;
    const uint end = w->end;
    uint at = w->at;
    List list = {0, 0};
    while (at < end && list.count == 0) {
        if (w->ticks[at] >= stop) {
            at = end;
            break;
        }
#ifdef COUNT_STEPS
        ++w->hit.steps;
#endif
        list = find_list(w->cells[at++], grid, LIST_ARGUMENTS);
    }
    if (list.count != 0)
        ask_for_ids(&list, LIST_ARGUMENTS);
    w->list = list;
    w->at = at;
}

// Takes up triangles of the list, and tells whether they are to be tested in this turn: where there are eight, or no
// list to go on with; those of a list in any case, where lists go one by one.
void take_ids(Walker *w, LIST_PARAMETERS, __global const uint *faces)
{
    const bool last = w->list.count == 0;
    while (w->list.count != 0 && w->pending.count < 8)
        take_up(&w->pending, take_id(&w->list, LIST_ARGUMENTS), faces);
#ifdef LIST_BY_LIST
    w->tests = w->pending.count != 0;
#else
    w->tests = w->pending.count == 8 || (last && w->pending.count != 0);
#endif
}

// A turn for each of the rays under way.
void take_turns(Walker *herd, uint count, GRID_PARAMETERS, MESH_PARAMETERS)
{
    for (uint k = 0; k < count; ++k)
        if (!herd[k].over && herd[k].list.count == 0 && herd[k].at == herd[k].end)
            find_path(herd + k, GRID_ARGUMENTS);
    for (uint k = 0; k < count; ++k)
        if (!herd[k].over && herd[k].list.count == 0)
            find_list_on_path(herd + k, GRID_ARGUMENTS);
    for (uint k = 0; k < count; ++k)
        take_ids(herd + k, LIST_ARGUMENTS, faces);
    for (uint k = 0; k < count; ++k) {
        const Walker *w = herd + k;
        for (uint i = 0; w->tests && i < w->pending.count; ++i)
            for (uint corner = 0; corner < 3; ++corner)
                ask_for(vertices + 3 * (size_t)faces[3 * (size_t)w->pending.ids[i] + corner]);
    }
    for (uint k = 0; k < count; ++k) {
        Walker *w = herd + k;
        if (!w->tests)
            continue;
#ifdef QUERY_EACH
        set_cell(&w->walk, w->ticks[w->at - 1], w->ticks[w->at], &w->hit);
#endif
        w->given_up = !test_pending(&w->ray, &w->projection, grid, MESH_ARGUMENTS, &w->pending, &w->walk, &w->hit);
        w->over |= w->given_up || settled(&w->hit);
    }
}

// What a ray that is over has found.
Hit outcome(const Walker *w, GRID_PARAMETERS, MESH_PARAMETERS)
{
    Hit hit = w->hit;
#ifdef RUNG_EXACT
    if (w->given_up)
        test_all(&w->ray, &w->projection, grid, MESH_ARGUMENTS, &hit);
#endif
    return hit;
}

// Takes a walker out of the herd; how many are left. The last takes its place.
uint dismiss(Walker *herd, uint k, uint count)
{
    if (k != count - 1)
        herd[k] = herd[count - 1];
    return count - 1;
}

#endif
