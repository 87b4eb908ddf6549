// Hashed layout (Lagae & Dutre 2008), placing: one slab marks its domain bits and overlays its rows in a
// table of its own so that no two full cells share a slot: row displacement, first fit (Tarjan & Yao
// 1979), rows with many full cells first, so that those with few fill the holes that are left.
//   domain[row]           bit x: cell x of the row holds a reference
//   offsets[row]          slot of cell x within the slab's table: (offset + SLOT_IN_ROW) mod 2^16
//   slots[slab]           size of the slab's table      full_cells[slab]    of them in use
#include "binned.h"

// Words of the table that are searched for a row before it goes to the end: bounds the time.
#define SEARCH_WORDS 512u

// Starting slots within the word `at` where every cell of the mask finds a free slot.
ulong open_slots(__local const ulong *used, uint at, ulong mask)
{
    const ulong low = used[at], high = used[at + 1];
    ulong open = ~low;
    for (ulong rest = mask & (mask - 1); rest != 0 && open != 0; rest &= rest - 1) {
        const uint x = popcount((rest & -rest) - 1);
        open &= ~(low >> x | high << (64u - x));
    }
    return open;
}

void mark(__global ulong *word, uint entry)
{
    word[CELL_OF(entry) >> ROW_SHIFT] |= 1ul << (entry & (ROW_CELLS - 1));
}

__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void place_rows(uint cell_count, uint slab_shift, __global const ref_index *slab_starts,
                         __global const uint *binned, __global ulong *domain,
                         __global ushort *offsets, __global uint *slots, __global uint *full_cells)
{
    __local ulong used[MOST_SLAB_ROWS + 3];
    __local ushort order[MOST_SLAB_ROWS];
    __local ushort of_count[ROW_CELLS + 2];
    const uint slab = get_global_id(0);
    const uint first = slab << slab_shift;
    const uint size = min(cell_count - first, 1u << slab_shift);
    const uint rows = (size + ROW_CELLS - 1) >> ROW_SHIFT;
    __global ulong *word = domain + (first >> ROW_SHIFT);
    __global ushort *offset = offsets + (first >> ROW_SHIFT);

    for (uint i = 0; i < rows; ++i)
        word[i] = 0;
    // Two parts in turn: neighbours mark the same rows, and wait for each other.
    const ref_index begin = slab_starts[slab], end = slab_starts[slab + 1];
    const ref_index half_number = (end - begin) / 2;
    for (ref_index r = begin; r < begin + half_number; ++r) {
        mark(word, binned[r]);
        mark(word, binned[r + half_number]);
    }
    if ((end - begin) & 1)
        mark(word, binned[end - 1]);

    // A stable counting sort by the number of full cells, most first; rows without any come last.
    for (uint k = 0; k < ROW_CELLS + 2; ++k)
        of_count[k] = 0;
    for (uint i = 0; i < rows; ++i)
        ++of_count[ROW_CELLS - (uint)popcount(word[i]) + 1];
    for (uint k = 1; k < ROW_CELLS + 2; ++k)
        of_count[k] += of_count[k - 1];
    for (uint i = 0; i < rows; ++i)
        order[of_count[ROW_CELLS - (uint)popcount(word[i])]++] = (ushort)i;

    // Dense rows come first in order, and lie one after another.
    uint at_row = 0, full = 0;
    for (; at_row < rows && popcount(word[order[at_row]]) > DENSE_ROW; ++at_row) {
        offset[order[at_row]] = (ushort)full;
        full += (uint)popcount(word[order[at_row]]);
    }
    for (uint i = 0; i < full / 64u; ++i)
        used[i] = ~0ul;
    uint from = full / 64u;              // words before it have no free slot
    uint last = (full + 63u) / 64u;      // words in use
    uint highest = full;                 // slots in use
    used[from] = (1ul << (full & 63u)) - 1ul;
    used[from + 1] = used[from + 2] = 0;
    for (; at_row < rows; ++at_row) {
        const uint row = order[at_row];
        const ulong bits = word[row];
        const uint count = popcount(bits);
        if (count == 0) {
            offset[row] = 0;
            continue;
        }
        const uint lead = popcount((bits & -bits) - 1);
        const ulong mask = bits >> lead;
        while (from < last && used[from] == ~0ul)
            ++from;
        uint at = from;
        if (count > 1 && last > from + SEARCH_WORDS)
            at = last - SEARCH_WORDS;
        ulong open = 0;
        for (;; ++at) {
            // Too few free slots are told sooner than that none of them fits.
            if ((uint)popcount(~used[at]) + (uint)popcount(~used[at + 1]) >= count)
                open = open_slots(used, at, mask);
            if (open != 0)
                break;
        }
        const uint shift = popcount((open & -open) - 1);
        used[at] |= mask << shift;
        if (shift != 0)
            used[at + 1] |= mask >> (64u - shift);
        // Two words behind the last in use are kept clear for the search.
        const uint top = at * 64u + shift + 64u - (uint)clz(mask);
        highest = max(highest, top);
        while (last < (highest + 63u) / 64u)
            used[++last + 1] = 0;
        offset[row] = (ushort)(at * 64u + shift - lead);
        full += count;
    }
    slots[slab] = highest;
    full_cells[slab] = full;
}
