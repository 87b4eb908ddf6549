// The way of a bundle through the grid, slice by slice: a slice is a layer of cells across the major axis, and
// of it the cells that the bundle's bounds overlap (after Wald et al. 2006).
#ifndef CLG_SLICES_H
#define CLG_SLICES_H
#include "bundle_keep.h"
#include "lists.h"

// Cells of a slice that a bundle may spread over; its rays go one by one if there are more.
#ifndef WIDEST_SLICE
#define WIDEST_SLICE 128.0f
#endif
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

// Narrows the depths to those where the bounds overlap the grid. False: there are none.
bool clip_depths(Bundle *bundle, __constant const GridParams *grid)
{
    for (int i = 0; i < 4; ++i) {
        const int axis = i < 2 ? bundle->ku : bundle->kv;
        // A least coordinate is to be below the upper side, a greatest above the lower: slope * depth <= room.
        const float sign = i & 1 ? -1.0f : 1.0f;
        const float side = (float)(i & 1 ? grid->lower[axis] : grid->upper[axis]) + sign * BEAM_PAD;
        const float slope = sign * bundle->beam.slope[i], room = sign * (side - bundle->beam.at[i]);
        const float depth = room / slope;
        if (slope > 0x1p-20f)
            bundle->to = min(bundle->to, depth + BEAM_PAD);
        else if (slope < -0x1p-20f)
            bundle->from = max(bundle->from, depth - BEAM_PAD);
        else if (room < -0x1p-16f)
            return false;
    }
    return bundle->from < bundle->to;
}

// Number of the cell along an axis that holds x; x may be outside.
float cell_at(__constant const GridParams *grid, int axis, float x)
{
    return (x - grid->lower_f[axis]) * grid->cells_per_unit[axis];
}

// Whether the bundle overlaps few enough cells of a slice for its rays to gain by company.
bool keeps_together(const Bundle *bundle, __constant const GridParams *grid)
{
    const Beam *b = &bundle->beam;
    for (int end = 0; end < 2; ++end) {
        const float depth = end ? bundle->to : bundle->from;
        const float u = b->at[1] - b->at[0] + (b->slope[1] - b->slope[0]) * depth;
        const float v = b->at[3] - b->at[2] + (b->slope[3] - b->slope[2]) * depth;
        if ((u * grid->cells_per_unit[bundle->ku] + 1.0f) * (v * grid->cells_per_unit[bundle->kv] + 1.0f) > WIDEST_SLICE)
            return false;
    }
    return true;
}

// Number of the slice at a depth.
int slice_at(__constant const GridParams *grid, int axis, float depth)
{
    const int highest = (int)grid->resolution[axis] - 1;
    return min((int)clamp(cell_at(grid, axis, depth), 0.0f, (float)highest), highest);
}

// Cells that the bundle's bounds overlap between two depths. False: none in the grid.
bool cells_between(const Bundle *bundle, __constant const GridParams *grid, float near, float far, int *first, int *last)
{
    const Beam *beam = &bundle->beam;
    for (int i = 0; i < 2; ++i) {
        const int axis = i ? bundle->kv : bundle->ku, highest = (int)grid->resolution[axis] - 1;
        const float low_at = beam->at[2 * i], low_slope = beam->slope[2 * i];
        const float high_at = beam->at[2 * i + 1], high_slope = beam->slope[2 * i + 1];
        const float low = min(low_at + low_slope * near, low_at + low_slope * far);
        const float high = max(high_at + high_slope * near, high_at + high_slope * far);
        const float least = cell_at(grid, axis, low - BEAM_PAD), greatest = cell_at(grid, axis, high + BEAM_PAD);
        if (!(greatest >= 0.0f && least < (float)(highest + 1)))
            return false;
        first[axis] = min((int)max(least, 0.0f), highest);
        last[axis] = min((int)min(greatest, (float)highest), highest);
    }
    return true;
}

#ifdef SKIP_EMPTY
// Whether the bricks are empty that the bundle may pass in a layer of them, across the major axis.
bool layer_is_empty(const Bundle *bundle, int layer, __constant const GridParams *grid, __global const uchar *distances)
{
    const int kd = bundle->kd;
    const float lower = grid->lower_f[kd], cell = (float)grid->cell_size[kd];
    int first[3], last[3];
    if (!cells_between(bundle, grid, lower + (float)(layer * (int)BRICK) * cell,
                       lower + (float)((layer + 1) * (int)BRICK) * cell, first, last))
        return true;
    first[kd] = last[kd] = layer * (int)BRICK;
    const uint across = (grid->resolution[0] + BRICK - 1) / BRICK, deep = (grid->resolution[1] + BRICK - 1) / BRICK;
    for (uint z = (uint)first[2] / BRICK; z <= (uint)last[2] / BRICK; ++z)
        for (uint y = (uint)first[1] / BRICK; y <= (uint)last[1] / BRICK; ++y)
            for (uint x = (uint)first[0] / BRICK; x <= (uint)last[0] / BRICK; ++x)
                if (distances[((size_t)z * deep + y) * across + x] == 0)
                    return false;
    return true;
}
#endif

// Casts the rays of the bundle. False: they go one by one.
bool walk_slices(Tile *tile, Bundle *bundle, GRID_PARAMETERS, MESH_PARAMETERS)
{
    const int kd = bundle->kd;
    if (!clip_depths(bundle, grid))
        return true;
    if (!keeps_together(bundle, grid))
        return false;
    const bool climbs = bundle->side > 0.0f;
    const int way = climbs ? 1 : -1;
    const float lower = grid->lower_f[kd], cell = (float)grid->cell_size[kd];
    const int end = slice_at(grid, kd, climbs ? bundle->to : bundle->from);
    Waiting waiting;
    for (uint i = 0; i < REMEMBERED; i += LANES)
        vstore8((uint8)(NO_HIT), 0, waiting.seen + i);
#ifdef SKIP_EMPTY
    int layer = -1;
    bool empty = false;
#endif
    for (int slice = slice_at(grid, kd, climbs ? bundle->from : bundle->to);; slice += way) {
        const float near = lower + (float)(climbs ? slice : slice + 1) * cell;
        const float far = lower + (float)(climbs ? slice + 1 : slice) * cell;
        const uint alive = groups_alive(bundle, near);
        if (alive == 0)
            break;
        int first[3], last[3];
        bool passed = cells_between(bundle, grid, near, far, first, last);
#ifdef SKIP_EMPTY
        if (layer != slice / (int)BRICK) {
            layer = slice / (int)BRICK;
            empty = layer_is_empty(bundle, layer, grid, distances);
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
