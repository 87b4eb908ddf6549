// The oracle: every triangle, in order, with the triangle test that the grid uses.
#ifndef CLG_BRUTE_FORCE_H
#define CLG_BRUTE_FORCE_H
#include "triangle.h"

Hit closest_of_all(const Ray *ray, uint triangle_count, __global const float *vertices,
                   __global const uint *faces)
{
    Hit hit = no_hit();
    if (!ray->reaches)
        return hit;
    const Shear shear = shear_of(ray);
    for (uint id = 0; id < triangle_count; ++id)
        keep_nearest(ray, &shear, vertices, faces, id, &hit);
    set_weights(&shear, vertices, faces, &hit);
    return hit;
}

#endif
