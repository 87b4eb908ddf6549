// Bounds of bundles of rays that share their major axis: at each depth along it, the least and the greatest
// coordinate on the two other axes, as linear functions of the depth (after Wald et al. 2006). A convex
// function lies below its chord, so the bounds at two depths hold between them.
#ifndef CLG_BEAM_H
#define CLG_BEAM_H
#include "lanes.h"

// How far a triangle may be from the ray that it is hit by, and all that rounds here (docs/numerics.md,
// "Tiles").
#define BEAM_PAD 0x1p-17f

// Bound i at depth D is at[i] + slope[i] * D: least u, greatest u, least v, greatest v, of eight groups of
// rays or of one.
typedef struct {
    float8 at[4], slope[4];
} Beams;

typedef struct {
    float at[4], slope[4];
} Beam;

// Which of eight triangles (their corners' coordinates) a beam may meet.
int8 may_meet(const Beam *beam, float8 au, float8 av, float8 ad, float8 bu, float8 bv, float8 bd, float8 cu,
              float8 cv, float8 cd)
{
    int8 apart = 0;
    {
        const float8 a = au - beam->slope[0] * ad, b = bu - beam->slope[0] * bd, c = cu - beam->slope[0] * cd;
        apart |= max(max(a, b), c) < beam->at[0];
    }
    {
        const float8 a = au - beam->slope[1] * ad, b = bu - beam->slope[1] * bd, c = cu - beam->slope[1] * cd;
        apart |= min(min(a, b), c) > beam->at[1];
    }
    {
        const float8 a = av - beam->slope[2] * ad, b = bv - beam->slope[2] * bd, c = cv - beam->slope[2] * cd;
        apart |= max(max(a, b), c) < beam->at[2];
    }
    {
        const float8 a = av - beam->slope[3] * ad, b = bv - beam->slope[3] * bd, c = cv - beam->slope[3] * cd;
        apart |= min(min(a, b), c) > beam->at[3];
    }
    return ~apart;
}

// Which of eight beams may meet a triangle.
int8 may_be_met(const Beams *beams, float au, float av, float ad, float bu, float bv, float bd, float cu, float cv,
                float cd)
{
    int8 apart = 0;
    {
        const float8 a = au - beams->slope[0] * ad, b = bu - beams->slope[0] * bd, c = cu - beams->slope[0] * cd;
        apart |= max(max(a, b), c) < beams->at[0];
    }
    {
        const float8 a = au - beams->slope[1] * ad, b = bu - beams->slope[1] * bd, c = cu - beams->slope[1] * cd;
        apart |= min(min(a, b), c) > beams->at[1];
    }
    {
        const float8 a = av - beams->slope[2] * ad, b = bv - beams->slope[2] * bd, c = cv - beams->slope[2] * cd;
        apart |= max(max(a, b), c) < beams->at[2];
    }
    {
        const float8 a = av - beams->slope[3] * ad, b = bv - beams->slope[3] * bd, c = cv - beams->slope[3] * cd;
        apart |= min(min(a, b), c) > beams->at[3];
    }
    return ~apart;
}

#endif
