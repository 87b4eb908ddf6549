// The paper's plain shading: a headlight at the eye on a grey surface. Written out in float64 with
// + - * / sqrt alone, which round alike everywhere, so that pictures are the same bits on all devices.
#ifndef CLG_SHADE_H
#define CLG_SHADE_H
#include "light.h"
#include "triangle.h"

double dot3(const double *a, const double *b)
{
    return (a[0] * b[0] + a[1] * b[1]) + a[2] * b[2];
}

// Scales v to length 1. False: v has no direction (zero, NaN, or beyond what a square can hold).
bool to_unit(double *v)
{
    const double square = dot3(v, v);
    if (!(square > 0.0 && square < INFINITY))
        return false;
    const double length = sqrt(square);
    for (int a = 0; a < 3; ++a)
        v[a] = v[a] / length;
    return true;
}

void flip(double *v)
{
    for (int a = 0; a < 3; ++a)
        v[a] = -v[a];
}

// Unit normal of the triangle on the viewer's side. The local frame keeps directions, so local
// vertices will do. `view` is the unit direction of the ray.
void face_normal(__global const float *vertices, __global const uint *face, const double *view, double *normal)
{
    double e[3], f[3];
    for (int a = 0; a < 3; ++a) {
        const double corner = vertices[3 * (size_t)face[0] + a];
        e[a] = (double)vertices[3 * (size_t)face[1] + a] - corner;
        f[a] = (double)vertices[3 * (size_t)face[2] + a] - corner;
    }
    normal[0] = e[1] * f[2] - e[2] * f[1];
    normal[1] = e[2] * f[0] - e[0] * f[2];
    normal[2] = e[0] * f[1] - e[1] * f[0];
    if (!to_unit(normal)) {
        for (int a = 0; a < 3; ++a)
            normal[a] = -view[a];
    } else if (dot3(normal, view) > 0.0) {
        flip(normal);
    }
}

// Replaces the face normal by the one interpolated from the vertices, turned to the same side. A
// vertex without a normal (a zero row) takes the face's.
void smooth_normal(__global const float *vertex_normals, __global const uint *face, const Hit *hit, double *normal)
{
    const double weights[3] = {(1.0 - (double)hit->u) - (double)hit->v, hit->u, hit->v};
    double sum[3] = {0.0, 0.0, 0.0};
    double without = 0.0;
    for (int k = 0; k < 3; ++k) {
        double n[3];
        for (int a = 0; a < 3; ++a)
            n[a] = vertex_normals[3 * (size_t)face[k] + a];
        if (to_unit(n)) {
            for (int a = 0; a < 3; ++a)
                sum[a] = sum[a] + weights[k] * n[a];
        } else {
            without = without + weights[k];
        }
    }
    if (dot3(sum, normal) < 0.0)
        flip(sum);
    for (int a = 0; a < 3; ++a)
        sum[a] = sum[a] + without * normal[a];
    if (to_unit(sum)) {
        for (int a = 0; a < 3; ++a)
            normal[a] = sum[a];
    }
}

// Light sent back to the eye: the facing ratio above the ambient share.
float headlight(const double *normal, const double *view)
{
    const double facing = -dot3(normal, view);
    const double lit = facing > 0.0 ? facing : 0.0;
    return (float)(ALBEDO * (AMBIENT + (1.0 - AMBIENT) * lit));
}

#endif
