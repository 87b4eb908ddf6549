// The walk of a packet (after Amanatides & Woo 1987): eight rays in step, without branches. The t of the next
// planes are in fixed point: sums of integers are exact and take one cycle or two, where a float takes more.
//   RAYS_IN_STEP   rays that keep together, as those of neighbouring pixels; else one after another
// Distances over empty space are not used: in step, rays gain little by leaps.
#ifndef CLG_PACKET_WALK_H
#define CLG_PACKET_WALK_H
#include "lists.h"
#include "packet.h"

#define TICKS 0x1p28f          // of one local unit of t; a ray is inside the grid for at most 2 and a little
#define MOST_TICKS 0x3FFFFF00
#define SLACK_TICKS 2048       // how far to look on beyond a hit or the end: T_SLACK, and the rounding of the walk

#ifdef PARTS
PacketHit packet_bound(float nearest)
{
    PacketHit bound = no_packet_hit();
    bound.t = nearest;
    return bound;
}
#endif

// The nearest of a list that is not empty, for the rays in its cell.
void keep_nearest_of_list(const Lines *lines, uint rays, __global const float *vertices, __global const uint *faces,
                          List list, LIST_PARAMETERS, PacketHit *hits)
{
    while (list.count != 0) {
        uint ids[8];
        const uint count = take_ids(&list, LIST_ARGUMENTS, ids);
        keep_nearest_of_packet(lines, rays, vertices, faces, ids, count, hits);
    }
}

// One axis of the walk of eight rays.
typedef struct {
    int8 t, dt;    // ticks of the next plane, from plane to plane
    int8 stride;   // step in the array of cells
    int8 start;    // first cell
    int8 leaves;   // ticks at which the grid is left
} PacketAxis;

float8 ts_of(const PacketHit *h)
{
    return (float8)(h[0].t, h[1].t, h[2].t, h[3].t, h[4].t, h[5].t, h[6].t, h[7].t);
}

float8 from_halves(double4 lo, double4 hi)
{
    return (float8)(convert_float4(lo), convert_float4(hi));
}

// Axis a of rays that start at p; `stride` is from cell to cell along it.
PacketAxis start_axis(float8 p, float8 inverse, __constant const GridParams *grid, int a, int stride)
{
    const float lower = grid->lower_f[a], cell_size = (float)grid->cell_size[a];
    const int resolution = (int)grid->resolution[a];
    PacketAxis axis;
    const int8 climbs = inverse > 0.0f;
    axis.start = clamp(convert_int8((p - lower) * grid->cells_per_unit[a]), 0, resolution - 1);
    const float8 next = (lower + convert_float8(axis.start - climbs) * cell_size - p) * inverse;
    axis.t = convert_int8(clamp(next * TICKS, 0.0f, (float)MOST_TICKS));
    axis.dt = convert_int8(min(cell_size * fabs(inverse) * TICKS, (float)MOST_TICKS));
    axis.stride = select((int8)(-stride), (int8)(stride), climbs);
    const int8 ahead = select(axis.start, resolution - 1 - axis.start, climbs);
    const int8 fits = convert_float8(ahead) * convert_float8(axis.dt) < (float)MOST_TICKS;
    axis.leaves = axis.t + select((int8)(MOST_TICKS), ahead * axis.dt, fits);
    return axis;
}

// Eight rays in their first cells.
typedef struct {
    PacketAxis x, y, z;
    int8 cell, stop;  // ticks after which no hit can be nearer
    int8 alive;       // whether the ray is in the grid
} PacketWalk;

int8 ticks_of(float8 t)
{
    return convert_int8(min(t, 3.0f) * TICKS) + SLACK_TICKS;
}

