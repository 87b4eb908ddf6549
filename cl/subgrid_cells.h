// The cells of a subgrid that the triangles of its cell's list are entered in: those that their padded boxes touch, and
// of a box of several cells those that the triangle itself may touch.
//   mark     64 bits that say which: a bit for each cell of the box, x first, but of boxes of at most two cells along
//            each axis as if they had two; the box's first cell, five bits an axis; cells beyond it along each
//            axis, the same. MARKED_LARGE: the box has too many cells
#ifndef CLG_SUBGRID_CELLS_H
#define CLG_SUBGRID_CELLS_H
#include "clip.h"
#include "lanes.h"
#include "subgrid.h"

#define MARKED_LARGE 0x8000000000000000ul
// Of the upper half of a mark: those bits that boxes of at most two cells along each axis leave 0.
#define MORE_THAN_TWO 0x3DEF0000u
#if CLIP_CELLS != 32
#error "a mark has a bit for each cell of a box that is not clipped"
#endif
// A box of fewer cells is taken whole; in longer ones, or more cells than CLIP_CELLS, triangles are clipped.
#define FEWEST_HELD 4
#define LONGEST_HELD 8

// What is asked of a subgrid again and again.
typedef struct {
    __constant const GridParams *grid;
    int4 first, cells;   // place of its first cell, in cells of its size; how many along each axis
    uint4 finer;         // halvings of a cell that make the finest
    uint number;         // of its first cell
} Part;

Part part_of(__constant const GridParams *grid, __global const Subgrid *s)
{
    const Part part = {grid, (int4)(s->first[0], s->first[1], s->first[2], 0),
                       (int4)(1 << halvings_of(s, 0), 1 << halvings_of(s, 1), 1 << halvings_of(s, 2), 1),
                       (uint4)(finer_than(s, 0), finer_than(s, 1), finer_than(s, 2), 0), s->first_cell};
    return part;
}

// First and last of the cells along an axis that eight boxes touch: of the finest as in cell_range, brought to cells of
// the part.
void part_cells_along(const Part *part, int axis, int first, int cells, uint finer, float8 low, float8 high, int8 *from,
                      int8 *to)
{
    __constant const GridParams *grid = part->grid;
    const float lower = grid->lower_f[axis], scale = grid->cells_per_unit[axis] * (float)(1 << FINEST);
    const int8 highest = (int8)(((int)grid->resolution[axis] << FINEST) - 1);
    const int8 begin = min(max(convert_int8((low - lower) * scale), (int8)(0)), highest) >> (int8)((int)finer);
    const int8 end = min(max(convert_int8((high - lower) * scale), (int8)(0)), highest) >> (int8)((int)finer);
    // The list's triangles touch the subgrid's cell, all but for what rounding makes of it.
    *from = min(max(begin - first, (int8)(0)), (int8)(cells - 1));
    *to = min(max(end - first, *from), (int8)(cells - 1));
}

int greatest_int_of(int8 v)
{
    const int4 four = max(v.lo, v.hi);
    const int2 two = max(four.lo, four.hi);
    return max(two.x, two.y);
}

// Eight boxes of cells: where each begins, how many cells beyond the first it has along each axis, and how many bits
// of the mark a row and a layer take.
typedef struct {
    int8 x, y, z, more_x, more_y, more_z, row, layer;
} Boxes;

// A function of a cell's place in each of eight boxes.
typedef struct {
    float8 x, y, z, at;
    float8 reach;
} Side8;

Side8 side_of(const Points *normal, const Points *corner, const Points *middle, const float *size, float8 slack)
{
    Side8 s;
    s.x = normal->x * size[0];
    s.y = normal->y * size[1];
    s.z = normal->z * size[2];
    s.at = normal->x * (middle->x - corner->x) + normal->y * (middle->y - corner->y) + normal->z * (middle->z - corner->z);
    s.reach = 0.5f * (fabs(s.x) + fabs(s.y) + fabs(s.z))
              + (float)FACET_PAD * (fabs(normal->x) + fabs(normal->y) + fabs(normal->z)) + slack;
    return s;
}

float8 value_at(const Side8 *s, float x, float y, float z)
{
    return s->at + (s->x * x + s->y * y + s->z * z);
}

Points less(const Points *p, const Points *q)
{
    const Points d = {p->x - q->x, p->y - q->y, p->z - q->z};
    return d;
}

