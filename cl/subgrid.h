// A subgrid's measures.
#ifndef CLG_SUBGRID_H
#define CLG_SUBGRID_H
#include "config.h"

// Halvings of the cell that it is in which make its own, along an axis.
uint halvings_of(__global const Subgrid *subgrid, int axis)
{
    return subgrid->halvings >> (4 * axis) & 15u;
}

// Halvings of one of its own cells which make the finest.
uint finer_than(__global const Subgrid *subgrid, int axis)
{
    return subgrid->halvings >> (12 + 4 * axis) & 15u;
}

#endif
