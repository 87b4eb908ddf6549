// Copies count vectors, `chunk` to a work-item: what a device's memory gives a kernel. With a count of 0 it does
// nothing: what a launch costs.
#include "config.h"

__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void probe_copy(
    __global const float8 *from, uint count, uint chunk, __global float8 *to) {
    uint first = (uint)get_global_id(0) * chunk, last = min(first + chunk, count);
    for (uint i = first; i < last; i++)
        to[i] = from[i];
}
