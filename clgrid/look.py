"""How a scene looks: materials, textures and lights, as plain arrays beside the mesh.

A mesh knows nothing of its look: rays need none. Colours are linear (Rec. 709) unless a name says sRGB.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

AlphaMode = Literal["opaque", "mask", "blend"]
LightKind = Literal["directional", "point", "spot"]
Wrap = Literal["repeat", "mirror", "clamp"]


@dataclass(frozen=True)
class Texture:
    """A picture to be looked up by uv; (0, 0) is the top left corner of the top left texel, as in glTF.

    Attributes
    ----------
    pixels : (H, W, 4) uint8
        Red, green and blue in sRGB, alpha linear; row 0 on top.
    wrap : (Wrap, Wrap)
        What is beyond 0 and 1, along u and along v.
    smooth : bool
        Whether four texels are mixed, linearly and in linear light; else the nearest.
    name : str
        Of the file or the image, for messages.
    """

    pixels: npt.NDArray[np.uint8]
    wrap: tuple[Wrap, Wrap] = ("repeat", "repeat")
    smooth: bool = True
    name: str = ""


@dataclass(frozen=True)
class TextureUse:
    """A texture as a material uses it.

    Attributes
    ----------
    texture : int
        Number in ``Look.textures``.
    uv_set : int
        Number in ``Look.uvs``.
    transform : (2, 3) float64 or None
        Applied to (u, v, 1) before the look-up (KHR_texture_transform); None where it does nothing.
    """

    texture: int
    uv_set: int = 0
    transform: npt.NDArray[np.float64] | None = None


@dataclass(frozen=True)
class Material:
    """What a surface sends back and out.

    Attributes
    ----------
    base_colour : 4 floats
        Linear red, green, blue and alpha, times texture and vertex colour where there are such.
    base_texture : TextureUse or None
        Colour and alpha.
    emissive : 3 floats
        Linear radiance sent out, times its texture.
    emissive_texture : TextureUse or None
        Colour.
    alpha_mode : {"opaque", "mask", "blend"}
        Rays pass where a mask's alpha is below ``alpha_cutoff``. Blended surfaces are drawn opaque.
    double_sided : bool
        Seen from behind too; else such hits are passed through.
    """

    name: str = ""
    base_colour: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)
    base_texture: TextureUse | None = None
    emissive: tuple[float, float, float] = (0.0, 0.0, 0.0)
    emissive_texture: TextureUse | None = None
    alpha_mode: AlphaMode = "opaque"
    alpha_cutoff: float = 0.5
    double_sided: bool = True


@dataclass(frozen=True)
class Light:
    """A light without size (KHR_lights_punctual), in scene axes.

    Attributes
    ----------
    kind : {"directional", "point", "spot"}
        What it is.
    colour : 3 floats
        Linear, times ``intensity``.
    intensity : float
        Lux of a directional light, candela of the others; a surface of albedo 1 that faces a directional
        light of intensity pi has radiance 1.
    position, direction : (3,) float64
        Where it is, and where it shines to (unit); only what its kind needs.
    reach : float
        Distance beyond which a point or spot light gives nothing; inf for none.
    inner_cone, outer_cone : float
        Half angles of a spot in radians: full light within the inner, none beyond the outer.
    """

    kind: LightKind
    colour: tuple[float, float, float] = (1.0, 1.0, 1.0)
    intensity: float = 1.0
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    direction: tuple[float, float, float] = (0.0, 0.0, -1.0)
    reach: float = math.inf
    inner_cone: float = 0.0
    outer_cone: float = math.pi / 4
    name: str = ""


@dataclass(frozen=True)
class Look:
    """Materials, textures and lights of one mesh.

    Attributes
    ----------
    materials : tuple of Material
        At least one.
    material_ids : (F,) uint16 or uint32
        Material of each triangle.
    textures : tuple of Texture
        Only those that a material names.
    uvs : tuple of (U, 2) float32
        Sets of texture coordinates that a material names.
    uv_faces : tuple of ((F, 3) uint32 or None)
        Rows of the set for each corner, for each of ``uvs``; None where they are those of ``Mesh.faces``.
    colours : (V, 4) float32 or None
        Linear colours and alpha of vertices.
    lights : tuple of Light
        In the order of the file.
    warnings : tuple of str
        What was left out or replaced, one line each.
    """

    materials: tuple[Material, ...]
    material_ids: npt.NDArray[np.unsignedinteger]
    textures: tuple[Texture, ...] = ()
    uvs: tuple[npt.NDArray[np.float32], ...] = ()
    uv_faces: tuple[npt.NDArray[np.uint32] | None, ...] = ()
    colours: npt.NDArray[np.float32] | None = None
    lights: tuple[Light, ...] = ()
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class Shading:
    """How a picture is lit, where it is more than a light at the eye.

    What reaches the eye from a surface is its emission, and its albedo times: light of the lights and the sun
    that nothing stands before, over pi, and light of the sky from the share of the hemisphere that is open.

    Attributes
    ----------
    samples : int
        Rays a pixel, at seeded places within it, averaged by a box filter.
    seed : int
        Of the places and of the occlusion rays.
    lights : bool
        Whether the scene's own lights are lit.
    sun : 3 floats or None
        Direction from the scene to a sun without size.
    sun_strength : float
        Its lux, as of a directional light.
    sky : 3 floats or None
        Linear radiance from everywhere; rays that hit nothing see the picture's background all the same.
    occlusion_rays : int
        Rays a sample that look for the open share of the sky; 0 takes all of it as open.
    occlusion_distance : float
        Beyond it, in scene units, nothing stands before the sky.
    """

    samples: int = 1
    seed: int = 0
    lights: bool = True
    sun: tuple[float, float, float] | None = None
    sun_strength: float = math.pi
    sky: tuple[float, float, float] | None = None
    occlusion_rays: int = 0
    occlusion_distance: float = math.inf
