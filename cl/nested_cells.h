// The cells of a nested grid that a triangle is entered in: of the top grid those that its padded box touches, or for a
// large one that it touches itself; and where one has a subgrid, of that in the same way. Whoever includes
// this has defined Visitor and visit_run(Visitor *, first cell, end), which takes up cells that have no subgrid.
#ifndef CLG_NESTED_CELLS_H
#define CLG_NESTED_CELLS_H
#include "clip.h"
#include "subgrid.h"

// The top grid and its subgrids while they are built.
typedef struct {
    __constant const GridParams *grid;
    __global const Subgrid *subgrids;
    __global const uint *children;   // number of a cell's subgrid, plus one
    uint parents;                    // cells that may have one: those with lower numbers
    __global const float *vertices;
} Nest;

// A grid of the nest: its first cell, in cells of its size from the lower corner; how many it has; and its number.
typedef struct {
    int4 first, cells;
    uint4 finer;                     // halvings that make the finest
    uint number;
} Part;

Part whole_part(__constant const GridParams *grid)
{
    const int4 cells = {(int)grid->resolution[0], (int)grid->resolution[1], (int)grid->resolution[2], 1};
    const Part part = {(int4)(0), cells, (uint4)(FINEST, FINEST, FINEST, 0), 0};
    return part;
}

Part part_of_subgrid(__global const Subgrid *s)
{
    const Part part = {(int4)(s->first[0], s->first[1], s->first[2], 0),
                       (int4)(1 << halvings_of(s, 0), 1 << halvings_of(s, 1), 1 << halvings_of(s, 2), 1),
                       (uint4)(finer_than(s, 0), finer_than(s, 1), finer_than(s, 2), 0), s->first_cell};
    return part;
}

// The finest cells that the padded box of a triangle touches, as cell_range finds cells.
CellRange finest_range(__constant const GridParams *grid, float4 low, float4 high)
{
    const float finest = (float)(1 << FINEST);
    const float4 pad = (float4)((float)BOX_PAD);
    const float4 lower = (float4)(grid->lower_f[0], grid->lower_f[1], grid->lower_f[2], 0.0f);
    const float4 scale =
        finest * (float4)(grid->cells_per_unit[0], grid->cells_per_unit[1], grid->cells_per_unit[2], 0.0f);
    const int4 cells = (int4)((int)grid->resolution[0], (int)grid->resolution[1], (int)grid->resolution[2], 1);
    const int4 highest = (cells << FINEST) - 1;
    CellRange range;
    range.first = min(max(convert_int4((low - pad - lower) * scale), (int4)(0)), highest);
    range.last = min(max(convert_int4((high + pad - lower) * scale), (int4)(0)), highest);
    return range;
}

// Fewer cells of a box than these are all taken; up to CLIP_CELLS, those that the triangle may touch.
#ifndef FEWEST_HELD
#define FEWEST_HELD 4u
#endif

// What a cell that is widened by BOX_PAD and touches a triangle fulfils, as functions of its middle: the first is at
// most `reach` to either side, which holds the triangle's plane, the others on one, which hold its edges as
// seen along the axis that the plane faces (Schwarz and Seidel 2010). In cells of a part of the nest.
typedef struct {
    double4 x, y, z, at, reach;
} Facet;

Facet facet_of(const Nest *nest, const Part *part, __global const uint *face)
{
    const Polygon t = whole_triangle(nest->vertices, face);
    const double3 a = (double3)(t.x[0], t.y[0], t.z[0]), b = (double3)(t.x[1], t.y[1], t.z[1]);
    const double3 c = (double3)(t.x[2], t.y[2], t.z[2]);
    const double3 e = b - a, f = c - a, g = c - b;
    const double3 n = e.yzx * f.zxy - e.zxy * f.yzx;
    const double3 facing = fabs(n);
    // Normals of the edges in the plane across that axis, outwards.
    const double along_x = facing.x >= facing.y && facing.x >= facing.z ? (n.x < 0.0 ? -1.0 : 1.0) : 0.0;
    const double along_y = along_x == 0.0 && facing.y >= facing.z ? (n.y < 0.0 ? -1.0 : 1.0) : 0.0;
    const double along_z = along_x == 0.0 && along_y == 0.0 ? (n.z < 0.0 ? -1.0 : 1.0) : 0.0;
    const double4 nx = (double4)(n.x, e.y * along_z - e.z * along_y, g.y * along_z - g.z * along_y, f.z * along_y - f.y * along_z);
    const double4 ny = (double4)(n.y, e.z * along_x - e.x * along_z, g.z * along_x - g.x * along_z, f.x * along_z - f.z * along_x);
    const double4 nz = (double4)(n.z, e.x * along_y - e.y * along_x, g.x * along_y - g.y * along_x, f.y * along_x - f.x * along_y);
    const Planes p = planes_of(nest->grid, (uint4)(FINEST, FINEST, FINEST, 0) - part->finer);
    Facet h;
    h.x = nx * p.size[0];
    h.y = ny * p.size[1];
    h.z = nz * p.size[2];
    h.at = nx * (p.lower[0] - (double4)(a.x, a.x, b.x, c.x)) + ny * (p.lower[1] - (double4)(a.y, a.y, b.y, c.y))
           + nz * (p.lower[2] - (double4)(a.z, a.z, b.z, c.z)) + h.x * (part->first.x + 0.5)
           + h.y * (part->first.y + 0.5) + h.z * (part->first.z + 0.5);
    h.reach = 0.5 * (fabs(h.x) + fabs(h.y) + fabs(h.z)) + BOX_PAD * (fabs(nx) + fabs(ny) + fabs(nz)) + FACET_SLACK;
    return h;
}

bool may_touch(const Facet *facet, int x, int y, int z)
{
    const double4 v = facet->at + facet->x * x + facet->y * y + facet->z * z;
    return fabs(v.x) <= facet->reach.x && v.y <= facet->reach.y && v.z <= facet->reach.z && v.w <= facet->reach.w;
}

// Three levels in all.
#define LEVEL leaf
#include "nested_level.h"
#define LEVEL middle
#define LEVEL_BELOW visit_part_leaf
#include "nested_level.h"
#define LEVEL top
#define LEVEL_BELOW visit_part_middle
#include "nested_level.h"

// Takes up all cells of a triangle.
void visit_cells(const Nest *nest, __global const uint *face, Visitor *visitor)
{
    const float4 a = load_vertex(nest->vertices, face[0]);
    const float4 b = load_vertex(nest->vertices, face[1]);
    const float4 c = load_vertex(nest->vertices, face[2]);
    const CellRange range = finest_range(nest->grid, min(min(a, b), c), max(max(a, b), c));
    const Part top = whole_part(nest->grid);
    visit_part_top(nest, &top, face, &range, visitor);
}

#endif