#ifdef RAYS_IN_STEP
// All rays step at once, without branches, and share the tests of the cells that they share: for rays that keep
// together, as those of neighbouring pixels do.
void walk_in_step(PacketWalk w, const Lines *lines, PacketHit *hits, GRID_PARAMETERS, __global const float *vertices,
                  __global const uint *faces)
{
    uint cells_now[LANES], live[LANES], counts[LANES];
    ref_index begins[LANES];
    for (;;) {
        vstore8(as_uint8(w.cell), 0, cells_now);
        vstore8(as_uint8(w.alive), 0, live);
        uint full = 0;
#pragma unroll
        for (uint i = 0; i < LANES; ++i) {
            const List list = find_list(cells_now[i], grid, LIST_ARGUMENTS);
            begins[i] = list.begin;
            counts[i] = list.count & live[i];
            full |= counts[i];
#ifdef COUNT_STEPS
            hits[i].steps += live[i] & 1u;
#endif
        }
        if (full != 0) {
            for (uint i = 0; i < LANES; ++i) {
                if (counts[i] == 0)
                    continue;
                // The rays in this cell are tested together: its triangles are brought in once.
                const List list = {begins[i], counts[i]};
                uint here = 0;
                for (uint k = i; k < LANES; ++k) {
                    const uint same = cells_now[k] == cells_now[i] && counts[k] != 0 ? 1u : 0u;
                    here |= same << k;
                    counts[k] = same != 0 ? 0 : counts[k];
                }
                keep_nearest_of_list(lines, here, vertices, faces, list, LIST_ARGUMENTS, hits);
            }
            const float8 nearest = ts_of(hits);
            w.stop = min(w.stop, ticks_of(nearest));
        }
        const int8 xy = w.x.t < w.y.t, xz = w.x.t < w.z.t, yz = w.y.t < w.z.t;
        w.alive &= min(min(w.x.t, w.y.t), w.z.t) < w.stop;
        if (!any(w.alive))
            break;
        const int8 in_x = xy & xz & w.alive, in_y = ~xy & yz & w.alive, in_z = ~(xz | yz) & w.alive;
        w.x.t += w.x.dt & in_x;
        w.y.t += w.y.dt & in_y;
        w.z.t += w.z.dt & in_z;
        w.cell += (w.x.stride & in_x) + (w.y.stride & in_y) + (w.z.stride & in_z);
    }
}
#else
// One ray after another: for rays that have nothing in common.
void walk_in_turn(PacketWalk w, const Lines *lines, PacketHit *hits, GRID_PARAMETERS, __global const float *vertices,
                  __global const uint *faces)
{
    int t[3][LANES], dt[3][LANES], stride[3][LANES], cells_now[LANES], stops[LANES], alive[LANES];
    vstore8(w.x.t, 0, t[0]);
    vstore8(w.y.t, 0, t[1]);
    vstore8(w.z.t, 0, t[2]);
    vstore8(w.x.dt, 0, dt[0]);
    vstore8(w.y.dt, 0, dt[1]);
    vstore8(w.z.dt, 0, dt[2]);
    vstore8(w.x.stride, 0, stride[0]);
    vstore8(w.y.stride, 0, stride[1]);
    vstore8(w.z.stride, 0, stride[2]);
    vstore8(w.cell, 0, cells_now);
    vstore8(w.stop, 0, stops);
    vstore8(w.alive, 0, alive);
    for (uint i = 0; i < LANES; ++i) {
        if (alive[i] == 0)
            continue;
        int x = t[0][i], y = t[1][i], z = t[2][i], stop = stops[i];
        uint cell = (uint)cells_now[i];
        for (;;) {
#ifdef COUNT_STEPS
            ++hits[i].steps;
#endif
            const List list = find_list(cell, grid, LIST_ARGUMENTS);
            if (list.count != 0) {
                keep_nearest_of_list(lines, 1u << i, vertices, faces, list, LIST_ARGUMENTS, hits);
                stop = min(stop, (int)(min(hits[i].t, 3.0f) * TICKS) + SLACK_TICKS);
            }
            // Branches, since the next step can then begin before this one is known.
            if (x < y ? x < z : false) {
                if (x >= stop)
                    break;
                x += dt[0][i];
                cell += (uint)stride[0][i];
            } else if (y < z) {
                if (y >= stop)
                    break;
                y += dt[1][i];
                cell += (uint)stride[1][i];
            } else {
                if (z >= stop)
                    break;
                z += dt[2][i];
                cell += (uint)stride[2][i];
            }
        }
    }
}
#endif

