// The shading of shade.h in float32, four lanes at a time, for the rung `fast`.
#ifndef CLG_SHADE_FAST_H
#define CLG_SHADE_FAST_H
#include "packet.h"
#include "light.h"

float dot4(float4 a, float4 b)
{
    const float4 p = a * b;
    return p.x + p.y + p.z;
}

float4 cross4(float4 a, float4 b)
{
    return a.yzxw * b.zxyw - a.zxyw * b.yzxw;
}

float4 unit_of(float4 v)
{
    return v / sqrt(dot4(v, v));
}

// Unit normal on the viewer's side; `view` is the unit direction of the ray.
float4 face_normal(__global const float *vertices, __global const uint *face, float4 view)
{
    const float4 a = load_vertex(vertices, face[0]);
    const float4 n = cross4(load_vertex(vertices, face[1]) - a, load_vertex(vertices, face[2]) - a);
    const float square = dot4(n, n);
    // Scaled first where its square would leave the range of normal floats.
    const float4 unit = square > 0x1p-100f ? n / sqrt(square) : unit_of(n * 0x1p+60f);
    return square == 0.0f ? -view : dot4(unit, view) > 0.0f ? -unit : unit;
}

// The normal interpolated from the vertices, on the same side; a vertex without one takes the face's.
float4 smooth_normal(__global const float *vertex_normals, __global const uint *face, const PacketHit *hit, float4 normal)
{
    const float weights[3] = {1.0f - hit->u - hit->v, hit->u, hit->v};
    float4 sum = (float4)(0.0f);
    float without = 0.0f;
    for (int k = 0; k < 3; ++k) {
        const float4 n = (float4)(vload3(face[k], vertex_normals), 0.0f);
        const float square = dot4(n, n);
        if (square > 0.0f)
            sum += weights[k] / sqrt(square) * n;
        else
            without += weights[k];
    }
    sum = (dot4(sum, normal) < 0.0f ? -sum : sum) + without * normal;
    return dot4(sum, sum) > 0.0f ? unit_of(sum) : normal;
}

float headlight(float4 normal, float4 view)
{
    return (float)ALBEDO * ((float)AMBIENT + (1.0f - (float)AMBIENT) * max(-dot4(normal, view), 0.0f));
}

#endif
