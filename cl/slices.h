// The way of a bundle through the grid, slice by slice: a slice is a layer of cells across the major axis, and
// of it the cells that the bundle's bounds overlap (after Wald et al. 2006).
#ifndef CLG_SLICES_H
#define CLG_SLICES_H
#include "bundle_keep.h"

// Triangles that are remembered for each tile so as not to be tested again, by the last digits of their ids.
#ifndef REMEMBERED
#define REMEMBERED 256u
#endif
#define MOST_WAITING 64u

// Triangles that wait to be tested.
typedef struct {
    uint ids[MOST_WAITING];
    uint seen[REMEMBERED * TILES_TOGETHER];
} Waiting;

// Bundles that go the same way together, each of a tile of its own.
typedef struct {
    Tile *tiles[TILES_TOGETHER];
    Bundle bundles[TILES_TOGETHER];
    uint alive[TILES_TOGETHER];  // bits: groups that a hit may still matter to
} Company;

// Tests waiting triangles, brought in once for bundles first .. end - 1.
void keep_waiting(Company *company, uint first, uint end, const Waiting *waiting, uint count, MESH_PARAMETERS)
{
    for (uint i = 0; i < count; i += LANES) {
        const uint *ids = waiting->ids + i, taken = min(count - i, (uint)LANES);
        const Corners8 corners = gather_corners(vertices, faces, ids, taken);
        const Triangles p = along_axes(&corners, company->bundles[first].way.kd);
        for (uint b = first; b < end; ++b)
            if (company->alive[b] != 0)
                keep_of_bundle(company->tiles[b], company->bundles + b, company->alive[b], &p, ids, taken, MESH_ARGUMENTS);
    }
}

// Takes up the triangles of the cells first .. last of a row that were not seen lately; tests them when they are
// many. Gives how many wait.
uint take_run(Company *company, uint begin, uint end, Waiting *waiting, uint count, uint first, uint last,
              GRID_PARAMETERS, MESH_PARAMETERS)
{
#if defined(LAYOUT_HASHED) || defined(LAYOUT_LINKED_LIST) || defined(LAYOUT_DYNAMIC_ARRAY)
    for (uint cell = first; cell <= last; ++cell) {
        const List list = find_list(cell, grid, LIST_ARGUMENTS);
#else
    {
        // The lists of consecutive cells follow each other.
        const List list = {cells[first], (uint)(cells[last + 1] - cells[first])};
#endif
#ifdef LAYOUT_LINKED_LIST
        for (ref_index node = list.begin; node != NO_REFERENCE; node = next[node]) {
            const uint id = triangles[node];
#else
        __global const uint *entries = entries_of(&list, LIST_ARGUMENTS);
        for (uint i = 0; i < list.count; ++i) {
            const uint id = entries[i];
#endif
            const uint at = id % (REMEMBERED * TILES_TOGETHER);
            ask_for(faces + 3 * (size_t)id);
            waiting->ids[count] = id;
            count += waiting->seen[at] != id ? 1 : 0;
            waiting->seen[at] = id;
            if (count == MOST_WAITING) {
                keep_waiting(company, begin, end, waiting, count, MESH_ARGUMENTS);
                count = 0;
            }
        }
    }
    return count;
}

// The way of bundles first .. end - 1. The bounds of each are linear: what is beyond all at both ends is between.
Way way_of_all(const Company *company, uint first, uint end)
{
    Way way = company->bundles[first].way;
    if (end - first == 1)
        return way;
    for (uint b = first + 1; b < end; ++b) {
        way.from = min(way.from, company->bundles[b].way.from);
        way.to = max(way.to, company->bundles[b].way.to);
    }
    const float span = max(way.to - way.from, SHORTEST_SPAN);
    for (int i = 0; i < 4; ++i) {
        float near = INFINITY, far = INFINITY;
        const float sign = i & 1 ? -1.0f : 1.0f;
        for (uint b = first; b < end; ++b) {
            const Beam *beam = &company->bundles[b].way.beam;
            near = min(near, sign * (beam->at[i] + beam->slope[i] * way.from));
            far = min(far, sign * (beam->at[i] + beam->slope[i] * (way.from + span)));
        }
        way.beam.slope[i] = sign * (far - near) / span;
        way.beam.at[i] = sign * (near - BEAM_PAD) - way.beam.slope[i] * way.from;
    }
    return way;
}

// Notes which groups of the bundles a hit at this depth, or deeper, may matter to; whether there are any.
bool any_alive(Company *company, uint first, uint end, float depth)
{
    uint any = 0;
    for (uint b = first; b < end; ++b)
        any |= company->alive[b] = groups_alive(company->bundles + b, depth);
    return any != 0;
}

// Casts the rays of bundles begin .. end - 1. False: they spread too far to go together.
// Once and out of line: it is large, and Intel's compiler takes four times as long over copies.
__attribute__((noinline))
bool walk_slices(Company *company, uint begin, uint end, GRID_PARAMETERS, MESH_PARAMETERS)
{
    Way way = way_of_all(company, begin, end);
    const int kd = way.kd;
    if (!clip_depths(&way, grid))
        return true;
    if (!keeps_together(&way, grid))
        return false;
    const bool climbs = way.side > 0.0f;
    const float lower = grid->lower_f[kd], cell = (float)grid->cell_size[kd];
    const int final = slice_at(grid, kd, climbs ? way.to : way.from);
    Waiting waiting;
    for (uint i = 0; i < REMEMBERED * TILES_TOGETHER; i += LANES)
        vstore8((uint8)(NO_HIT), 0, waiting.seen + i);
#ifdef SKIP_EMPTY
    int layer = -1;
    bool empty = false;
#endif
    for (int slice = slice_at(grid, kd, climbs ? way.from : way.to);; slice += climbs ? 1 : -1) {
        const float near = lower + (float)(climbs ? slice : slice + 1) * cell;
        const float far = lower + (float)(climbs ? slice + 1 : slice) * cell;
        if (!any_alive(company, begin, end, near))
            break;
        int first[3], last[3];
        bool passed = cells_between(&way, grid, near, far, first, last);
#ifdef SKIP_EMPTY
        if (layer != slice / (int)BRICK) {
            layer = slice / (int)BRICK;
            empty = layer_is_empty(&way, layer, grid, distances);
        }
        passed = passed && !empty;
#endif
        if (passed) {
            first[kd] = last[kd] = slice;
            uint count = 0;
            for (int z = first[2]; z <= last[2]; ++z)
                for (int y = first[1]; y <= last[1]; ++y) {
                    const uint row = ((uint)z * grid->resolution[1] + (uint)y) * grid->resolution[0];
                    count = take_run(company, begin, end, &waiting, count, row + (uint)first[0], row + (uint)last[0],
                                     GRID_ARGUMENTS, MESH_ARGUMENTS);
                }
            if (count != 0)
                keep_waiting(company, begin, end, &waiting, count, MESH_ARGUMENTS);
        }
        if (slice == final)
            break;
    }
    return true;
}

#endif
