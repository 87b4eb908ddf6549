// The triangles that kernels read, in local units.
//   vertices        3 floats a vertex, and one to spare
//   faces           3 vertices a triangle
//   wide_vertices   WIDE_VERTICES: 3 doubles a vertex, where float32 does not hold them exactly
#ifndef CLG_MESH_H
#define CLG_MESH_H
#include "config.h"

#ifdef WIDE_VERTICES
#define MESH_PARAMETERS \
    __global const float *vertices, __global const uint *faces, __global const double *wide_vertices
#define MESH_ARGUMENTS vertices, faces, wide_vertices
#else
#define MESH_PARAMETERS __global const float *vertices, __global const uint *faces
#define MESH_ARGUMENTS vertices, faces
#endif

// The nine coordinates of a triangle, exactly.
typedef struct {
    double at[3][3];  // corner, axis
} Corners;

Corners corners_of(uint id, MESH_PARAMETERS)
{
    Corners corners;
    for (int i = 0; i < 3; ++i) {
        const size_t first = 3 * (size_t)faces[3 * (size_t)id + i];
        for (int a = 0; a < 3; ++a)
#ifdef WIDE_VERTICES
            corners.at[i][a] = wide_vertices[first + a];
#else
            corners.at[i][a] = vertices[first + a];
#endif
    }
    return corners;
}

#endif