// The nearest hit of each ray. `hits` are no_hit() or, with PARTS, bound_of() the nearest so far.
void cast_packet(const Packet *rays, PacketHit *hits, GRID_PARAMETERS, __global const float *vertices,
                  __global const uint *faces)
{
    float8 inverse[3], d[3];
    float8 t_in = rays->t_min, t_out = rays->t_max;
    for (int a = 0; a < 3; ++a) {
        // No component is 0: its planes are then too far to be met.
        d[a] = select(rays->direction[a], (float8)(0x1p-100f), fabs(rays->direction[a]) < 0x1p-100f);
        inverse[a] = 1.0f / d[a];
        const float8 o = from_halves(rays->origin[a][0], rays->origin[a][1]);
        const float8 t0 = (grid->lower_f[a] - o) * inverse[a], t1 = ((float)grid->upper[a] - o) * inverse[a];
        t_in = max(t_in, min(t0, t1));
        t_out = min(t_out, max(t0, t1));
    }
#ifdef PARTS
    t_out = min(t_out, ts_of(hits));
#endif
    int8 alive = t_in <= t_out;
    if (!any(alive))
        return;
    // Lanes without a ray in the grid stay in cell 0, and are never asked.
    t_in = select((float8)(0.0f), t_in, alive);

    // From here on, t counts from where the ray enters the grid.
    Lines lines;
    float8 p[3];
    for (int a = 0; a < 3; ++a) {
        const double4 lo = rays->origin[a][0] + convert_double4(t_in.lo) * convert_double4(d[a].lo);
        const double4 hi = rays->origin[a][1] + convert_double4(t_in.hi) * convert_double4(d[a].hi);
        p[a] = select((float8)(grid->lower_f[a]), from_halves(lo, hi), alive);
    }
    vstore8(p[0], 0, lines.ox);
    vstore8(p[1], 0, lines.oy);
    vstore8(p[2], 0, lines.oz);
    vstore8(d[0], 0, lines.dx);
    vstore8(d[1], 0, lines.dy);
    vstore8(d[2], 0, lines.dz);
    vstore8(rays->t_min - t_in, 0, lines.t_min);
    const int mx = (int)grid->resolution[0], my = (int)grid->resolution[1];
    const PacketAxis x = start_axis(p[0], inverse[0], grid, 0, 1);
    const PacketAxis y = start_axis(p[1], inverse[1], grid, 1, mx);
    const PacketAxis z = start_axis(p[2], inverse[2], grid, 2, mx * my);
    const int8 cell = (z.start * my + y.start) * mx + x.start;
    const float8 length = select((float8)(0.0f), t_out - t_in, alive);
    const int8 leaves = min(min(x.leaves, y.leaves), z.leaves);
    const int8 stop = min(leaves, ticks_of(length));
    float starts[LANES], ends[LANES];
    vstore8(t_in, 0, starts);
    vstore8(min(rays->t_max - t_in, 0x1p+100f), 0, ends);
    for (uint i = 0; i < LANES; ++i)
        hits[i].t = min(hits[i].t - starts[i], ends[i]);

    const PacketWalk walk = {x, y, z, cell, stop, alive};
#ifdef RAYS_IN_STEP
    walk_in_step(walk, &lines, hits, GRID_ARGUMENTS, vertices, faces);
#else
    walk_in_turn(walk, &lines, hits, GRID_ARGUMENTS, vertices, faces);
#endif
    for (uint i = 0; i < LANES; ++i) {
#ifdef WITH_UVS
        set_packet_weights(&lines, i, vertices, faces, &hits[i]);
#endif
        hits[i].t = hits[i].id == NO_HIT ? INFINITY : hits[i].t + starts[i];
    }
}

#endif
