// Which cells of its box a large triangle touches, row by row: the triangle is cut by the planes of a layer
// of cells, and the convex piece by those of a row, all BOX_PAD apart from the cells' own, so that every
// cell nearer to the triangle than that is found (docs/numerics.md, "Insertion"). In float64: planes and
// crossings are off by far less than BOX_PAD exceeds HIT_ERROR.
#ifndef CLG_CLIP_H
#define CLG_CLIP_H
#include "raster.h"

bool worth_clipping(uint4 extent)
{
    // Along one axis alone, a triangle touches every cell of its box.
    const uint long_axes = (extent.x > 1u) + (extent.y > 1u) + (extent.z > 1u);
    return long_axes > 1u && (ulong)extent.x * extent.y * extent.z > CLIP_CELLS;
}

typedef struct {
    double x[5], y[5], z[5];
    int count;
} Polygon;

// The planes of a grid, and per_unit = 1 / size[0].
typedef struct {
    double lower[3], size[3], per_unit, slack;
} Planes;

// x / 2^n, without a division.
double halved(double x, uint n)
{
    return x * as_double((ulong)(1023u - n) << 52);
}

// Those of a grid whose cells are 2^finer times as small.
Planes planes_of(__constant const GridParams *grid, uint4 finer)
{
    const uint halvings[3] = {finer.x, finer.y, finer.z};
    Planes p;
    for (int a = 0; a < 3; ++a) {
        p.lower[a] = grid->lower[a];
        p.size[a] = halved(grid->cell_size[a], halvings[a]);
    }
    p.per_unit = 1.0 / p.size[0];
    // A point on a plane belongs to the cells on both sides, wherever rounding puts it.
    p.slack = 0x1p-48 * ((double)grid->resolution[0] * (double)(1u << finer.x));
    return p;
}

// One side of a layer's piece: x over y, from low to high.
typedef struct {
    double low, high, x_low, slope;
} Side;

Polygon whole_triangle(__global const float *vertices, __global const uint *face)
{
    Polygon p;
    for (int i = 0; i < 3; ++i) {
        __global const float *v = vertices + 3 * (size_t)face[i];
        p.x[i] = v[0];
        p.y[i] = v[1];
        p.z[i] = v[2];
    }
    p.count = 3;
    return p;
}

// The part where sign * (z - plane) <= 0 (Sutherland & Hodgman 1974).
Polygon cut(const Polygon *p, double plane, double sign)
{
    Polygon kept;
    kept.count = 0;
    for (int i = 0; i < p->count; ++i) {
        const int j = i + 1 < p->count ? i + 1 : 0;
        const double here = sign * (p->z[i] - plane), there = sign * (p->z[j] - plane);
        if (here <= 0.0) {
            kept.x[kept.count] = p->x[i];
            kept.y[kept.count] = p->y[i];
            kept.z[kept.count++] = p->z[i];
        }
        if ((here < 0.0 && there > 0.0) || (here > 0.0 && there < 0.0)) {
            const double s = here / (here - there);
            kept.x[kept.count] = p->x[i] + s * (p->x[j] - p->x[i]);
            kept.y[kept.count] = p->y[i] + s * (p->y[j] - p->y[i]);
            kept.z[kept.count++] = plane;
        }
    }
    return kept;
}

// The sides of what is left of the triangle in a layer of cells; returns their number.
int cut_layer(const Planes *planes, const Polygon *triangle, int layer, Side *sides)
{
    const double low = planes->lower[2] + layer * planes->size[2] - BOX_PAD;
    const double high = planes->lower[2] + (layer + 1) * planes->size[2] + BOX_PAD;
    const Polygon above = cut(triangle, low, -1.0);
    const Polygon piece = cut(&above, high, 1.0);
    for (int i = 0; i < piece.count; ++i) {
        const int j = i + 1 < piece.count ? i + 1 : 0;
        const bool climbs = piece.y[i] <= piece.y[j];
        const int lower = climbs ? i : j, upper = climbs ? j : i;
        const double rise = piece.y[upper] - piece.y[lower];
        sides[i].low = piece.y[lower];
        sides[i].high = piece.y[upper];
        sides[i].x_low = piece.x[lower];
        // A level side adds one end; its neighbours add the other.
        sides[i].slope = rise > 0.0 ? (piece.x[upper] - piece.x[lower]) / rise : 0.0;
    }
    return piece.count;
}

// First and last cell of a row of the layer that the piece touches, within [first, last]; (1, 0) if none.
int2 row_run(const Planes *planes, const Side *sides, int count, int row, int first, int last)
{
    const double low = planes->lower[1] + row * planes->size[1] - BOX_PAD;
    const double high = planes->lower[1] + (row + 1) * planes->size[1] + BOX_PAD;
    double least = INFINITY, most = -INFINITY;
    for (int i = 0; i < count; ++i) {
        const Side side = sides[i];
        if (side.low <= high && side.high >= low) {
            const double x0 = side.x_low + (side.low > low ? 0.0 : low - side.low) * side.slope;
            const double x1 = side.x_low + ((side.high < high ? side.high : high) - side.low) * side.slope;
            least = x0 < least ? x0 : least;
            least = x1 < least ? x1 : least;
            most = x0 > most ? x0 : most;
            most = x1 > most ? x1 : most;
        }
    }
    const double from = (least - BOX_PAD - planes->lower[0]) * planes->per_unit - planes->slack;
    const double to = (most + BOX_PAD - planes->lower[0]) * planes->per_unit + planes->slack;
    if (!(from < (double)(last + 1) && to >= (double)first && least <= most))
        return (int2)(1, 0);
    return (int2)(from > (double)first ? (int)from : first, to < (double)last ? (int)to : last);
}

#endif