float8 largest_of(const Points *p)
{
    return max(max(fabs(p->x), fabs(p->y)), fabs(p->z));
}

// An edge's normal in the plane across the axis that is not 0 in `axis`.
Points across(const Points *edge, const Points *axis)
{
    const Points n = {edge->y * axis->z - edge->z * axis->y, edge->z * axis->x - edge->x * axis->z,
                      edge->x * axis->y - edge->y * axis->x};
    return n;
}

// Of eight boxes that are no longer than LONGEST_HELD cells, the cells that the triangles may touch, a bit each: their
// planes pass them, and as seen along the axis that a plane faces, none of the edges has them beyond itself
// (Schwarz and Seidel 2010). Of cells widened by more than HIT_ERROR (docs/numerics.md, "Nested grids").
uint8 cells_touched(const Part *part, const Corners8 *p, const Boxes *box)
{
    float size[3], from[3];
    const uint finer[3] = {part->finer.x, part->finer.y, part->finer.z};
    const int first[3] = {part->first.x, part->first.y, part->first.z};
    for (int a = 0; a < 3; ++a) {
        size[a] = (float)part->grid->cell_size[a] / (float)(1u << (FINEST - finer[a]));
        from[a] = part->grid->lower_f[a] + ((float)first[a] + 0.5f) * size[a];
    }
    const Points middle = {from[0] + convert_float8(box->x) * size[0], from[1] + convert_float8(box->y) * size[1],
                           from[2] + convert_float8(box->z) * size[2]};
    const Points e = less(&p->b, &p->a), f = less(&p->c, &p->a), g = less(&p->c, &p->b);
    const Points n = {e.y * f.z - e.z * f.y, e.z * f.x - e.x * f.z, e.x * f.y - e.y * f.x};
    const float8 none = (float8)(0.0f);
    const int8 is_x = (fabs(n.x) >= fabs(n.y)) & (fabs(n.x) >= fabs(n.z)), is_y = ~is_x & (fabs(n.y) >= fabs(n.z));
    const float8 facing = is_x ? n.x : is_y ? n.y : n.z;
    const float8 side = facing < 0.0f ? (float8)(-1.0f) : (float8)(1.0f);
    const Points axis = {is_x ? side : none, is_y ? side : none, is_x | is_y ? none : side};
    const Points back = {-f.x, -f.y, -f.z};
    const float8 edge = max(max(largest_of(&e), largest_of(&f)), largest_of(&g));
    const float8 wide = max(edge, (float)LONGEST_HELD * max(max(size[0], size[1]), size[2]));
    const float8 slack = (float)FACET_SLACK * edge * wide;
    const Points of_e = across(&e, &axis), of_g = across(&g, &axis), of_f = across(&back, &axis);
    const Side8 plane = side_of(&n, &p->a, &middle, size, slack * edge);
    const Side8 sides[3] = {side_of(&of_e, &p->a, &middle, size, slack), side_of(&of_g, &p->b, &middle, size, slack),
                            side_of(&of_f, &p->c, &middle, size, slack)};
    const int most_x = greatest_int_of(box->more_x), most_y = greatest_int_of(box->more_y), most_z = greatest_int_of(box->more_z);
    uint8 bits = (uint8)(0);
    for (int z = 0; z <= most_z; ++z)
        for (int y = 0; y <= most_y; ++y)
            for (int x = 0; x <= most_x; ++x) {
                const float cx = (float)x, cy = (float)y, cz = (float)z;
                int8 touched = fabs(value_at(&plane, cx, cy, cz)) <= plane.reach;
                for (int i = 0; i < 3; ++i)
                    touched &= value_at(sides + i, cx, cy, cz) <= sides[i].reach;
                touched &= (x <= box->more_x) & (y <= box->more_y) & (z <= box->more_z);
                bits |= as_uint8(touched & 1) << as_uint8((z * box->layer + y * box->row + x) & 31);
            }
    return bits;
}

