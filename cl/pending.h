// Triangles of the cells that a ray passed last, until eight are to be tested at once. One that was seen lately is
// not taken again: in neighbouring cells a third and more are the same.
#ifndef CLG_PENDING_H
#define CLG_PENDING_H
#include "triangle.h"

// Crossings are counted by cell, and so is work: each list is then tested whole and by itself.
#if defined(QUERY_EACH) || defined(COUNT_STEPS)
#define LIST_BY_LIST
#endif

// Triangles that a ray remembers, by the last digits of their ids; a power of two, from 8 on.
#ifndef SEEN
#define SEEN 32u
#endif
// Empty cells that a ray passes in search of more triangles to test at once.
#ifndef PATIENCE
#define PATIENCE 1u
#endif

typedef struct {
    uint ids[8], count;
#ifndef LIST_BY_LIST
    uint seen[SEEN];
    uint idle;         // empty cells since the last that was not
#endif
} Pending;

void start_pending(Pending *pending)
{
    pending->count = 0;
#ifndef LIST_BY_LIST
    pending->idle = 0;
    for (uint i = 0; i < SEEN; i += 8)
        vstore8((uint8)(NO_HIT), 0, pending->seen + i);
#endif
}

// Takes up a triangle, where there is room, and asks for it.
void take_up(Pending *pending, uint id, __global const uint *faces)
{
    ask_for(faces + 3 * (size_t)id);
    pending->ids[pending->count] = id;
#ifdef LIST_BY_LIST
    ++pending->count;
#else
    const uint at = id % SEEN;
    pending->count += pending->seen[at] != id ? 1 : 0;
    pending->seen[at] = id;
#endif
}

// At an empty cell: whether those that are there had better be tested than others looked for.
bool is_due(Pending *pending)
{
#ifdef LIST_BY_LIST
    return false;
#else
    return pending->count != 0 && ++pending->idle > PATIENCE;
#endif
}

#endif
