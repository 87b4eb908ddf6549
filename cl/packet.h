// Rung `fast`: eight rays side by side, float32 but for the origins, so that a distant eye keeps its digits until
// the rays are in the grid; and the test of Moeller & Trumbore of up to eight triangles for those in one cell.
#ifndef CLG_PACKET_H
#define CLG_PACKET_H
#include "triangle_fast.h"

#define LANES 8  // a lane without a ray has t_max < t_min

typedef struct {
    double4 origin[3][2];  // local; x, y, z of lanes 0-3 and 4-7
    float8 direction[3];   // local, the largest component within [1, 2)
    float8 t_min, t_max;   // local units of t
    float8 unit;           // local directions are the given ones times this
} Packet;

// Sets all but the origins; t_min and t_max are scene units. Gives the lanes that hold a ray.
int8 set_directions(Packet *rays, float8 x, float8 y, float8 z, float8 t_min, float8 t_max, float inverse_scale)
{
    const float8 longest = max(max(fabs(x), fabs(y)), fabs(z));
    // 2^-e of longest = 2^e * [1, 2), by its bits; beyond 2^+-120 there is no ray.
    const float8 unit = as_float8(0x7F000000u - (as_uint8(longest) & 0x7F800000u));
    const int8 valid = (longest >= 0x1p-120f) & (longest <= 0x1p+120f) & (t_min == t_min) & (t_max == t_max);
    rays->direction[0] = x * unit;
    rays->direction[1] = y * unit;
    rays->direction[2] = z * unit;
    rays->unit = unit;
    const float8 local_t = 1.0f / (unit * inverse_scale);
    rays->t_min = select((float8)(1.0f), t_min * local_t, valid);
    rays->t_max = select((float8)(0.0f), t_max * local_t, valid);
    return valid;
}

typedef struct {
    float t;
    uint id;    // NO_HIT on a miss
    float u, v; // barycentric weights of the second and third vertex
#ifdef COUNT_STEPS
    uint steps, tests, batches;
#endif
} PacketHit;

PacketHit no_packet_hit(void)
{
#ifdef COUNT_STEPS
    const PacketHit miss = {INFINITY, NO_HIT, 0.0f, 0.0f, 0u, 0u, 0u};
#else
    const PacketHit miss = {INFINITY, NO_HIT, 0.0f, 0.0f};
#endif
    return miss;
}

// The rays as the test sees them, one a lane: t counts from an origin near the mesh.
typedef struct {
    float ox[LANES], oy[LANES], oz[LANES], dx[LANES], dy[LANES], dz[LANES], t_min[LANES];
} Lines;

uint lowest_lane(uint bits)
{
    return 31u - clz(bits & (0u - bits));
}

// The nearest of 1 to 8 triangles becomes the hit of each ray whose bit is set in `rays`, if it is nearer. A
// shorter list is filled up with its last.
__attribute__((noinline))
void keep_nearest_of_packet(const Lines *lines, uint rays, __global const float *vertices,
                            __global const uint *faces, const uint *ids, uint count, PacketHit *hits)
{
    const Corners8 corners = gather_corners(vertices, faces, ids, count);
    const Points a = corners.a, b = corners.b, c = corners.c;
    const uint last = count - 1;
    const float8 ex = b.x - a.x, ey = b.y - a.y, ez = b.z - a.z;
    const float8 fx = c.x - a.x, fy = c.y - a.y, fz = c.z - a.z;
    for (uint left = rays; left != 0; left &= left - 1) {
        const uint ray = lowest_lane(left);
        PacketHit *hit = hits + ray;
#ifdef COUNT_STEPS
        hit->tests += count;
        ++hit->batches;
#endif
        const float dx = lines->dx[ray], dy = lines->dy[ray], dz = lines->dz[ray];
        const float8 sx = lines->ox[ray] - a.x, sy = lines->oy[ray] - a.y, sz = lines->oz[ray] - a.z;
        const float8 px = dy * fz - dz * fy, py = dz * fx - dx * fz, pz = dx * fy - dy * fx;
        const float8 qx = sy * ez - sz * ey, qy = sz * ex - sx * ez, qz = sx * ey - sy * ex;
        const float8 inverse = 1.0f / (ex * px + ey * py + ez * pz);
        const float8 u = (sx * px + sy * py + sz * pz) * inverse;
        const float8 v = (dx * qx + dy * qy + dz * qz) * inverse;
        const float8 t = (fx * qx + fy * qy + fz * qz) * inverse;
        const int8 inside = are_inside(u, v) & (t >= lines->t_min[ray]);
        const float8 at = select((float8)INFINITY, t, inside);
        const float4 at4 = at.lo < at.hi ? at.lo : at.hi;
        const float2 at2 = at4.lo < at4.hi ? at4.lo : at4.hi;
        const float least = at2.x < at2.y ? at2.x : at2.y;
        if (least < hit->t) {
            float lanes[8];
            vstore8(at, 0, lanes);
            uint lane = 0;
            while (lanes[lane] != least)
                ++lane;
            hit->t = least;
            hit->id = ids[lane < last ? lane : last];
        }
    }
}

// The weights of the hit.
void set_packet_weights(const Lines *lines, uint ray, __global const float *vertices, __global const uint *faces,
                        PacketHit *hit)
{
    if (hit->id == NO_HIT)
        return;
    __global const uint *face = faces + 3 * (size_t)hit->id;
    const float4 a = load_vertex(vertices, face[0]);
    const float4 e = load_vertex(vertices, face[1]) - a;
    const float4 f = load_vertex(vertices, face[2]) - a;
    const float4 s = (float4)(lines->ox[ray], lines->oy[ray], lines->oz[ray], 0.0f) - a;
    const float4 d = (float4)(lines->dx[ray], lines->dy[ray], lines->dz[ray], 0.0f);
    const float4 p = d.yzxw * f.zxyw - d.zxyw * f.yzxw, q = s.yzxw * e.zxyw - s.zxyw * e.yzxw;
    const float inverse = 1.0f / (e.x * p.x + e.y * p.y + e.z * p.z);
    hit->u = (s.x * p.x + s.y * p.y + s.z * p.z) * inverse;
    hit->v = (d.x * q.x + d.y * q.y + d.z * q.z) * inverse;
}

#endif
