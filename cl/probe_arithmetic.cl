// What a device does where rules of rounding decide: quotients, roots, a * b + c by operators and by functions.
// NUMBER is the type, of one lane or of several; RUNG_FAST leaves it to the compiler to contract.
// a, b, c: count operands each. results: count each of a / b, sqrt(a), a * b + c, mad, fma, a * b.
#include "config.h"

__kernel __attribute__((reqd_work_group_size(64, 1, 1))) void probe_arithmetic(
    __global const NUMBER *a, __global const NUMBER *b, __global const NUMBER *c, uint count,
    __global NUMBER *results) {
    uint i = (uint)get_global_id(0);
    if (i < count) {
        NUMBER x = a[i], y = b[i], z = c[i];
        results[i] = x / y;
        results[count + i] = sqrt(x);
        results[2 * count + i] = x * y + z;
        results[3 * count + i] = mad(x, y, z);
        results[4 * count + i] = fma(x, y, z);
        results[5 * count + i] = x * y;
    }
}
