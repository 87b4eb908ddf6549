// A picture of the grid's triangles: one work-item casts and shades the rays of a BLOCK x BLOCK square.
//   rgba     4 floats a pixel: linear colour, coverage            pixel (x, y) of the band of rows
//   depth    AOV_DEPTH: planar depth, scene units, inf on a miss  first_row .. first_row + row_count
//   normal   AOV_NORMAL: 3 floats, unit, on the viewer's side     is number (y - first_row) * width + x
//   ids      AOV_ID: triangle, 0xFFFFFFFF on a miss
//   steps    COUNT_STEPS: cells that the ray looked at
//   t_errs   WITH_T_ERR: bound on the error of t, in lengths of the ray, 0 on a miss
//   nearest  PARTS: the nearest hit in the parts before (parts.h); they left their pixels
#define TILES_ALONG 2
#define TILES_TOGETHER (TILES_ALONG * TILES_ALONG)

#include "tile.h"
#include "camera.h"
#ifdef RUNG_FAST
#ifndef ALONE
#include "camera_fast.h"
#endif
#include "shade_fast.h"
#else
#include "shade.h"
#include "weights.h"
#endif
#ifdef PARTS
#include "parts.h"
#endif

#if defined(__has_builtin)
#if __has_builtin(__builtin_nontemporal_store)
#define WRITES_PAST_CACHES 1  // numpy's arrays and devices' buffers lie at multiples of 16 bytes
#endif
#endif

#define TILE 8
#define BLOCK (TILES_ALONG * TILE)

// Groups of rays that are tested together are 4 x 2 pixels.
uint number_in_tile(uint x, uint y)
{
    return (y / 2 * 2 + x / 4) * LANES + y % 2 * 4 + x % 4;
}

// Bits: rays of a tile's pixels, which are those from (left, top) to before (right, bottom); it may have none.
ulong shown_of(uint left, uint top, uint right, uint bottom)
{
    if (right == left + TILE && bottom == top + TILE)
        return ~0ul;
    ulong shown = 0;
    for (uint y = top; y < bottom; ++y)
        for (uint x = left; x < right; ++x)
            shown |= 1ul << number_in_tile(x - left, y - top);
    return shown;
}

// Past the caches, where the compiler can: they hold the grid, and a picture is not read here.
void write_colour(float4 colour, size_t pixel, __global float *rgba)
{
#if WRITES_PAST_CACHES
    __builtin_nontemporal_store(colour, (__global float4 *)rgba + pixel);
#else
    vstore4(colour, pixel, rgba);
#endif
}

