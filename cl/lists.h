// How cells find their lists, for each layout; cell i = (z * My + y) * Mx + x, lists ascend.
//   compact              references[cells[i] .. cells[i+1]-1]                       (Lagae & Dutre 2008)
//   LAYOUT_HASHED        a domain bit says whether i has a list; if so, and s is its slot,
//                        references[table[s] .. table[s+1]-1]                       (the same)
//   LAYOUT_LINKED_LIST   triangles[n], triangles[next[n]], ... from n = heads[i]
//   NESTED               with one of these two: a reference from grid->first_subgrid on, alone in its list, is a
//                        subgrid, whose cells have numbers after those of the grid that it is in
//   LAYOUT_DYNAMIC_ARRAY pool[pointers[i] .. pointers[i]+sizes[i]-1]; capacities serve growth alone
#ifndef CLG_LISTS_H
#define CLG_LISTS_H
#include "ask.h"

#if defined(LAYOUT_HASHED)
#define LIST_PARAMETERS                                                                               \
    __global const ulong *domain, __global const ushort *offsets, __global const uint *table_starts, \
        __global const ref_index *table, __global const uint *references
#define LIST_ARGUMENTS domain, offsets, table_starts, table, references
#elif defined(LAYOUT_LINKED_LIST)
#define LIST_PARAMETERS                                                                              \
    __global const ref_index *heads, __global const ref_index *next, __global const uint *triangles
#define LIST_ARGUMENTS heads, next, triangles
#elif defined(LAYOUT_DYNAMIC_ARRAY)
#define LIST_PARAMETERS                                                                            \
    __global const ref_index *pointers, __global const uint *sizes, __global const uint *capacities, \
        __global const uint *pool
#define LIST_ARGUMENTS pointers, sizes, capacities, pool
#else
#define LIST_PARAMETERS __global const ref_index *cells, __global const uint *references
#define LIST_ARGUMENTS cells, references
#endif

#ifdef NESTED
#define GRID_PARAMETERS __constant const GridParams *grid, LIST_PARAMETERS, __global const Subgrid *subgrids
#define GRID_ARGUMENTS grid, LIST_ARGUMENTS, subgrids
#elif defined(SKIP_EMPTY)
#define GRID_PARAMETERS __constant const GridParams *grid, LIST_PARAMETERS, __global const uchar *distances
#define GRID_ARGUMENTS grid, LIST_ARGUMENTS, distances
#else
#define GRID_PARAMETERS __constant const GridParams *grid, LIST_PARAMETERS
#define GRID_ARGUMENTS grid, LIST_ARGUMENTS
#endif

// A cell's list: its first reference or node, and its length; a linked list knows no length, but whether
// there is one.
typedef struct {
    ref_index begin;
    uint count;
} List;

List find_list(uint cell, __constant const GridParams *grid, LIST_PARAMETERS)
{
    List list = {0, 0};
#if defined(LAYOUT_HASHED)
    const ulong row = domain[cell >> ROW_SHIFT];
    const uint x = cell & (ROW_CELLS - 1);
    if (row >> x & 1ul) {
        const uint within = (ushort)(offsets[cell >> ROW_SHIFT] + SLOT_IN_ROW(row, x));
        const uint slot = table_starts[cell >> grid->slab_shift] + within;
        list.begin = table[slot];
        list.count = (uint)(table[slot + 1] - list.begin);
    }
#elif defined(LAYOUT_LINKED_LIST)
    list.begin = heads[cell];
    list.count = list.begin == NO_REFERENCE ? 0 : 1;
#elif defined(LAYOUT_DYNAMIC_ARRAY)
    list.count = sizes[cell];
    list.begin = list.count != 0 ? pointers[cell] : 0;
#else
    list.begin = cells[cell];
    list.count = (uint)(cells[cell + 1] - list.begin);
#endif
    return list;
}

#ifndef LAYOUT_LINKED_LIST
// The triangles of a list.
__global const uint *entries_of(const List *list, LIST_PARAMETERS)
{
#ifdef LAYOUT_DYNAMIC_ARRAY
    return pool + list->begin;
#else
    return references + list->begin;
#endif
}
#endif

// Asks for what find_list reads.
void ask_for_list(uint cell, __constant const GridParams *grid, LIST_PARAMETERS)
{
#if defined(LAYOUT_HASHED)
    const ulong row = domain[cell >> ROW_SHIFT];
    const uint x = cell & (ROW_CELLS - 1);
    if (row >> x & 1ul) {
        const uint within = (ushort)(offsets[cell >> ROW_SHIFT] + SLOT_IN_ROW(row, x));
        ask_for(table + table_starts[cell >> grid->slab_shift] + within);
    }
#elif defined(LAYOUT_LINKED_LIST)
    ask_for(heads + cell);
#elif defined(LAYOUT_DYNAMIC_ARRAY)
    ask_for(sizes + cell);
    ask_for(pointers + cell);
#else
    ask_for(cells + cell);
#endif
}

// Asks for what take_id reads, of a list that is not empty.
void ask_for_ids(const List *list, LIST_PARAMETERS)
{
#if defined(LAYOUT_LINKED_LIST)
    ask_for(triangles + list->begin);
    ask_for(next + list->begin);
#else
    __global const uint *entries = entries_of(list, LIST_ARGUMENTS);
    ask_for(entries);
    ask_for(entries + min(list->count, 8u) - 1);
#endif
}

// Whether none of `count` consecutive cells has a list.
bool all_empty(uint first, uint count, __constant const GridParams *grid, LIST_PARAMETERS)
{
#if defined(LAYOUT_HASHED)
    const uint end = first + count;
    for (uint cell = first; cell < end;) {
        const uint x = cell & (ROW_CELLS - 1), in_row = min(ROW_CELLS - x, end - cell);
        if ((domain[cell >> ROW_SHIFT] >> x & (~0ul >> (ROW_CELLS - in_row))) != 0)
            return false;
        cell += in_row;
    }
    return true;
#elif defined(LAYOUT_LINKED_LIST) || defined(LAYOUT_DYNAMIC_ARRAY)
    for (uint cell = first; cell < first + count; ++cell)
        if (find_list(cell, grid, LIST_ARGUMENTS).count != 0)
            return false;
    return true;
#else
    return cells[first] == cells[first + count];
#endif
}

// Takes the next triangle off a list that is not empty.
uint take_id(List *list, LIST_PARAMETERS)
{
#ifdef LAYOUT_LINKED_LIST
    const uint id = triangles[list->begin];
    list->begin = next[list->begin];
    list->count = list->begin == NO_REFERENCE ? 0 : 1;
#else
    const uint id = *entries_of(list, LIST_ARGUMENTS);
    ++list->begin;
    --list->count;
#endif
    return id;
}

#endif
