// Seeded numbers that depend on nothing but their names: pixel of the whole picture, sample, ray and seed. So no order
// of the work changes them. Counters through the mixer of splitmix64 (Steele, Lea, Flood 2014).
#ifndef CLG_RANDOM_H
#define CLG_RANDOM_H
#include "config.h"

#define GOLDEN 0x9E3779B97F4A7C15ul

typedef struct {
    double x, y;  // both within (0, 1)
} Place;

ulong mixed(ulong x)
{
    x = (x ^ x >> 30) * 0xBF58476D1CE4E5B9ul;
    x = (x ^ x >> 27) * 0x94D049BB133111EBul;
    return x ^ x >> 31;
}

// What all rays of a sample share.
ulong sample_key(ulong seed, ulong pixel, uint sample)
{
    return mixed(mixed(mixed(seed + GOLDEN) + (pixel + 1) * GOLDEN) + (sample + 1ul) * GOLDEN);
}

// A place in cell `number` of a unit square of columns x rows cells.
Place place_in_cell(ulong key, uint number, uint columns, uint rows)
{
    const ulong bits = mixed(key + (number + 1ul) * GOLDEN);
    Place place;
    place.x = ((double)(number % columns) + ((double)(uint)bits + 0.5) * 0x1p-32) / (double)columns;
    place.y = ((double)(number / columns) + ((double)(uint)(bits >> 32) + 0.5) * 0x1p-32) / (double)rows;
    return place;
}

#endif
