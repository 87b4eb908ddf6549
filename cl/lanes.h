// Rays side by side: a tile has eight groups of eight.
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

// Halves of lanes of a and b, and quarters, that are yet to be compared: the less of each two.
float8 less_of_halves(float8 a, float8 b)
{
    const float8 p = (float8)(a.lo, b.lo), q = (float8)(a.hi, b.hi);
    return p < q ? p : q;
}

float8 less_of_quarters(float8 a, float8 b)
{
    const float8 p = (float8)(a.s01, b.s01, a.s45, b.s45), q = (float8)(a.s23, b.s23, a.s67, b.s67);
    return p < q ? p : q;
}

// Lane i is the least of v[i]'s.
float8 least_of_each(const float8 *v)
{
    const float8 a = less_of_quarters(less_of_halves(v[0], v[4]), less_of_halves(v[1], v[5]));
    const float8 b = less_of_quarters(less_of_halves(v[2], v[6]), less_of_halves(v[3], v[7]));
    const float8 p = (float8)(a.s02, b.s02, a.s46, b.s46), q = (float8)(a.s13, b.s13, a.s57, b.s57);
    return p < q ? p : q;
}

// Bit i is lane i's.
uint bits_of(int8 lanes)
{
    const int8 own = lanes & (int8)(1, 2, 4, 8, 16, 32, 64, 128);
    const int4 a = own.lo | own.hi;
    const int2 b = a.lo | a.hi;
    return (uint)(b.x | b.y);
}

ulong bits_of_4(long4 lanes)
{
    const long4 own = lanes & (long4)(1, 2, 4, 8);
    return (ulong)(own.x | own.y | own.z | own.w);
}

// -1 in the lanes whose bit is set.
int8 lanes_of(uint bits)
{
    return ((int8)((int)bits) & (int8)(1, 2, 4, 8, 16, 32, 64, 128)) != 0;
}

// Of bits that are not all 0.
uint lowest_of_32(uint bits)
{
    return 31u - clz(bits & (0u - bits));
}

uint lowest_of_64(ulong bits)
{
    return (uint)(63ul - clz(bits & (0ul - bits)));
}

float8 narrowed(double4 low, double4 high)
{
    return (float8)(convert_float4(low), convert_float4(high));
}

// Eight numbers, rounded to float32.
float8 eight_of(const real *numbers)
{
#ifdef WIDE_RAYS
    return narrowed(vload4(0, numbers), vload4(1, numbers));
#else
    return vload8(0, numbers);
#endif
}

// p q - r s of float32 numbers: the products are exact in float64.
double4 difference_of_4(float4 p, float4 q, float4 r, float4 s)
{
    return convert_double4(p) * convert_double4(q) - convert_double4(r) * convert_double4(s);
}

#endif