// The marks of 1 to 8 triangles.
void mark_eight(const Part *part, __global const float *vertices, __global const uint *faces, __global const uint *ids,
                uint count, ulong *marks)
{
    uint taken[8];
    for (uint i = 0; i < 8; ++i)
        taken[i] = ids[min(i, count - 1)];
    const Corners8 p = gather_corners(vertices, faces, taken, 8);
    const float8 pad = (float8)((float)BOX_PAD);
    int8 x, y, z, to_x, to_y, to_z;
    part_cells_along(part, 0, part->first.x, part->cells.x, part->finer.x, min(min(p.a.x, p.b.x), p.c.x) - pad,
                     max(max(p.a.x, p.b.x), p.c.x) + pad, &x, &to_x);
    part_cells_along(part, 1, part->first.y, part->cells.y, part->finer.y, min(min(p.a.y, p.b.y), p.c.y) - pad,
                     max(max(p.a.y, p.b.y), p.c.y) + pad, &y, &to_y);
    part_cells_along(part, 2, part->first.z, part->cells.z, part->finer.z, min(min(p.a.z, p.b.z), p.c.z) - pad,
                     max(max(p.a.z, p.b.z), p.c.z) + pad, &z, &to_z);
    const int8 more_x = to_x - x, more_y = to_y - y, more_z = to_z - z;
    const int8 boxes = (more_x + 1) * (more_y + 1) * (more_z + 1);
    // Along one axis alone, a triangle touches every cell of its box.
    const int8 flat = (more_x == 0) + (more_y == 0) + (more_z == 0) < -1;
    const int8 fits = boxes <= (int8)((int)CLIP_CELLS);
    const int8 large = ~fits | (~flat & (max(max(more_x, more_y), more_z) >= LONGEST_HELD));
    const int8 held = (boxes >= FEWEST_HELD) & ~large & ~flat;
    const uint8 places = as_uint8(x | y << 5 | z << 10 | more_x << 15 | more_y << 20 | more_z << 25);
    const int8 easy = (more_x | more_y | more_z) < 2;
    const int8 row = easy ? (int8)(2) : more_x + 1, layer = easy ? (int8)(4) : (more_x + 1) * (more_y + 1);
    const int8 in_row = 1 + 2 * more_x, in_layer = in_row * (1 + 4 * more_y);
    const uint8 all_cells = (uint8)(0xFFFFFFFFu) >> as_uint8(32 - min(boxes, (int8)(32)));
    uint8 bits = easy ? as_uint8(in_layer * (1 + 16 * more_z)) : all_cells;
    if (any(held)) {
        const Boxes own = {x, y, z, more_x & held, more_y & held, more_z & held, row, layer};
        bits = as_int8(held) ? cells_touched(part, &p, &own) : bits;
    }
    uint place[8], touched[8], is_large[8];
    vstore8(places, 0, place);
    vstore8(bits, 0, touched);
    vstore8(as_uint8(large), 0, is_large);
    for (uint i = 0; i < count; ++i)
        marks[i] = (ulong)place[i] << 32 | (is_large[i] ? MARKED_LARGE : (ulong)touched[i]);
}

// A mark's box: number of its first cell, and what leads to the next along each axis.
typedef struct {
    uint first, more_x, more_y, more_z;
    uint row, layer;
} Box3;

Box3 box_of(const Part *part, ulong mark)
{
    const uint place = (uint)(mark >> 32);
    const uint row = (uint)part->cells.x, layer = row * (uint)part->cells.y;
    const Box3 box = {part->number + (place >> 10 & 31u) * layer + (place >> 5 & 31u) * row + (place & 31u),
                      place >> 15 & 31u, place >> 20 & 31u, place >> 25 & 31u, row, layer};
    return box;
}

// Whether a mark is of a box of at most two cells along each axis: nearly all. No branch foretells which of them the
// triangle is entered in, so that all eight are treated alike.
bool is_easy(ulong mark)
{
    return (mark & (MARKED_LARGE | (ulong)MORE_THAN_TWO << 32)) == 0;
}

// The cells of an easy box.
void easy_cells(const Box3 *box, uint *cells)
{
    const uint x = box->more_x, y = box->row & -box->more_y, z = box->layer & -box->more_z;
#pragma unroll
    for (uint k = 0; k < 8; ++k)
        cells[k] = box->first + (k & 1u ? x : 0) + (k & 2u ? y : 0) + (k & 4u ? z : 0);
}

// A triangle of the list of the cell that a subgrid is in: its mark and number, and the mesh.
typedef struct {
    ulong mark;
    uint id;
    __global const float *vertices;
    __global const uint *faces;
} Entry;

