// Eight values side by side.
#ifndef CLG_LANES_H
#define CLG_LANES_H
#include "config.h"

#define LANES 8
#define GROUPS 8
#define TILE_RAYS (LANES * GROUPS)

float least_of(float8 v)
{
    const float4 a = v.lo < v.hi ? v.lo : v.hi;
    const float2 b = a.lo < a.hi ? a.lo : a.hi;
    return b.x < b.y ? b.x : b.y;
}

float greatest_of(float8 v)
{
    return -least_of(-v);
}

// Bit i is lane i's.
uint bits_of(int8 lanes)
{
    const int8 own = lanes & (int8)(1, 2, 4, 8, 16, 32, 64, 128);
    const int4 a = own.lo | own.hi;
    const int2 b = a.lo | a.hi;
    return (uint)(b.x | b.y);
}

// -1 in the lanes whose bit is set.
int8 lanes_of(uint bits)
{
    return ((int8)((int)bits) & (int8)(1, 2, 4, 8, 16, 32, 64, 128)) != 0;
}

uint lowest_bit(uint bits)
{
    return 31u - clz(bits & (0u - bits));
}

float8 narrowed(double4 lo, double4 hi)
{
    return (float8)(convert_float4(lo), convert_float4(hi));
}

// Masks of doubles as masks of floats.
int8 narrow_lanes(long4 lo, long4 hi)
{
    return (int8)(convert_int4(lo), convert_int4(hi));
}

#endif
