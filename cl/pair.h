// Sums and products of doubles with what rounding took from them (Dekker 1971; Shewchuk 1997), without fma.
#ifndef CLG_PAIR_H
#define CLG_PAIR_H
#include "config.h"

typedef struct {
    double high, low;  // high + low is exact, high is it rounded
} Pair;

Pair two_sum(double a, double b)
{
    Pair sum;
    sum.high = a + b;
    const double of_b = sum.high - a;
    sum.low = (a - (sum.high - of_b)) + (b - of_b);
    return sum;
}

// a in two halves of 26 digits. |a| must be below 2^996.
Pair split(double a)
{
    Pair halves;
    const double c = 0x1.0000002p+27 * a;  // 2^27 + 1
    halves.high = c - (c - a);
    halves.low = a - halves.high;
    return halves;
}

// Exact if the product is 0 or at least 2^-968, and its factors are below 2^996.
Pair two_product(double a, double b)
{
    Pair product;
    const Pair x = split(a), y = split(b);
    product.high = a * b;
    product.low = x.low * y.low - (((product.high - x.high * y.high) - x.low * y.high) - x.high * y.low);
    return product;
}

// Four at a time.
typedef struct {
    double4 high, low;
} Pairs;

Pairs two_sums(double4 a, double4 b)
{
    Pairs sum;
    sum.high = a + b;
    const double4 of_b = sum.high - a;
    sum.low = (a - (sum.high - of_b)) + (b - of_b);
    return sum;
}

Pairs split_4(double4 a)
{
    Pairs halves;
    const double4 c = 0x1.0000002p+27 * a;
    halves.high = c - (c - a);
    halves.low = a - halves.high;
    return halves;
}

Pairs two_products(double4 a, double4 b)
{
    Pairs product;
    const Pairs x = split_4(a), y = split_4(b);
    product.high = a * b;
    product.low = x.low * y.low - (((product.high - x.high * y.high) - x.low * y.high) - x.high * y.low);
    return product;
}

#endif
