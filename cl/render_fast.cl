// Rung `fast`: the picture of render.cl, by packets of the eight pixels of a tile's row.
// Arguments are those of render.cl.
#define RAYS_IN_STEP
#include "camera.h"
#include "packet_walk.h"
#include "shade_fast.h"

#define TILE 8

// The rays of pixels x .. x + 7 of a row, those before `end`.
void camera_rays(__constant const CameraParams *camera, __constant const FrameParams *frame, uint x, uint end, uint y,
                 Packet *rays)
{
    const double down = ((double)y + 0.5) - 0.5 * (double)camera->height;
    const float8 lane = (float8)(0.0f, 1.0f, 2.0f, 3.0f, 4.0f, 5.0f, 6.0f, 7.0f);
    const float8 right = lane + (float)(((double)x + 0.5) - 0.5 * (double)camera->width);
    float8 d[3];
    for (int a = 0; a < 3; ++a) {
        d[a] = (float)(camera->forward[a] + down * camera->step_y[a]) + right * (float)camera->step_x[a];
        const double eye = (camera->eye[a] - frame->offset[a]) * frame->scale;
        rays->origin[a][0] = rays->origin[a][1] = (double4)(eye);
    }
    const float8 t_max = select((float8)(-1.0f), (float8)(INFINITY), lane < (float)(end - x));
    set_directions(rays, d[0], d[1], d[2], (float8)(0.0f), t_max, (float)frame->inverse_scale);
}

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void render_fast(__constant const CameraParams *camera, __constant const FrameParams *frame,
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
#ifdef PARTS
                          __global float *nearest,
#endif
                          __global float *rgba)
{
    const uint tiles_across = (camera->width + TILE - 1) / TILE;
    const uint left = get_global_id(0) % tiles_across * TILE, top = get_global_id(0) / tiles_across * TILE;
    const uint right = min(left + TILE, camera->width), bottom = min(top + TILE, row_count);
    for (uint y = top; y < bottom; ++y) {
        Packet rays;
        camera_rays(camera, frame, left, right, first_row + y, &rays);
        const size_t first_pixel = (size_t)y * camera->width + left;
        PacketHit hits[LANES];
        for (uint lane = 0; lane < LANES; ++lane)
#ifdef PARTS
            hits[lane] = packet_bound(nearest[first_pixel + min(lane, right - left - 1)]);
#else
            hits[lane] = no_packet_hit();
#endif
        cast_packet(&rays, hits, GRID_ARGUMENTS, vertices, faces);
        float dx[LANES], dy[LANES], dz[LANES], lengths[LANES];
        vstore8(rays.direction[0], 0, dx);
        vstore8(rays.direction[1], 0, dy);
        vstore8(rays.direction[2], 0, dz);
        vstore8(rays.unit * (float)frame->inverse_scale, 0, lengths);
        for (uint lane = 0; lane < right - left; ++lane) {
            const size_t pixel = first_pixel + lane;
            const PacketHit hit = hits[lane];
#ifdef COUNT_STEPS
            steps[pixel] += hit.steps;
#endif
#ifdef PARTS
            if (!(hit.t < nearest[pixel]))
                continue;
            nearest[pixel] = hit.t;
#endif
            float4 colour = (float4)(background_r, background_g, background_b, 0.0f), normal = (float4)(0.0f);
            if (hit.id != NO_HIT) {
                __global const uint *face = faces + 3 * (size_t)hit.id;
                const float4 view = unit_of((float4)(dx[lane], dy[lane], dz[lane], 0.0f));
                normal = face_normal(vertices, face, view);
#ifdef SMOOTH_NORMALS
                normal = smooth_normal(vertex_normals, face, &hit, normal);
#endif
                colour = (float4)((float3)(headlight(normal, view)), 1.0f);
            }
            vstore4(colour, pixel, rgba);
#ifdef AOV_DEPTH
            depth[pixel] = hit.id == NO_HIT ? INFINITY : hit.t * lengths[lane];
#endif
#ifdef AOV_NORMAL
            vstore3(normal.xyz, pixel, normals);
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
