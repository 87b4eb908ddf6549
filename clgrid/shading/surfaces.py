"""A look on the device: materials, textures and coordinates as kernels read them (cl/material.h)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from clgrid import structs
from clgrid.cast import Defines, GridPart
from clgrid.colour import linear
from clgrid.errors import InputError
from clgrid.look import Look, Material, TextureUse
from clgrid.memory import Allocator
from clgrid.mesh import Mesh

# A surface of no look: the grey of plain pictures, cl/light.h.
GREY = 0.8
_NO_TEXTURE = 0xFFFFFFFF
_WRAPS = {"repeat": 0, "mirror": 1, "clamp": 2}
_NO_TRANSFORM = np.eye(2, 3)


def grey_look(mesh: Mesh) -> Look:
    """The look of a mesh that has none: grey, seen from both sides."""
    return Look((Material(base_colour=(GREY, GREY, GREY, 1.0)),), np.zeros(mesh.triangle_count, np.uint16))


def decoded_srgb() -> npt.NDArray[np.float64]:
    """(256,) float64: the linear value of each byte in sRGB (IEC 61966-2-1)."""
    return linear(np.arange(256) / 255.0)


def is_textured(look: Look) -> bool:
    """Whether a material has a texture."""
    return any(each.base_texture or each.emissive_texture for each in look.materials)


def look_defines(look: Look) -> Defines:
    """The options of kernels that look materials up: only what the look has."""
    options: Defines = {"MATERIAL_ID": "ushort" if look.material_ids.dtype == np.uint16 else "uint"}
    has = {
        "LOOK_UVS": bool(look.uvs),
        "LOOK_COLOURS": look.colours is not None,
        "LOOK_TEXTURES": is_textured(look),
    }
    return {**options, **{name: 1 for name, there in has.items() if there}}


def is_masked(look: Look) -> bool:
    """Whether there may be texels that rays pass."""
    return any(each.alpha_mode == "mask" for each in look.materials)


def is_passable(look: Look) -> bool:
    """Whether there may be surfaces that rays of the eye pass."""
    return is_masked(look) or not all(each.double_sided for each in look.materials)


def check_look(look: Look, mesh: Mesh) -> None:
    """Refuse a look whose numbers do not fit the mesh or each other.

    Raises
    ------
    InputError
        Naming what does not fit.
    """
    triangles, vertices = mesh.triangle_count, len(mesh.vertices)
    ids = look.material_ids
    if ids.shape != (triangles,) or ids.dtype not in (np.uint16, np.uint32):
        raise InputError(
            f"look: material_ids are {ids.shape} {ids.dtype}; give one uint16 or uint32 a triangle"
        )
    if triangles and int(ids.max()) >= len(look.materials):
        raise InputError(
            f"look: material {int(ids.max())} of {len(look.materials)}; give it or correct the ids"
        )
    if look.colours is not None and look.colours.shape != (vertices, 4):
        raise InputError(f"look: colours are {look.colours.shape}; give four a vertex, ({vertices}, 4)")
    rows = look.uv_faces or (None,) * len(look.uvs)
    if len(rows) != len(look.uvs):
        raise InputError(
            f"look: {len(look.uvs)} uvs but {len(rows)} uv_faces; give None for those of the mesh"
        )
    for number, (uvs, faces) in enumerate(zip(look.uvs, rows, strict=True)):
        used = mesh.faces if faces is None else faces
        if used.shape != (triangles, 3) or (triangles and int(used.max()) >= len(uvs)):
            raise InputError(f"look: uv_faces of set {number} do not fit its {len(uvs)} rows; correct them")
    for material in look.materials:
        _check_material(material, look)
    for texture in look.textures:
        pixels = texture.pixels
        if pixels.dtype != np.uint8 or pixels.ndim != 3 or pixels.shape[2] != 4 or not pixels.size:
            raise InputError(
                f"look: pixels of texture {texture.name!r} are {pixels.shape} {pixels.dtype}; give (H, W, 4)"
                " uint8"
            )
        if len(texture.wrap) != 2 or not set(texture.wrap) <= set(_WRAPS):
            raise InputError(
                f"look: wrap of texture {texture.name!r} is {texture.wrap}; choose of {', '.join(_WRAPS)}"
            )


def _check_material(material: Material, look: Look) -> None:
    for use in (material.base_texture, material.emissive_texture):
        if use is not None and not (
            0 <= use.texture < len(look.textures) and 0 <= use.uv_set < len(look.uvs)
        ):
            raise InputError(
                f"look: material {material.name!r} names texture {use.texture} by uv set {use.uv_set}, of"
                f" {len(look.textures)} textures and {len(look.uvs)} sets; correct it"
            )


def _material_row(material: Material) -> npt.NDArray[np.void]:
    base, emissive = material.base_texture, material.emissive_texture
    masked = material.alpha_mode == "mask"
    return structs.MATERIAL.pack(
        base_transform=_transform(base),
        emissive_transform=_transform(emissive),
        base_colour=material.base_colour,
        emissive=material.emissive,
        alpha_cutoff=material.alpha_cutoff if masked else 0.0,
        base_texture=_NO_TEXTURE if base is None else base.texture,
        base_uv=0 if base is None else base.uv_set,
        emissive_texture=_NO_TEXTURE if emissive is None else emissive.texture,
        emissive_uv=0 if emissive is None else emissive.uv_set,
        double_sided=material.double_sided,
        masked=masked,
    )


def _transform(use: TextureUse | None) -> npt.NDArray[np.float64]:
    own = _NO_TRANSFORM if use is None or use.transform is None else use.transform
    return np.asarray(own, np.float64).reshape(6)


@dataclass(frozen=True)
class Surfaces:
    """A look on the device, and what of it kernels are compiled for.

    Attributes
    ----------
    look : Look
    mesh : Mesh
        Which it fits.
    allocator : Allocator
    """

    look: Look
    mesh: Mesh
    allocator: Allocator

    @cached_property
    def textured(self) -> bool:
        """Whether a material has a texture."""
        return is_textured(self.look)

    @cached_property
    def masked(self) -> bool:
        """Whether there may be texels that rays pass."""
        return is_masked(self.look)

    @cached_property
    def passable(self) -> bool:
        """Whether there may be surfaces that rays of the eye pass."""
        return is_passable(self.look)

    @property
    def defines(self) -> Defines:
        """As of ``look_defines``."""
        return look_defines(self.look)

    def arguments(self, part: GridPart) -> list[Any]:
        """The arguments of LOOK_PARAMETERS for a part of the mesh."""
        look, first, last = self.look, part.mesh.first, part.mesh.first + part.mesh.count
        found: list[Any] = [np.uint32(first), np.uint32(part.mesh.count), self._materials]
        found.append(self._shared(look.material_ids[first:last]))
        if look.uvs:
            found += [self._shared(self._uv_rows[:, first:last]), self._uvs]
        if look.colours is not None:
            used = slice(None) if part.mesh.used is None else part.mesh.used
            found.append(self._shared(look.colours[used].astype(np.float32, copy=False)))
        if self.textured:
            found += self._texture_arguments
        return found

    def _shared(self, array: npt.NDArray[Any]) -> Any:
        return self.allocator.share(np.ascontiguousarray(array))

    @cached_property
    def _materials(self) -> Any:
        return self.allocator.upload(np.stack([_material_row(material) for material in self.look.materials]))

    @cached_property
    def _uv_rows(self) -> npt.NDArray[np.uint32]:
        """(sets, F, 3): rows of all sets together."""
        look = self.look
        starts = np.cumsum([0, *(len(uvs) for uvs in look.uvs)])
        if starts[-1] > 0xFFFFFFFF:
            raise InputError("look: more than 2^32 texture coordinates; leave some sets out")
        rows = look.uv_faces or (None,) * len(look.uvs)
        own = [self.mesh.faces if faces is None else faces for faces in rows]
        if len(own) == 1:
            return np.ascontiguousarray(own[0], np.uint32)[None]
        return np.stack(
            [faces + np.uint32(start) for faces, start in zip(own, starts[:-1], strict=True)], dtype=np.uint32
        )

    @cached_property
    def _uvs(self) -> Any:
        uvs = self.look.uvs
        joined = uvs[0] if len(uvs) == 1 else np.concatenate(uvs)
        return self._shared(joined.astype(np.float32, copy=False))

    @cached_property
    def _texture_arguments(self) -> list[Any]:
        textures = self.look.textures
        sizes = [texture.pixels.shape[0] * texture.pixels.shape[1] for texture in textures]
        firsts = np.cumsum([0, *sizes])
        rows = [
            structs.TEXTURE.pack(
                first=first,
                width=texture.pixels.shape[1],
                height=texture.pixels.shape[0],
                wrap=[_WRAPS[wrap] for wrap in texture.wrap],
                smooth=texture.smooth,
            )
            for texture, first in zip(textures, firsts[:-1], strict=True)
        ]
        texels = np.concatenate([texture.pixels.reshape(-1, 4) for texture in textures])
        upload = self.allocator.upload
        return [upload(np.stack(rows)), self._shared(texels), upload(decoded_srgb())]
