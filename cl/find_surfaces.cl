// The surface that each ray has hit; pixels whose triangle is of another part, or that have none, are left as they are.
//   ids, weights    triangle of the mesh, weights of its second and third corner
//   positions       3 doubles: scene units, in the plane of the triangle
//   faced, shaded   3 doubles: unit normals of the triangle and of its vertices, both on the viewer's side
//   albedos         3 doubles      radiances  3 doubles: emission, and light from the eye
//   coordinates     2 floats: set 0
//   headlight       0 none, 1 times the albedo, 2 the grey of plain pictures (render.cl) whatever the material
#include "picture_rays.h"
#include "material.h"
#include "shade.h"

#define NO_HEADLIGHT 0u
#define PLAIN 2u

void store_vectors(const Vectors *v, uint lane, __global double *at)
{
    double x[4], y[4], z[4];
    vstore4(v->x, 0, x);
    vstore4(v->y, 0, y);
    vstore4(v->z, 0, z);
    at[0] = x[lane];
    at[1] = y[lane];
    at[2] = z[lane];
}

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void find_surfaces(__constant const FrameParams *frame, MESH_PARAMETERS, LOOK_PARAMETERS,
#ifdef SMOOTH_NORMALS
                            __global const float *vertex_normals,
#endif
                            uint count, uint headlight, __global const double *directions, __global const uint *ids,
                            __global const REAL *weights, __global double *positions, __global double *faced,
                            __global double *shaded, __global double *albedos, __global double *radiances,
                            __global float *coordinates)
{
    for (size_t first = first_pixel(); first < end_pixel(count); first += 4) {
        uint own[4];
        bool here[4];
        double view[3][4], u[4], v[4];
        for (uint lane = 0; lane < 4; ++lane) {
            const size_t i = min(first + lane, (size_t)count - 1);
            const uint id = ids[i] - first_triangle;
            here[lane] = first + lane < count && ids[i] != NO_HIT && id < triangle_count;
            own[lane] = here[lane] ? id : 0;  // triangle 0 stands in where there is none
            u[lane] = weights[2 * i];
            v[lane] = weights[2 * i + 1];
            for (int a = 0; a < 3; ++a)
                view[a][lane] = directions[3 * i + a];
        }
        if (!here[0] && !here[1] && !here[2] && !here[3])
            continue;
        const uint4 of_4 = vload4(0, own);
        Vectors views = {vload4(0, view[0]), vload4(0, view[1]), vload4(0, view[2])};
        const Facing facing = facing_of(vertices, faces, of_4);
        Vectors face = face_normals(&facing, &views);
        Vectors normal = face;
#ifdef SMOOTH_NORMALS
        normal = smooth_normals(vertex_normals, faces, of_4, vload4(0, u), vload4(0, v), face);
#endif
        float plain[4];
        vstore4(headlights(&normal, &views), 0, plain);  // of any lengths, as render.cl has them
        to_unit(&views);
        to_unit(&face);
        to_unit(&normal);
        double cosines[4];
        vstore4(fmax(-dot_of_4(&normal, &views), (double4)(0.0)), 0, cosines);
        for (uint lane = 0; lane < 4; ++lane) {
            if (!here[lane])
                continue;
            const size_t i = first + lane;
            const uint id = own[lane];
            const Corners corners = corners_of(id, MESH_ARGUMENTS);
            for (int a = 0; a < 3; ++a) {
                const double corner = corners.at[0][a];
                const double place = (corner + u[lane] * (corners.at[1][a] - corner))
                                     + v[lane] * (corners.at[2][a] - corner);
                positions[3 * i + a] = place * frame->inverse_scale + frame->offset[a];
            }
            store_vectors(&face, lane, faced + 3 * i);
            store_vectors(&normal, lane, shaded + 3 * i);
            const Colour base = base_at(id, u[lane], v[lane], faces, LOOK_ARGUMENTS);
            const Colour emission = emission_at(id, u[lane], v[lane], LOOK_ARGUMENTS);
            for (int c = 0; c < 3; ++c) {
                albedos[3 * i + c] = base.at[c];
                const double lit = headlight == NO_HEADLIGHT ? 0.0
                                                             : base.at[c] * (AMBIENT + (1.0 - AMBIENT) * cosines[lane]);
                radiances[3 * i + c] = headlight == PLAIN ? (double)plain[lane] : emission.at[c] + lit;
            }
            const Coordinates at = coordinates_at(id, u[lane], v[lane], 0, LOOK_ARGUMENTS);
            coordinates[2 * i] = (float)at.u;
            coordinates[2 * i + 1] = (float)at.v;
        }
    }
}
