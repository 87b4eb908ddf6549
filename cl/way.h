// Where rays go that share their major axis, as the cells that they may pass: of each layer of cells across that axis,
// a slice, those that their bounds overlap (after Wald et al. 2006).
#ifndef CLG_WAY_H
#define CLG_WAY_H
#include "beam.h"
#include "grid.h"
#include "lists.h"

// Cells of a slice that a bundle may spread over; its rays go one by one if there are more.
#ifndef WIDEST_SLICE
#define WIDEST_SLICE 128.0f
#endif
// Depths that nearly coincide are taken to be so far apart: slopes between them would be made of rounding.
#define SHORTEST_SPAN 0x1p-12f

typedef struct {
    int ku, kv, kd;    // axes; kd is the major one
    float side;        // 1 if the rays climb it, or -1
    float from, to;    // depths between which the bounds hold, and all hits lie
    Beam beam;         // bounds of all rays
} Way;

// Cells as the way passes them: those of the grid, or of a subgrid.
typedef struct {
    float lower[3], size[3], per_unit[3];
    int cells[3];      // along each axis
    uint number;       // of the first one
#ifdef NESTED
    float first[3];    // where that is, in cells of this size from the lower corner
#endif
} Box;

Box whole_box(__constant const GridParams *grid)
{
    Box box;
    for (int a = 0; a < 3; ++a) {
        box.lower[a] = grid->lower_f[a];
        box.size[a] = (float)grid->cell_size[a];
        box.per_unit[a] = grid->cells_per_unit[a];
        box.cells[a] = (int)grid->resolution[a];
#ifdef NESTED
        box.first[a] = 0.0f;
#endif
    }
    box.number = 0;
    return box;
}

#ifdef NESTED
Box box_of_subgrid(__constant const GridParams *grid, __global const Subgrid *subgrid)
{
    Box box;
    for (int a = 0; a < 3; ++a) {
        // A power of two: nothing is rounded.
        const float finer = (float)(1u << (FINEST - finer_than(subgrid, a)));
        box.lower[a] = grid->lower_f[a];
        box.size[a] = (float)grid->cell_size[a] / finer;
        box.per_unit[a] = grid->cells_per_unit[a] * finer;
        box.cells[a] = 1 << halvings_of(subgrid, a);
        box.first[a] = (float)subgrid->first[a];
    }
    box.number = subgrid->first_cell;
    return box;
}
#endif

// Depth of plane k of a box along an axis.
float depth_of(const Box *box, int axis, int k)
{
#ifdef NESTED
    return box->lower[axis] + (box->first[axis] + (float)k) * box->size[axis];
#else
    return box->lower[axis] + (float)k * box->size[axis];
#endif
}

// Of rays whose major axis is class / 2, and which descend it if class is odd.
void name_axes(Way *way, uint class)
{
    way->kd = (int)(class >> 1);
    way->ku = way->kd == 2 ? 0 : way->kd + 1;
    way->kv = way->ku == 2 ? 0 : way->ku + 1;
    way->side = class & 1 ? -1.0f : 1.0f;
}

// Narrows the depths to those where the bounds overlap the grid. False: there are none.
bool clip_depths(Way *way, __constant const GridParams *grid)
{
    for (int i = 0; i < 4; ++i) {
        const int axis = i < 2 ? way->ku : way->kv;
        // A least coordinate is to be below the upper side, a greatest above the lower: slope * depth <= room.
        const float sign = i & 1 ? -1.0f : 1.0f;
        const float side = (float)(i & 1 ? grid->lower[axis] : grid->upper[axis]) + sign * BEAM_PAD;
        const float slope = sign * way->beam.slope[i], room = sign * (side - way->beam.at[i]);
        const float depth = room / slope;
        if (slope > 0x1p-20f)
            way->to = min(way->to, depth + BEAM_PAD);
        else if (slope < -0x1p-20f)
            way->from = max(way->from, depth - BEAM_PAD);
        else if (room < -0x1p-16f)
            return false;
    }
    return way->from < way->to;
}

// Number of the box's cell along an axis that holds x; x may be outside.
float cell_at(const Box *box, int axis, float x)
{
#ifdef NESTED
    return (x - box->lower[axis]) * box->per_unit[axis] - box->first[axis];
#else
    return (x - box->lower[axis]) * box->per_unit[axis];
#endif
}