// Next of the runs of cells in rows that an entry that is not easy is entered in, as first and last; (1, 0): none is left.
// `row` counts the rows of the box, from 0 on.
int2 next_run(const Part *part, const Entry *entry, const Box3 *box, const Polygon *triangle, const Planes *planes,
              Side *sides, int *number, uint row)
{
    const uint y = row % (box->more_y + 1), z = row / (box->more_y + 1);
    const uint place = (uint)(entry->mark >> 32);
    const int4 low = part->first + (int4)((int)(place & 31u), (int)(place >> 5 & 31u), (int)(place >> 10 & 31u), 0);
    if (y == 0)
        *number = cut_layer(planes, triangle, low.z + (int)z, sides);
    return row_run(planes, sides, *number, low.y + (int)y, low.x, low.x + (int)box->more_x) - low.x;
}

// One more in each cell that the entry is entered in; how many these are.
uint count_entry(const Part *part, const Entry *entry, __global uint *counts)
{
    const Box3 box = box_of(part, entry->mark);
    const uint bits = (uint)entry->mark;
    if (is_easy(entry->mark)) {
        uint cells[8];
        easy_cells(&box, cells);
#pragma unroll
        for (uint k = 0; k < 8; ++k)
            counts[cells[k]] += bits >> k & 1u;
        return (uint)popcount(bits);
    }
    if (!(entry->mark & MARKED_LARGE)) {
        const uint across = box.more_x + 1;
        ulong left = bits;
        for (uint layer = box.first; left != 0; layer += box.layer)
            for (uint y = 0, row = layer; y <= box.more_y; ++y, row += box.row, left >>= across)
                for (uint own = (uint)(left & ((1ul << across) - 1ul)); own != 0; own &= own - 1)
                    ++counts[row + lowest_of_32(own)];
        return (uint)popcount(bits);
    }
    uint entered = 0;
    const Polygon triangle = whole_triangle(entry->vertices, entry->faces + 3 * (size_t)entry->id);
    const Planes planes = planes_of(part->grid, (uint4)(FINEST, FINEST, FINEST, 0) - part->finer);
    Side sides[5];
    int number = 0;
    for (uint row = 0; row < (box.more_y + 1) * (box.more_z + 1); ++row) {
        const int2 run = next_run(part, entry, &box, &triangle, &planes, sides, &number, row);
        const uint first = box.first + row % (box.more_y + 1) * box.row + row / (box.more_y + 1) * box.layer;
        for (int x = run.x; x <= run.y; ++x, ++entered)
            ++counts[first + (uint)x];
    }
    return entered;
}

// The entry's triangle before what each of its cells has so far: `begins` says where that is.
void fill_entry(const Part *part, const Entry *entry, __global uint *begins, __global uint *references)
{
    const Box3 box = box_of(part, entry->mark);
    const uint bits = (uint)entry->mark;
    if (is_easy(entry->mark)) {
        if (bits == 0)
            return;
        uint cells[8];
        easy_cells(&box, cells);
        // What is not entered is written where something is.
        uint at = begins[cells[lowest_of_32(bits)]] - 1;
#pragma unroll
        for (uint k = 0; k < 8; ++k) {
            const uint here = begins[cells[k]] - (bits >> k & 1u);
            begins[cells[k]] = here;
            at = bits >> k & 1u ? here : at;
            references[at] = entry->id;
        }
        return;
    }
    if (!(entry->mark & MARKED_LARGE)) {
        const uint across = box.more_x + 1;
        ulong left = bits;
        for (uint layer = box.first; left != 0; layer += box.layer)
            for (uint y = 0, row = layer; y <= box.more_y; ++y, row += box.row, left >>= across)
                for (uint own = (uint)(left & ((1ul << across) - 1ul)); own != 0; own &= own - 1)
                    references[--begins[row + lowest_of_32(own)]] = entry->id;
        return;
    }
    const Polygon triangle = whole_triangle(entry->vertices, entry->faces + 3 * (size_t)entry->id);
    const Planes planes = planes_of(part->grid, (uint4)(FINEST, FINEST, FINEST, 0) - part->finer);
    Side sides[5];
    int number = 0;
    for (uint row = 0; row < (box.more_y + 1) * (box.more_z + 1); ++row) {
        const int2 run = next_run(part, entry, &box, &triangle, &planes, sides, &number, row);
        const uint first = box.first + row % (box.more_y + 1) * box.row + row / (box.more_y + 1) * box.layer;
        for (int x = run.x; x <= run.y; ++x)
            references[--begins[first + (uint)x]] = entry->id;
    }
}

#endif
