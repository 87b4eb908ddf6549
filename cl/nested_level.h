// One level of nested_cells.h, which includes this once a level, since a kernel cannot call itself:
//   LEVEL         its functions' names end with this
//   LEVEL_BELOW   visits the subgrids of its cells, if there are any
#define NAME_OF_LEVEL(name, level) name##_##level
#define OF_LEVEL(name, level) NAME_OF_LEVEL(name, level)

// Takes up consecutive cells, or what their subgrids hold of the triangle.
void OF_LEVEL(visit_row, LEVEL)(const Nest *nest, __global const uint *face, const CellRange *finest, uint first,
                                uint end, Visitor *visitor)
{
#ifdef LEVEL_BELOW
    if (first < nest->parents) {
        for (uint cell = first; cell < end; ++cell) {
            const uint child = nest->children[cell];
            if (child == 0) {
                visit_run(visitor, cell, cell + 1);
            } else {
                const Part inner = part_of_subgrid(nest->subgrids + (child - 1));
                LEVEL_BELOW(nest, &inner, face, finest, visitor);
            }
        }
        return;
    }
#endif
    visit_run(visitor, first, end);
}

// Takes up the cells of a large box that the triangle touches.
void OF_LEVEL(visit_touched, LEVEL)(const Nest *nest, const Part *part, __global const uint *face,
                                    const CellRange *finest, int4 low, int4 high, Visitor *visitor)
{
    const Polygon triangle = whole_triangle(nest->vertices, face);
    const Planes planes = planes_of(nest->grid, (uint4)(FINEST, FINEST, FINEST, 0) - part->finer);
    for (int z = low.z; z <= high.z; ++z) {
        Side sides[5];
        const int number = cut_layer(&planes, &triangle, part->first.z + z, sides);
        for (int y = low.y; y <= high.y; ++y) {
            const int2 run = row_run(&planes, sides, number, part->first.y + y, part->first.x + low.x,
                                     part->first.x + high.x) - part->first.x;
            const uint row = part->number + (uint)((z * part->cells.y + y) * part->cells.x);
            if (run.x <= run.y)
                OF_LEVEL(visit_row, LEVEL)(nest, face, finest, row + (uint)run.x, row + (uint)run.y + 1, visitor);
        }
    }
}

// Takes up the cells of a part of the nest that a triangle is entered in.
void OF_LEVEL(visit_part, LEVEL)(const Nest *nest, const Part *part, __global const uint *face,
                                 const CellRange *finest, Visitor *visitor)
{
    const int4 shift = as_int4(part->finer);
    const int4 low = max((finest->first >> shift) - part->first, (int4)(0));
    const int4 high = min((finest->last >> shift) - part->first, part->cells - 1);
    const uint4 extent = as_uint4(high - low + 1);
    if (worth_clipping(extent)) {
        OF_LEVEL(visit_touched, LEVEL)(nest, part, face, finest, low, high, visitor);
        return;
    }
    const bool held = extent.x * extent.y * extent.z >= FEWEST_HELD;
    Facet facet;
    if (held)
        facet = facet_of(nest, part, face);
    for (int z = low.z; z <= high.z; ++z)
        for (int y = low.y; y <= high.y; ++y) {
            const uint row = part->number + (uint)((z * part->cells.y + y) * part->cells.x);
            if (!held) {
                OF_LEVEL(visit_row, LEVEL)(nest, face, finest, row + (uint)low.x, row + (uint)high.x + 1, visitor);
                continue;
            }
            for (int x = low.x; x <= high.x; ++x)
                if (may_touch(&facet, x, y, z))
                    OF_LEVEL(visit_row, LEVEL)(nest, face, finest, row + (uint)x, row + (uint)x + 1, visitor);
        }
}
#undef LEVEL
#undef LEVEL_BELOW
#undef NAME_OF_LEVEL
#undef OF_LEVEL
