// A picture of the grid's triangles: one work-item casts and shades the rays of a TILE x TILE square.
//   rgba     4 floats a pixel: linear colour, coverage            pixel (x, y) of the band of rows
//   depth    AOV_DEPTH: planar depth, scene units, inf on a miss  first_row .. first_row + row_count
//   normal   AOV_NORMAL: 3 floats, unit, on the viewer's side     is number (y - first_row) * width + x
//   ids      AOV_ID: triangle, 0xFFFFFFFF on a miss
//   steps    COUNT_STEPS: cells that the ray looked at
//   t_errs   WITH_T_ERR: bound on the error of t, in lengths of the ray, 0 on a miss
//   nearest  PARTS: the nearest hit in the parts before (parts.h); they left their pixels
#include "camera.h"
#include "shade.h"
#include "tile.h"
#ifdef PARTS
#include "parts.h"
#endif

#define TILE 8

// Groups of rays that are tested together are 4 x 2 pixels.
uint number_in_tile(uint x, uint y)
{
    return (y / 2 * 2 + x / 4) * LANES + y % 2 * 4 + x % 4;
}

// The rays of the pixels from (left, top) on.
void load_camera_rays(Tile *tile, __constant const CameraParams *camera, __constant const FrameParams *frame, uint left,
                      uint top)
{
    const double t_min[4] = {0.0, 0.0, 0.0, 0.0}, t_max[4] = {INFINITY, INFINITY, INFINITY, INFINITY};
    double eyes[3][4], views[3][4];
    for (int a = 0; a < 3; ++a)
        vstore4((double4)(camera->eye[a]), 0, eyes[a]);
    for (uint y = 0; y < TILE; ++y)
        for (uint x = 0; x < TILE; x += 4) {
            camera_directions(camera, left + x, top + y, views);
            set_rays(tile, number_in_tile(x, y), eyes, views, t_min, t_max, frame);
        }
}

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void render(__constant const CameraParams *camera, __constant const FrameParams *frame,
                     GRID_PARAMETERS, MESH_PARAMETERS, uint first_row, uint row_count,
                     float background_r, float background_g, float background_b,
#ifdef SMOOTH_NORMALS
                     __global const float *vertex_normals,
#endif
#ifdef AOV_DEPTH
                     __global float *depth,
#endif
#ifdef AOV_NORMAL
                     __global float *normals,
#endif
#ifdef AOV_ID
                     __global uint *ids,
#endif
#ifdef COUNT_STEPS
                     __global uint *steps,
#endif
#ifdef WITH_T_ERR
                     __global float *t_errs,
#endif
#ifdef PARTS
                     __global real *nearest,
#endif
                     __global float *rgba)
{
    const uint tiles_across = (camera->width + TILE - 1) / TILE;
    const uint left = get_global_id(0) % tiles_across * TILE, top = get_global_id(0) / tiles_across * TILE;
    const uint right = min(left + TILE, camera->width), bottom = min(top + TILE, row_count);
    Tile tile;
    start_tile(&tile, grid->triangle_count);
    load_camera_rays(&tile, camera, frame, left, first_row + top);
    ulong shown = 0;
    for (uint y = top; y < bottom; ++y)
        for (uint x = left; x < right; ++x) {
            const uint k = number_in_tile(x - left, y - top);
            shown |= 1ul << k;
#ifdef PARTS
            set_hit(&tile, k, bound_of(nearest + NEAREST_REALS * ((size_t)y * camera->width + x)));
#endif
        }
    tile.reach &= shown;
    cast_tile(&tile, GRID_ARGUMENTS, MESH_ARGUMENTS);
    for (uint y = top; y < bottom; ++y) {
        for (uint x = left; x < right; ++x) {
            double view[3];
            camera_direction(camera, x, first_row + y, view);
            const size_t pixel = (size_t)y * camera->width + x;
            const uint k = number_in_tile(x - left, y - top);
            const Hit hit = described_hit(&tile, k, MESH_ARGUMENTS);
#if defined(AOV_DEPTH)
            const Ray ray = ray_of(&tile, k);
#endif
#ifdef PARTS
            __global real *bound = nearest + NEAREST_REALS * pixel;
#endif
#ifdef COUNT_STEPS
            steps[pixel] += hit.steps;
#endif
#ifdef PARTS
            if (!is_nearer(&hit, bound))
                continue;
            store_nearest(&hit, bound);
#endif
            float r = background_r, g = background_g, b = background_b, coverage = 0.0f;
            double normal[3] = {0.0, 0.0, 0.0};
            if (hit.id != NO_HIT) {
                __global const uint *face = faces + 3 * (size_t)hit.id;
                to_unit(view);
                face_normal(vertices, face, view, normal);
#ifdef SMOOTH_NORMALS
                smooth_normal(vertex_normals, face, &hit, normal);
#endif
                r = g = b = headlight(normal, view);
                coverage = 1.0f;
            }
            rgba[4 * pixel] = r;
            rgba[4 * pixel + 1] = g;
            rgba[4 * pixel + 2] = b;
            rgba[4 * pixel + 3] = coverage;
#ifdef AOV_DEPTH
            depth[pixel] = hit.id == NO_HIT ? INFINITY : (float)reported_t(&ray, &hit.meeting);
#endif
#ifdef WITH_T_ERR
            t_errs[pixel] = hit.id == NO_HIT ? 0.0f : (float)(hit.t_err * (1.0 + 0x1p-22));  // not rounded down
#endif
#ifdef AOV_NORMAL
            for (int a = 0; a < 3; ++a)
                normals[3 * pixel + a] = (float)normal[a];
#endif
#ifdef AOV_ID
#ifdef PARTS
            ids[pixel] = grid->first_triangle + hit.id;
#else
            ids[pixel] = hit.id;
#endif
#endif
        }
    }
}
