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
// Subgrids that wait to be passed, of all levels: more than the widest slices hold.
#define MOST_SUBGRIDS 512u
// In subgrids, whose slices hold few triangles each: so many wait before they are tested.
#ifndef FEWEST_TESTED
#define FEWEST_TESTED 8u
#endif

// Triangles that wait to be tested.
typedef struct {
    uint ids[MOST_WAITING];
    uint seen[REMEMBERED * TILES_TOGETHER];
#ifdef NESTED
    uint subgrids[MOST_SUBGRIDS], subgrid_count;  // to be passed before the next slice
#endif
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
#ifdef NESTED
            if (id >= grid->first_subgrid) {
                waiting->subgrids[min(waiting->subgrid_count++, MOST_SUBGRIDS - 1)] = id - (uint)grid->first_subgrid;
                continue;
            }
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

// Where a slice begins for the rays, and where it ends.
float near_of(const Box *box, const Way *way, int slice)
{
    return depth_of(box, way->kd, way->side > 0.0f ? slice : slice + 1);
}

float far_of(const Box *box, const Way *way, int slice)
{
    return depth_of(box, way->kd, way->side > 0.0f ? slice + 1 : slice);
}

// Takes up the triangles of a slice of the box, as take_run.
uint take_slice(Company *company, uint begin, uint end, const Way *way, const Box *box, int slice, Waiting *waiting,
                uint count, GRID_PARAMETERS, MESH_PARAMETERS)
{
    int first[3], last[3];
    if (!cells_between(way, box, near_of(box, way, slice), far_of(box, way, slice), first, last))
        return count;
    first[way->kd] = last[way->kd] = slice;
    for (int z = first[2]; z <= last[2]; ++z)
        for (int y = first[1]; y <= last[1]; ++y) {
            const uint row = box->number + ((uint)z * (uint)box->cells[1] + (uint)y) * (uint)box->cells[0];
            count = take_run(company, begin, end, waiting, count, row + (uint)first[0], row + (uint)last[0],
                             GRID_ARGUMENTS, MESH_ARGUMENTS);
        }
    return count;
}

#ifdef NESTED
// The slices of a grid or subgrid that are still to be passed.
typedef struct {
    Box box;
    int slice, final;
    uint subgrids;     // that wait since before it was entered
} Passage;

Passage passage_of(const Box *box, const Way *way, uint subgrids)
{
    const bool climbs = way->side > 0.0f;
    const Passage p = {*box, slice_at(box, way->kd, climbs ? way->from : way->to),
                       slice_at(box, way->kd, climbs ? way->to : way->from), subgrids};
    return p;
}

// Whether the rays overlap few enough cells of each slice of the subgrid.
bool keeps_together_in(const Way *way, const Box *box)
{
    const float near = depth_of(box, way->kd, 0), far = depth_of(box, way->kd, box->cells[way->kd]);
    Way inside = *way;
    inside.from = max(way->from, near);
    inside.to = min(way->to, far);
    return keeps_together(&inside, box);
}

// Whether a hit at this depth, or deeper, may matter to a group of the bundles. None is left out of tests for that
// before the next slice of the top grid: depths do not ascend from subgrid to subgrid, and a triangle that was
// remembered while a group was left out would be missed where it is not.
bool any_left(Company *company, uint first, uint end, float depth)
{
    uint any = 0;
    for (uint b = first; b < end; ++b)
        any |= groups_alive(company->bundles + b, depth);
    return any != 0;
}

// Passes the slices of the grid, and of each subgrid in a slice before the next. False: the rays spread too far.
bool pass_nest(Company *company, uint begin, uint end, const Way *way, const Box *whole, Waiting *waiting,
               GRID_PARAMETERS, MESH_PARAMETERS)
{
    Passage stack[MOST_LEVELS];
    uint depth = 0, count = 0;
    waiting->subgrid_count = 0;
    stack[0] = passage_of(whole, way, 0);
    for (;;) {
        Passage *p = stack + depth;
        if (waiting->subgrid_count > MOST_SUBGRIDS)
            return false;
        if (waiting->subgrid_count > p->subgrids) {
            const Box box = box_of_subgrid(grid, subgrids + waiting->subgrids[--waiting->subgrid_count]);
            if (!keeps_together_in(way, &box))
                return false;
            stack[++depth] = passage_of(&box, way, waiting->subgrid_count);
            continue;
        }
        if (count >= FEWEST_TESTED || (depth == 0 && count != 0)) {
            keep_waiting(company, begin, end, waiting, count, MESH_ARGUMENTS);
            count = 0;
        }
        const bool over = way->side > 0.0f ? p->slice > p->final : p->slice < p->final;
        const float near = near_of(&p->box, way, p->slice);
        if (over || !(depth == 0 ? any_alive(company, begin, end, near) : any_left(company, begin, end, near))) {
            if (depth == 0)
                return true;
            --depth;
            continue;
        }
        count = take_slice(company, begin, end, way, &p->box, p->slice, waiting, count, GRID_ARGUMENTS, MESH_ARGUMENTS);
        p->slice += way->side > 0.0f ? 1 : -1;
    }
}
#endif

// Casts the rays of bundles begin .. end - 1. False: they spread too far to go together.
// Once and out of line: it is large, and Intel's compiler takes four times as long over copies.
__attribute__((noinline))
bool walk_slices(Company *company, uint begin, uint end, GRID_PARAMETERS, MESH_PARAMETERS)
{
    Way way = way_of_all(company, begin, end);
    const Box box = whole_box(grid);
    if (!clip_depths(&way, grid))
        return true;
    if (!keeps_together(&way, &box))
        return false;
    Waiting waiting;
    for (uint i = 0; i < REMEMBERED * TILES_TOGETHER; i += LANES)
        vstore8((uint8)(NO_HIT), 0, waiting.seen + i);
#ifdef NESTED
    return pass_nest(company, begin, end, &way, &box, &waiting, GRID_ARGUMENTS, MESH_ARGUMENTS);
#else
    const bool climbs = way.side > 0.0f;
    const int final = slice_at(&box, way.kd, climbs ? way.to : way.from);
#ifdef SKIP_EMPTY
    int layer = -1;
    bool empty = false;
#endif
    for (int slice = slice_at(&box, way.kd, climbs ? way.from : way.to);; slice += climbs ? 1 : -1) {
        if (!any_alive(company, begin, end, near_of(&box, &way, slice)))
            break;
#ifdef SKIP_EMPTY
        if (layer != slice / (int)BRICK) {
            layer = slice / (int)BRICK;
            empty = layer_is_empty(&way, layer, &box, distances);
        }
        if (!empty)
#endif
        {
            const uint count = take_slice(company, begin, end, &way, &box, slice, &waiting, 0, GRID_ARGUMENTS, MESH_ARGUMENTS);
            if (count != 0)
                keep_waiting(company, begin, end, &waiting, count, MESH_ARGUMENTS);
        }
        if (slice == final)
            break;
    }
    return true;
#endif
}

#endif
