// Integers of any size that the exact rung meets, and doubles as integers times a power of two: sums and
// products have no rounding, no overflow and no underflow. Sign and magnitude, least limb first.
// LIMBS holds the largest product that triangle_exact.h forms from doubles of any exponents.
#ifndef CLG_BIG_H
#define CLG_BIG_H
#include "ray.h"

#define LIMBS 320

// Compilers would copy these into one another without end.
#define OUT_OF_LINE __attribute__((noinline))

typedef struct {
    int sign;          // -1, 0, 1
    uint count;        // limbs; the last is not 0
    uint limb[LIMBS];
} Big;

// The least e so that x is an integer times 2^e; for 0, one that never counts.
int lowest_bit(double x)
{
    const ulong bits = as_ulong(x);
    const int biased = (int)(bits >> 52 & 0x7FF);
    const ulong digits = (bits & 0xFFFFFFFFFFFFFul) | (biased ? 1ul << 52 : 0ul);
    if (digits == 0)
        return INT_MAX;
    return max(biased, 1) - 1075 + (int)popcount((digits & (0ul - digits)) - 1ul);
}

void trim(Big *r)
{
    while (r->count > 0 && r->limb[r->count - 1] == 0)
        --r->count;
    if (r->count == 0)
        r->sign = 0;
}

// r = x * 2^shift, which must be an integer.
OUT_OF_LINE
void big_of(Big *r, double x, int shift)
{
    const ulong bits = as_ulong(x);
    const int biased = (int)(bits >> 52 & 0x7FF);
    ulong digits = (bits & 0xFFFFFFFFFFFFFul) | (biased ? 1ul << 52 : 0ul);
    int exponent = max(biased, 1) - 1075 + shift;
    r->sign = digits == 0 ? 0 : bits >> 63 ? -1 : 1;
    r->count = 0;
    if (digits == 0)
        return;
    if (exponent < 0) {
        digits = exponent > -64 ? digits >> -exponent : 0;
        exponent = 0;
    }
    const uint whole = (uint)exponent >> 5, part = (uint)exponent & 31u;
    for (uint i = 0; i < whole; ++i)
        r->limb[i] = 0;
    const ulong low = (digits & 0xFFFFFFFFul) << part;
    const ulong high = ((digits >> 32) << part) + (low >> 32);
    r->limb[whole] = (uint)low;
    r->limb[whole + 1] = (uint)high;
    r->limb[whole + 2] = (uint)(high >> 32);
    r->count = whole + 3;
    trim(r);
}

OUT_OF_LINE
void big_copy(Big *r, const Big *a)
{
    r->sign = a->sign;
    r->count = a->count;
    for (uint i = 0; i < a->count; ++i)
        r->limb[i] = a->limb[i];
}

// Compares magnitudes: -1, 0, 1.
int compare_sizes(const Big *a, const Big *b)
{
    if (a->count != b->count)
        return a->count < b->count ? -1 : 1;
    for (uint i = a->count; i-- > 0;)
        if (a->limb[i] != b->limb[i])
            return a->limb[i] < b->limb[i] ? -1 : 1;
    return 0;
}

// The sign of a - b.
int big_compare(const Big *a, const Big *b)
{
    if (a->sign != b->sign)
        return a->sign < b->sign ? -1 : 1;
    return a->sign * compare_sizes(a, b);
}

// r = a + sign * b; r is neither.
OUT_OF_LINE
void big_add(Big *r, const Big *a, int sign, const Big *b)
{
    const int sign_b = sign * b->sign;
    if (a->sign == 0 || sign_b == 0) {
        big_copy(r, sign_b == 0 ? a : b);
        r->sign = sign_b == 0 ? a->sign : sign_b;
        return;
    }
    const bool swap = compare_sizes(a, b) < 0;
    const Big *large = swap ? b : a, *small = swap ? a : b;
    const bool same = a->sign == sign_b;
    r->sign = swap ? sign_b : a->sign;
    ulong carry = 0;  // or borrow
    for (uint i = 0; i < large->count; ++i) {
        const ulong x = large->limb[i], y = (i < small->count ? small->limb[i] : 0u) + carry;
        const ulong sum = same ? x + y : x - y;
        r->limb[i] = (uint)sum;
        carry = sum >> 32 & 1ul;
    }
    r->count = large->count;
    if (same)
        r->limb[r->count++] = (uint)carry;
    trim(r);
}