// The rays of the pixels from (left, top) on.
void load_camera_rays(Tile *tile, __constant const CameraParams *camera, __constant const FrameParams *frame, uint left,
                      uint top)
{
#if defined(RUNG_FAST) && !defined(ALONE)
    set_camera_rays(tile, camera, frame, left, top);
#else
    const double t_min[4] = {0.0, 0.0, 0.0, 0.0}, t_max[4] = {INFINITY, INFINITY, INFINITY, INFINITY};
    double eyes[3][4], views[3][4];
    for (int a = 0; a < 3; ++a)
        vstore4((double4)(camera->eye[a]), 0, eyes[a]);
    for (uint y = 0; y < TILE; ++y)
        for (uint x = 0; x < TILE; x += 4) {
            camera_directions(camera, left + x, top + y, views);
            set_rays(tile, number_in_tile(x, y), eyes, views, t_min, t_max, frame);
        }
#endif
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
    const float4 background = (float4)(background_r, background_g, background_b, 0.0f);
    const uint across = (camera->across + BLOCK - 1) / BLOCK;
    const uint block_x = get_global_id(0) % across * BLOCK, block_y = get_global_id(0) / across * BLOCK;
#ifndef ALONE
    Way way;
    const bool blank = way_of_pixels(camera, frame, grid, block_x, first_row + block_y,
                                     min(block_x + BLOCK, camera->across) - 1,
                                     first_row + min(block_y + BLOCK, row_count) - 1, &way)
                       && passes_nothing(&way, GRID_ARGUMENTS);
    if (blank) {
#ifndef PARTS  // which leave what the parts before have left
        const uint right = min(block_x + BLOCK, camera->across), bottom = min(block_y + BLOCK, row_count);
        for (uint y = block_y; y < bottom; ++y)
            for (uint x = block_x; x < right; ++x) {
                const size_t at = (size_t)y * camera->across + x;
                write_colour(background, at, rgba);
#ifdef AOV_DEPTH
                depth[at] = INFINITY;
#endif
#ifdef WITH_T_ERR
                t_errs[at] = 0.0f;
#endif
#ifdef AOV_NORMAL
                vstore3((float3)(0.0f), at, normals);
#endif
#ifdef AOV_ID
                ids[at] = NO_HIT;
#endif
            }
#endif
        return;
    }
#endif
    Tile tiles[TILES_TOGETHER];
    for (uint number = 0; number < TILES_TOGETHER; ++number) {
        Tile *tile = tiles + number;
        const uint left = block_x + number % TILES_ALONG * TILE, top = block_y + number / TILES_ALONG * TILE;
        const uint right = min(left + TILE, camera->across), bottom = min(top + TILE, row_count);
        start_tile(tile, frame, grid);
        if (left < right && top < bottom)
            load_camera_rays(tile, camera, frame, left, first_row + top);
        tile->reach &= shown_of(left, top, right, bottom);
#ifdef PARTS
        for (uint y = top; y < bottom; ++y)
            for (uint x = left; x < right; ++x)
                set_hit(tile, number_in_tile(x - left, y - top),
                        bound_of(nearest + NEAREST_REALS * ((size_t)y * camera->across + x)));
#endif
    }
    cast_tiles(tiles, TILES_TOGETHER, GRID_ARGUMENTS, MESH_ARGUMENTS);
#ifndef RUNG_FAST
    Facing facing;
    facing.ids = (uint4)(NO_HIT);
#endif
    for (uint number = 0; number < TILES_TOGETHER; ++number) {
        const Tile *tile = tiles + number;
        const uint left = block_x + number % TILES_ALONG * TILE, top = block_y + number / TILES_ALONG * TILE;
        const uint right = min(left + TILE, camera->across), bottom = min(top + TILE, row_count);
#ifdef RUNG_FAST
        Shaded shaded;
        shade_tile(tile, MESH_ARGUMENTS,
#ifdef SMOOTH_NORMALS
                   vertex_normals,
#endif
                   &shaded);
#endif
        for (uint y = top; y < bottom; ++y)
            for (uint x = left; x < right; x += 4) {
                const uint k = number_in_tile(x - left, y - top);
                const size_t pixel = (size_t)y * camera->across + x;
                const uint4 found = ids_of_4(tile, k);
                const int4 missed = found == NO_HIT;
#ifdef RUNG_FAST
                const float4 light = vload4(0, shaded.light + k);
#else
                Vectors normal = {(double4)(0.0), (double4)(0.0), (double4)(0.0)};
                float4 light = (float4)(0.0f);
                if (!all(missed)) {
                    double views[3][4];
                    camera_directions(camera, x, first_row + y, views);
                    const Vectors view = {vload4(0, views[0]), vload4(0, views[1]), vload4(0, views[2])};
                    // Triangle 0 stands in where there is none.
                    const uint4 ids_or_0 = missed ? (uint4)(0) : found;
                    // Next to each other, pixels mostly show the same triangles where these are large.
                    if (any(ids_or_0 != facing.ids))
                        facing = facing_of(vertices, faces, ids_or_0);
                    normal = face_normals(&facing, &view);
#ifdef SMOOTH_NORMALS
                    const Weights weights = weights_of_4(tile, k, ids_or_0, MESH_ARGUMENTS);
                    normal = smooth_normals(vertex_normals, faces, ids_or_0, weights.u, weights.v, normal);
#endif
                    light = headlights(&normal, &view);
#ifdef AOV_NORMAL
                    to_unit(&normal);
#endif
                }
#endif
                float lights[4];
                vstore4(light, 0, lights);
#ifdef AOV_NORMAL
                float x_of[4], y_of[4], z_of[4];
#ifdef RUNG_FAST
                vstore4(vload4(0, shaded.normal[0] + k), 0, x_of);
                vstore4(vload4(0, shaded.normal[1] + k), 0, y_of);
                vstore4(vload4(0, shaded.normal[2] + k), 0, z_of);
#else
                vstore4(convert_float4(normal.x), 0, x_of);
                vstore4(convert_float4(normal.y), 0, y_of);
                vstore4(convert_float4(normal.z), 0, z_of);
#endif
#endif
                for (uint i = 0; i < 4 && x + i < right; ++i) {
                    const Hit hit = hit_of(tile, k + i);
                    const size_t at = pixel + i;
#ifdef COUNT_STEPS
                    steps[at] += hit.steps;
#endif
#ifdef PARTS
                    __global real *bound = nearest + NEAREST_REALS * at;
                    if (!is_nearer(&hit, bound))
                        continue;
                    store_nearest(&hit, bound);
#endif
                    const bool lit = hit.id != NO_HIT;
                    write_colour(lit ? (float4)(lights[i], lights[i], lights[i], 1.0f) : background, at, rgba);
#ifdef AOV_DEPTH
                    const Ray ray = ray_of(tile, k + i);
                    depth[at] = lit ? (float)reported_t(&ray, &hit.meeting) : INFINITY;
#endif
#ifdef WITH_T_ERR
                    const double t_err = described_hit(tile, k + i, MESH_ARGUMENTS).t_err;
                    t_errs[at] = lit ? (float)(t_err * (1.0 + 0x1p-22)) : 0.0f;  // not rounded down
#endif
#ifdef AOV_NORMAL
                    normals[3 * at] = lit ? x_of[i] : 0.0f;
                    normals[3 * at + 1] = lit ? y_of[i] : 0.0f;
                    normals[3 * at + 2] = lit ? z_of[i] : 0.0f;
#endif
#ifdef AOV_ID
#ifdef PARTS
                    ids[at] = grid->first_triangle + hit.id;
#else
                    ids[at] = hit.id;
#endif
#endif
                }
            }
    }
}
