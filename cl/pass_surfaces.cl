// Whether rays pass the triangles that they meet: masked texels, and, if `sided`, backs of single-sided surfaces.
//   ids, weights        of each hit: triangle of the mesh, weights of its second and third corner
//   rays, directions    number of each hit's ray; 3 doubles a ray
//   passes              1 or 0; kept as it is where the triangle is of another part
#include "material.h"

#define HITS_PER_ITEM 64u

// Whether the direction is that of the winding's normal; local vertices will do.
bool from_behind(__global const float *vertices, __global const uint *face, __global const double *direction)
{
    double e[3], f[3];
    for (int a = 0; a < 3; ++a) {
        const double corner = vertices[3 * (size_t)face[0] + a];
        e[a] = (double)vertices[3 * (size_t)face[1] + a] - corner;
        f[a] = (double)vertices[3 * (size_t)face[2] + a] - corner;
    }
    const double x = e[1] * f[2] - e[2] * f[1], y = e[2] * f[0] - e[0] * f[2], z = e[0] * f[1] - e[1] * f[0];
    return (x * direction[0] + y * direction[1]) + z * direction[2] > 0.0;
}

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void pass_surfaces(MESH_PARAMETERS, LOOK_PARAMETERS, uint count, uint sided, __global const uint *ids,
                            __global const REAL *weights, __global const uint *rays,
                            __global const double *directions, __global uchar *passes)
{
    const size_t first = (size_t)get_global_id(0) * HITS_PER_ITEM;
    for (size_t i = first; i < min(first + HITS_PER_ITEM, (size_t)count); ++i) {
        const uint id = ids[i] - first_triangle;
        if (ids[i] == NO_HIT || id >= triangle_count)
            continue;
        __global const MaterialParams *material = materials + material_ids[id];
        bool passed = false;
        if (sided && !material->double_sided)
            passed = from_behind(vertices, faces + 3 * (size_t)id, directions + 3 * (size_t)rays[i]);
        if (!passed && material->masked)
            passed = base_at(id, weights[2 * i], weights[2 * i + 1], faces, LOOK_ARGUMENTS).at[3]
                     < material->alpha_cutoff;
        passes[i] = passed ? 1 : 0;
    }
}
