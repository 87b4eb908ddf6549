// Bounds of rays that share their major axis: at each depth along it, the least and the greatest coordinate on
// both other axes, as linear functions of the depth (after Wald et al. 2006). The greatest of the rays'
// coordinates is convex in the depth, so it lies below its chord: bounds at two depths hold between them.
#ifndef CLG_BEAM_H
#define CLG_BEAM_H
#include "lanes.h"

// How far the rays are kept from the bounds: how far a hit may be from its ray, and all that rounds here
// (docs/numerics.md, "Tiles").
#define BEAM_PAD 0x1p-17f

// Rays from one point (pinhole.h): how much an edge function is to be beyond zero for a triangle to be left out, in
// squares of its reach; the area, in products of reach and size; and a slope, beyond that to a corner.
#define EDGE_SLACK (float)(64 * UNIT_ROUNDOFF)
#define AREA_SLACK (float)(128 * UNIT_ROUNDOFF)
#define LEAST_SLACK 0x1p-80f
#define SLOPE_PAD 0x1p-19f

// Bound i at depth D is at[i] + slope[i] * D: least u, greatest u, least v, greatest v.
typedef struct {
    float at[4], slope[4];
} Beam;

// Those of eight groups of rays.
typedef struct {
    float8 at[4], slope[4];
} Beams;

// A triangle's corners along the two other axes, and in depth.
typedef struct {
    float au, av, ad, bu, bv, bd, cu, cv, cd;
} Triangle;

// Those of eight triangles.
typedef struct {
    float8 au, av, ad, bu, bv, bd, cu, cv, cd;
} Triangles;

// Eight triangles and a bound, or one triangle and the bounds of eight: -1 where all corners are below it.
int8 below(float8 at, float8 slope, float8 a, float8 ad, float8 b, float8 bd, float8 c, float8 cd)
{
    return max(max(a - slope * ad, b - slope * bd), c - slope * cd) < at;
}

int8 above(float8 at, float8 slope, float8 a, float8 ad, float8 b, float8 bd, float8 c, float8 cd)
{
    return min(min(a - slope * ad, b - slope * bd), c - slope * cd) > at;
}

// Which of eight triangles may come near a ray of the beam, or which of eight beams have a ray that may.
#define MAY_MEET(beam, p)                                                                                \
    (~(below((beam)->at[0], (beam)->slope[0], (p)->au, (p)->ad, (p)->bu, (p)->bd, (p)->cu, (p)->cd)      \
       | above((beam)->at[1], (beam)->slope[1], (p)->au, (p)->ad, (p)->bu, (p)->bd, (p)->cu, (p)->cd)    \
       | below((beam)->at[2], (beam)->slope[2], (p)->av, (p)->ad, (p)->bv, (p)->bd, (p)->cv, (p)->cd)    \
       | above((beam)->at[3], (beam)->slope[3], (p)->av, (p)->ad, (p)->bv, (p)->bd, (p)->cv, (p)->cd)))

int8 may_meet(const Beam *beam, const Triangles *p)
{
    return MAY_MEET(beam, p);
}

int8 may_be_met(const Beams *beams, const Triangle *p)
{
    return MAY_MEET(beams, p);
}

#endif