// Whether the rays overlap few enough cells of a slice for them to gain by company.
bool keeps_together(const Way *way, const Box *box)
{
    const Beam *b = &way->beam;
    for (int end = 0; end < 2; ++end) {
        const float depth = end ? way->to : way->from;
        const float u = b->at[1] - b->at[0] + (b->slope[1] - b->slope[0]) * depth;
        const float v = b->at[3] - b->at[2] + (b->slope[3] - b->slope[2]) * depth;
        if ((u * box->per_unit[way->ku] + 1.0f) * (v * box->per_unit[way->kv] + 1.0f) > WIDEST_SLICE)
            return false;
    }
    return true;
}

// Number of the slice at a depth.
int slice_at(const Box *box, int axis, float depth)
{
    const int highest = box->cells[axis] - 1;
    return min((int)clamp(cell_at(box, axis, depth), 0.0f, (float)highest), highest);
}

// Cells of the box that the bundle's bounds overlap between two depths. False: none.
bool cells_between(const Way *way, const Box *box, float near, float far, int *first, int *last)
{
    const Beam *beam = &way->beam;
    for (int i = 0; i < 2; ++i) {
        const int axis = i ? way->kv : way->ku, highest = box->cells[axis] - 1;
        const float low_at = beam->at[2 * i], low_slope = beam->slope[2 * i];
        const float high_at = beam->at[2 * i + 1], high_slope = beam->slope[2 * i + 1];
        const float low = min(low_at + low_slope * near, low_at + low_slope * far);
        const float high = max(high_at + high_slope * near, high_at + high_slope * far);
        const float least = cell_at(box, axis, low - BEAM_PAD), greatest = cell_at(box, axis, high + BEAM_PAD);
        if (!(greatest >= 0.0f && least < (float)(highest + 1)))
            return false;
        first[axis] = min((int)max(least, 0.0f), highest);
        last[axis] = min((int)min(greatest, (float)highest), highest);
    }
    return true;
}

#ifdef SKIP_EMPTY
// Whether the bricks are empty that the rays may pass in a layer of them, across the major axis.
bool layer_is_empty(const Way *way, int layer, const Box *box, __global const uchar *distances)
{
    const int kd = way->kd;
    int first[3], last[3];
    if (!cells_between(way, box, depth_of(box, kd, layer * (int)BRICK), depth_of(box, kd, (layer + 1) * (int)BRICK),
                       first, last))
        return true;
    first[kd] = last[kd] = layer * (int)BRICK;
    const uint across = ((uint)box->cells[0] + BRICK - 1) / BRICK, deep = ((uint)box->cells[1] + BRICK - 1) / BRICK;
    for (uint z = (uint)first[2] / BRICK; z <= (uint)last[2] / BRICK; ++z)
        for (uint y = (uint)first[1] / BRICK; y <= (uint)last[1] / BRICK; ++y)
            for (uint x = (uint)first[0] / BRICK; x <= (uint)last[0] / BRICK; ++x)
                if (distances[((size_t)z * deep + y) * across + x] == 0)
                    return false;
    return true;
}
#endif

// Whether none of the cells has a list that the rays may pass. False also where they are too many to look.
bool passes_nothing(Way *way, GRID_PARAMETERS)
{
    const int kd = way->kd;
    const Box box = whole_box(grid);
    if (!clip_depths(way, grid))
        return true;
    if (!keeps_together(way, &box))
        return false;
    const int end = slice_at(&box, kd, way->to);
    for (int slice = slice_at(&box, kd, way->from); slice <= end; ++slice) {
        int first[3], last[3];
        if (!cells_between(way, &box, depth_of(&box, kd, slice), depth_of(&box, kd, slice + 1), first, last))
            continue;
        first[kd] = last[kd] = slice;
        for (int z = first[2]; z <= last[2]; ++z)
            for (int y = first[1]; y <= last[1]; ++y) {
                const uint row = ((uint)z * (uint)box.cells[1] + (uint)y) * (uint)box.cells[0];
                if (!all_empty(row + (uint)first[0], (uint)(last[0] - first[0]) + 1, grid, LIST_ARGUMENTS))
                    return false;
            }
    }
    return true;
}

#endif
