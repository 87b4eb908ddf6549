// Colours of textures at uv; the same bits everywhere, by + - * / and floor in float64.
//   textures   where each is and how it goes on beyond 0 and 1
//   texels     4 bytes each: red, green, blue in sRGB, alpha
//   decoded    linear value of each byte in sRGB (IEC 61966-2-1)
#ifndef CLG_TEXTURE_H
#define CLG_TEXTURE_H
#include "config.h"

#define NO_TEXTURE 0xFFFFFFFFu
#define REPEAT 0u
#define MIRROR 1u
// Coordinates in texels beyond this, and what is no number, are taken as 0.
#define FARTHEST_TEXEL 0x1p+31

#define TEXTURE_PARAMETERS \
    __global const TextureParams *textures, __global const uchar *texels, __global const double *decoded
#define TEXTURE_ARGUMENTS textures, texels, decoded

typedef struct {
    double at[4];  // linear red, green, blue, and alpha
} Colour;

// The texel along one axis for any whole i within FARTHEST_TEXEL.
uint wrapped(double i, uint size, uint wrap)
{
    if (wrap == REPEAT)
        return (uint)(i - (double)size * floor(i / (double)size));
    if (wrap == MIRROR) {
        const double twice = 2.0 * (double)size;
        const uint within = (uint)(i - twice * floor(i / twice));
        return within < size ? within : 2 * size - 1 - within;
    }
    return i < 0.0 ? 0u : i > (double)(size - 1) ? size - 1 : (uint)i;
}

Colour texel(uint texture, uint x, uint y, TEXTURE_PARAMETERS)
{
    const size_t at = 4 * (textures[texture].first + (size_t)y * textures[texture].width + x);
    Colour colour;
    for (int c = 0; c < 3; ++c)
        colour.at[c] = decoded[texels[at + c]];
    colour.at[3] = (double)texels[at + 3] / 255.0;
    return colour;
}

Colour between(Colour a, Colour b, double share)
{
    for (int c = 0; c < 4; ++c)
        a.at[c] = a.at[c] + share * (b.at[c] - a.at[c]);
    return a;
}

double in_reach(double x)
{
    return fabs(x) < FARTHEST_TEXEL ? x : 0.0;
}

Colour texture_at(uint texture, double u, double v, TEXTURE_PARAMETERS)
{
    const uint width = textures[texture].width, height = textures[texture].height;
    const uint wrap_u = textures[texture].wrap[0], wrap_v = textures[texture].wrap[1];
    const double x = in_reach(u * (double)width), y = in_reach(v * (double)height);
    if (!textures[texture].smooth)
        return texel(texture, wrapped(floor(x), width, wrap_u), wrapped(floor(y), height, wrap_v), TEXTURE_ARGUMENTS);
    const double left = floor(x - 0.5), top = floor(y - 0.5);
    const uint x0 = wrapped(left, width, wrap_u), x1 = wrapped(left + 1.0, width, wrap_u);
    const uint y0 = wrapped(top, height, wrap_v), y1 = wrapped(top + 1.0, height, wrap_v);
    const double across = (x - 0.5) - left, down = (y - 0.5) - top;
    Colour rows[2];
    for (int k = 0; k < 2; ++k) {
        const uint row = k ? y1 : y0;
        rows[k] = between(texel(texture, x0, row, TEXTURE_ARGUMENTS), texel(texture, x1, row, TEXTURE_ARGUMENTS),
                          across);
    }
    return between(rows[0], rows[1], down);
}

#endif
