// The way of a bundle through the grid, slice by slice: a slice is a layer of cells across the major axis, and
// of it the cells that the bundle's bounds overlap (after Wald et al. 2006).
#ifndef CLG_SLICES_H
#define CLG_SLICES_H
#include "bundle_keep.h"

// Triangles that are remembered so as not to be tested again, by the last digits of their ids.
#ifndef REMEMBERED
#define REMEMBERED 128u
#endif
#define MOST_WAITING 64u

// Triangles that wait to be tested.
typedef struct {
    uint ids[MOST_WAITING];
    uint seen[REMEMBERED];
} Waiting;

void keep_waiting(Tile *tile, Bundle *bundle, uint alive, const Waiting *waiting, uint count, MESH_PARAMETERS)
{
    for (uint i = 0; i < count; i += LANES)
        keep_of_bundle(tile, bundle, alive, waiting->ids + i, min(count - i, (uint)LANES), MESH_ARGUMENTS);
}

// Takes up the triangles of the cells first .. last of a row that were not seen lately; tests them when they are
// many. Gives how many wait.
uint take_run(Tile *tile, Bundle *bundle, uint alive, Waiting *waiting, uint count, uint first, uint last,
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
            const uint at = id % REMEMBERED;
            ask_for(faces + 3 * (size_t)id);
            waiting->ids[count] = id;
            count += waiting->seen[at] != id ? 1 : 0;
            waiting->seen[at] = id;
            if (count == MOST_WAITING) {
                keep_waiting(tile, bundle, alive, waiting, count, MESH_ARGUMENTS);
                count = 0;
            }
        }
    }
    return count;
}

// Casts the rays of the bundle. False: they go one by one.
bool walk_slices(Tile *tile, Bundle *bundle, GRID_PARAMETERS, MESH_PARAMETERS)
{
    Way *way = &bundle->way;
    const int kd = way->kd;
    if (!clip_depths(way, grid))
        return true;
    if (!keeps_together(way, grid))
        return false;
    const bool climbs = way->side > 0.0f;
    const float lower = grid->lower_f[kd], cell = (float)grid->cell_size[kd];
    const int end = slice_at(grid, kd, climbs ? way->to : way->from);
    Waiting waiting;
    for (uint i = 0; i < REMEMBERED; i += LANES)
        vstore8((uint8)(NO_HIT), 0, waiting.seen + i);
#ifdef SKIP_EMPTY
    int layer = -1;
    bool empty = false;
#endif
    for (int slice = slice_at(grid, kd, climbs ? way->from : way->to);; slice += climbs ? 1 : -1) {
        const float near = lower + (float)(climbs ? slice : slice + 1) * cell;
        const float far = lower + (float)(climbs ? slice + 1 : slice) * cell;
        const uint alive = groups_alive(bundle, near);
        if (alive == 0)
            break;
        int first[3], last[3];
        bool passed = cells_between(way, grid, near, far, first, last);
#ifdef SKIP_EMPTY
        if (layer != slice / (int)BRICK) {
            layer = slice / (int)BRICK;
            empty = layer_is_empty(way, layer, grid, distances);
        }
        passed = passed && !empty;
#endif
        if (passed) {
            first[kd] = last[kd] = slice;
            uint count = 0;
            for (int z = first[2]; z <= last[2]; ++z)
                for (int y = first[1]; y <= last[1]; ++y) {
                    const uint row = ((uint)z * grid->resolution[1] + (uint)y) * grid->resolution[0];
                    count = take_run(tile, bundle, alive, &waiting, count, row + (uint)first[0], row + (uint)last[0],
                                     GRID_ARGUMENTS, MESH_ARGUMENTS);
                }
            if (count != 0)
                keep_waiting(tile, bundle, alive, &waiting, count, MESH_ARGUMENTS);
        }
        if (slice == end)
            break;
    }
    return true;
}

#endif
