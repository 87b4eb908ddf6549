// Where rays of a tile that go alone enter the grid, four at a time.
#ifndef CLG_ENTRIES_H
#define CLG_ENTRIES_H
#include "tile_rays.h"
#include "walk.h"

// Of rays first .. first + 3: as in Walk, before coarsen().
typedef struct {
    long next[3][4], pace[3][4], stop[4];
    double t_in[4];
    int cell[3][4];
    long up[3][4];
    uint first;    // TILE_RAYS: of none yet
    uint enter;    // bits: those that do
} Entries;

long4 ticks_of_4(double4 v)
{
    return (long4)((long)v.x, (long)v.y, (long)v.z, (long)v.w);
}

// What no t of a hit that matters is beyond.
double4 greatest_t(const Tile *tile, uint k)
{
#ifdef PARTS
    double bound[4];
    for (uint i = 0; i < 4; ++i)
        bound[i] = hit_of(tile, k + i).meeting.t;
    return fmin(last_t(tile, k), vload4(0, bound) + (T_SLACK + 0x1p-51 * fabs(vload4(0, tile->t_entry + k))));
#else
    return last_t(tile, k);
#endif
}

// Enters the grid with rays first .. first + 3, with the tests' t in the ray's interval.
void find_entries(const Tile *tile, uint first, __constant const GridParams *grid, Entries *entries)
{
    double4 o[3], d[3], inverse[3];
    long4 climbs[3];
    double4 t_in = first_t(tile, first), t_out = (double4)(INFINITY);
    for (int a = 0; a < 3; ++a) {
        const double4 given = convert_double4(vload4(0, tile->d[a] + first));
        o[a] = convert_double4(vload4(0, tile->o[a] + first));
        d[a] = fabs(given) < SMALLEST_CLIMB ? (double4)(SMALLEST_CLIMB) : given;
        inverse[a] = 1.0 / d[a];
        climbs[a] = d[a] > 0.0;
        const double4 t0 = (grid->lower[a] - o[a]) * inverse[a], t1 = (grid->upper[a] - o[a]) * inverse[a];
        const double4 near = climbs[a] ? t0 : t1, far = climbs[a] ? t1 : t0;
        t_in = near > t_in ? near : t_in;
        t_out = t_out < far ? t_out : far;
    }
    const double4 t_last = greatest_t(tile, first);
    t_out = t_out < t_last ? t_out : t_last;
    long4 stop = (long4)(LONG_MAX);
    for (int a = 0; a < 3; ++a) {
#ifdef NESTED
        const double size = grid->cell_size[a] / (double)(1 << FINEST);
        const int highest = ((int)grid->resolution[a] << FINEST) - 1;
#else
        const double size = grid->cell_size[a];
        const int highest = (int)grid->resolution[a] - 1;
#endif
        double4 k = ((o[a] + t_in * d[a]) - grid->lower[a]) / size;
        k = k > 0.0 ? k : (double4)(0.0);
        k = k < (double)highest ? k : (double4)((double)highest);
        const int4 cell = convert_int4(k);
        k = convert_double4(cell);
        const double4 next = ((grid->lower[a] + (climbs[a] ? k + 1.0 : k) * size) - o[a]) * inverse[a] - t_in;
        const double4 pace = size * fabs(inverse[a]);
        const double4 ahead = climbs[a] ? (double)highest - k : k;  // planes inside the grid
        const double4 leaves = next + ahead * pace;
        double4 at = next * TICKS, between = pace * TICKS;
        at = at > 0.0 ? at : (double4)(0.0);
        between = between < MOST_TICKS ? between : (double4)(MOST_TICKS);
        at = at < between ? at : between;
        const long4 due = ticks_of_4(at), step = ticks_of_4(between);
        // The very tick of the last plane, where it is soon enough to matter: no step leads out of the grid.
        const long4 out = leaves < 7.0 ? due + ticks_of_4(ahead) * step : (long4)((long)MOST_TICKS);
        stop = out < stop ? out : stop;
        vstore4(due, 0, entries->next[a]);
        vstore4(step, 0, entries->pace[a]);
        vstore4(cell, 0, entries->cell[a]);
        vstore4(climbs[a], 0, entries->up[a]);
    }
    // As tick_after.
    double4 span = t_out - t_in;
    span = span > -1.0 ? span : (double4)(-1.0);
    span = span < MOST_TICKS / TICKS ? span : (double4)(MOST_TICKS / TICKS);
    const long4 last = ticks_of_4(span * TICKS) + 1;
    stop = last < stop ? last : stop;
    vstore4(stop, 0, entries->stop);
    vstore4(t_in, 0, entries->t_in);
    entries->first = first;
    entries->enter = (uint)bits_of_4((t_in <= t_out) & (stop > 0));
}

// Ray k's way through the grid; it has to be one that enters it.
Walk walk_of(const Entries *entries, uint k)
{
    const uint i = k % 4;
    Walk walk;
    walk.next.x = entries->next[0][i];
    walk.next.y = entries->next[1][i];
    walk.next.z = entries->next[2][i];
    walk.pace.x = entries->pace[0][i];
    walk.pace.y = entries->pace[1][i];
    walk.pace.z = entries->pace[2][i];
    walk.stop = entries->stop[i];
    walk.t_in = entries->t_in[i];
    walk.cell = (int4)(entries->cell[0][i], entries->cell[1][i], entries->cell[2][i], 0);
    walk.up_x = entries->up[0][i] != 0;
    walk.up_y = entries->up[1][i] != 0;
    walk.up_z = entries->up[2][i] != 0;
#ifdef NESTED
    coarsen(&walk);
#endif
    return walk;
}

// Whether ray k enters the grid.
bool enters(const Tile *tile, uint k, __constant const GridParams *grid, Entries *entries)
{
    if (entries->first != (k & ~3u))
        find_entries(tile, k & ~3u, grid, entries);
    return entries->enter >> k % 4 & 1u;
}

#endif