// r = a * b; r is neither.
OUT_OF_LINE
void big_multiply(Big *r, const Big *a, const Big *b)
{
    r->sign = a->sign * b->sign;
    r->count = r->sign == 0 ? 0 : a->count + b->count;
    for (uint i = 0; i < r->count; ++i)
        r->limb[i] = 0;
    if (r->sign == 0)
        return;
    for (uint i = 0; i < a->count; ++i) {
        ulong carry = 0;
        for (uint k = 0; k < b->count; ++k) {
            const ulong sum = (ulong)a->limb[i] * b->limb[k] + r->limb[i + k] + carry;
            r->limb[i + k] = (uint)sum;
            carry = sum >> 32;
        }
        r->limb[i + b->count] = (uint)carry;
    }
    trim(r);
}

// r = r * 2^bits
OUT_OF_LINE
void big_shift(Big *r, uint bits)
{
    if (r->sign == 0 || bits == 0)
        return;
    const uint whole = bits >> 5, part = bits & 31u;
    r->limb[r->count] = 0;
    for (uint i = r->count + 1; i-- > 0;) {
        const ulong pair = (ulong)r->limb[i] << 32 | (i > 0 ? r->limb[i - 1] : 0u);
        r->limb[i + whole] = (uint)(pair << part >> 32);
    }
    for (uint i = 0; i < whole; ++i)
        r->limb[i] = 0;
    r->count += whole + 1;
    trim(r);
}

// The leading 64 bits, rounded to a double within [2^63, 2^64], and the exponent that goes with it.
double leading(const Big *a, int *exponent)
{
    const uint n = a->count;
    const ulong top = (ulong)a->limb[n - 1] << 32 | (n > 1 ? a->limb[n - 2] : 0u);
    const uint next = n > 2 ? a->limb[n - 3] : 0u;
    const uint zeros = (uint)clz(top);
    *exponent = 32 * ((int)n - 2) - (int)zeros;
    return (double)(top << zeros | (ulong)next << zeros >> 32);
}

// x * 2^exponent, for x of a size near 1
double scale_by(double x, int exponent)
{
    const int first = clamp(exponent, -1000, 1000), second = clamp(exponent - first, -1000, 1000);
    return x * power_of_two(first) * power_of_two(second);
}

// a / b * 2^exponent, with a relative error of at most 2^-51 above the denormals. b is not 0.
OUT_OF_LINE
double quotient(const Big *a, const Big *b, int exponent)
{
    if (a->sign == 0)
        return 0.0;
    int above, below;
    const double x = leading(a, &above), y = leading(b, &below);
    return (double)(a->sign * b->sign) * scale_by(x / y, above - below + exponent);
}

// The sign of p q - r s.
OUT_OF_LINE
int compare_products(double p, double q, double r, double s)
{
    Big a, b, left, right;
    const int bit_p = lowest_bit(p), bit_q = lowest_bit(q), bit_r = lowest_bit(r), bit_s = lowest_bit(s);
    big_of(&a, p, -bit_p);
    big_of(&b, q, -bit_q);
    big_multiply(&left, &a, &b);
    big_of(&a, r, -bit_r);
    big_of(&b, s, -bit_s);
    big_multiply(&right, &a, &b);
    if (left.sign != 0 && right.sign != 0) {
        const int ahead = bit_p + bit_q - (bit_r + bit_s);
        big_shift(&left, (uint)max(ahead, 0));
        big_shift(&right, (uint)max(-ahead, 0));
    }
    return big_compare(&left, &right);
}

#endif
