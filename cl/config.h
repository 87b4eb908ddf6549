// Rules and constants that every strict kernel shares. Each constant is derived in docs/numerics.md.
#ifndef CLG_CONFIG_H
#define CLG_CONFIG_H

#pragma OPENCL EXTENSION cl_khr_fp64 : enable
#ifndef RUNG_FAST
// a*b-c*d must round both products alike, or edges of neighbours leak (Woop et al. 2013).
#pragma OPENCL FP_CONTRACT OFF
#endif

#define NO_HIT 0xFFFFFFFFu

// The rung of the accuracy ladder: RUNG_FAST, RUNG_PRECISE, RUNG_EXACT, or robust. `real` is what a ray, its
// t and its weights are made of.
#if defined(RUNG_PRECISE) || defined(RUNG_EXACT)
#define WIDE_RAYS
typedef double real;
typedef double4 real4;
typedef long4 mask4;
#define convert_real4 convert_double4
#define convert_mask4 convert_long4
#else
typedef float real;
typedef float4 real4;
typedef int4 mask4;
#define convert_real4 convert_float4
#define convert_mask4 convert_int4
#endif

// Counts and positions of references: 32 bits unless a grid holds more than those can number.
#ifdef WIDE_REFERENCES
typedef ulong ref_index;
#else
typedef uint ref_index;
#endif
#define NO_REFERENCE ((ref_index)~(ref_index)0)

// A triangle whose box has more cells is entered only in those that it touches: fewer references, for
// more work. For a smaller box the work is not worth it.
#define CLIP_CELLS 32u

// Hashed layout: a row is ROW_CELLS consecutive cells, one word of domain bits.
#define ROW_SHIFT 6u
#define ROW_CELLS (1u << ROW_SHIFT)
// A row with more full cells than this would leave holes that no other row fits, and take long to place: its
// full cells alone get slots, one after another, and a cell's slot is the number of full cells before it.
#ifndef DENSE_ROW
#define DENSE_ROW 8u
#endif
// Slot of a full cell x of a row, counted from the row's offset (mod 2^16): both kinds are computed, since
// which of them it is cannot be foretold by a branch.
#define SLOT_IN_ROW(row, x)                                                                       \
    select((uint)(x), (uint)popcount((row) & ((1ul << (x)) - 1ul)),                               \
           (uint)-(int)((uint)popcount(row) > DENSE_ROW))
// A slab of the build has at most 2^16 cells, so that a cell or slot within it is a ushort.
#define MOST_SLAB_ROWS 1024u

// Empty-space skipping: cells along a brick, and the greatest distance that is kept.
#define BRICK 4u
#define FAR_AWAY ((uchar)255)

// Nested layouts: halvings of a cell of the top grid, along each axis, that make the finest cells there can be.
#define FINEST 10

// Half an ulp of 1: the unit round-off of float32.
#define UNIT_ROUNDOFF 0x1p-24

// How far, on each axis, the ray at its computed t may be from the triangle that it hits there.
#define HIT_ERROR (26 * UNIT_ROUNDOFF)
// A box is entered in every cell within this distance: HIT_ERROR plus the rounding of cell_range.
#define BOX_PAD (40 * UNIT_ROUNDOFF)
// A cell of a subgrid may touch a triangle's plane and edges within this, in float32; the slack is relative.
#define FACET_PAD (80 * UNIT_ROUNDOFF)
#define FACET_SLACK (64 * UNIT_ROUNDOFF)
// A computed t and the ray's true passage at the hit differ by less than this.
#define T_SLACK (32 * UNIT_ROUNDOFF)

// Local coordinates of vertices are within [-1, 1]; a ray starts within [-START_LIMIT, START_LIMIT].
#define START_LIMIT 2.0
// A ray from farther away is moved to where it enters the cube [-ENTRY_CUBE, ENTRY_CUBE].
#define ENTRY_CUBE 1.5

// `exact`: an origin farther away than this is beyond what the walk can follow; all triangles are tested.
#define FARTHEST_ORIGIN 0x1p+45

// Edge functions below this are recomputed in float64: nearer zero, float32 may have underflowed.
#define SMALLEST_EDGE 0x1p-80f

#endif
