"""The JSON record of what a scene holds beside triangles."""

from __future__ import annotations

import msgspec


class TextureFound(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A texture: pixels, bytes as 8-bit RGBA, and whether any texel lets light through."""

    name: str
    width: int
    height: int
    nbytes: int
    alpha: bool


class UvFound(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A set of texture coordinates.

    Attributes
    ----------
    own_faces : bool
        Whether corners have rows of their own, not those of their vertices.
    uses : int
        How many textures of materials are looked up with it.
    """

    rows: int
    nbytes: int
    own_faces: bool
    uses: int


class LightFound(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A light by kind and name."""

    kind: str
    name: str


class FramesFound(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Frames of a scene that moves; bytes of the vertices of each, as the first has them."""

    source: str
    count: int
    fps: float
    seconds: float
    topology_changes: bool
    cameras_move: bool
    nbytes: int


class FeaturesRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What a scene's file holds beside triangles.

    Attributes
    ----------
    materials, double_sided, masked, emissive : int
        All materials that triangles have, and how many of them are such; 0 where the file says nothing.
    orthographic : int
        How many of the cameras.
    nbytes : dict of str to int
        What a device is given where a picture needs all of it, by array.
    """

    materials: int
    double_sided: int
    masked: int
    emissive: int
    textures: list[TextureFound]
    uv_sets: list[UvFound]
    vertex_colours: bool
    lights: list[LightFound]
    orthographic: int
    frames: FramesFound | None
    nbytes: dict[str, int]
    warnings: tuple[str, ...] = ()
