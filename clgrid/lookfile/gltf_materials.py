"""Materials of glTF files, their textures and images."""

from __future__ import annotations

import base64
import binascii
import math
from collections.abc import Callable
from typing import Any, TypeVar
from urllib.parse import unquote, urlsplit

import msgspec
import numpy as np

from clgrid.errors import MeshError
from clgrid.look import AlphaMode, Material, TextureUse, Wrap
from clgrid.lookfile.names import find_beside
from clgrid.lookfile.pictures import Allowance, PictureError, Pixels, read_picture, unpack_picture
from clgrid.lookfile.shelf import BLACK, MAGENTA, Shelf, Texel
from clgrid.meshfile.gltf_accessors import at
from clgrid.meshfile.gltf_draws import Drawn
from clgrid.meshfile.gltf_schema import (
    Extensions,
    Image,
    Metallic,
    Record,
    Sampler,
    TextureInfo,
    TextureTransform,
    Vector4,
)
from clgrid.meshfile.gltf_schema import Material as MaterialRecord

_WRAPS: dict[int, Wrap] = {10497: "repeat", 33648: "mirror", 33071: "clamp"}
_NEAREST = (9728, 9984, 9986)
_ALPHA_MODES: dict[str, AlphaMode] = {"OPAQUE": "opaque", "MASK": "mask", "BLEND": "blend"}
_OTHER_IMAGES = ("EXT_texture_webp", "MSFT_texture_dds", "KHR_texture_basisu")
_KIND = TypeVar("_KIND")


class _Strength(Record):
    emissive_strength: float = 1.0


class _Glossy(Record):
    diffuse_factor: Vector4 | None = None
    diffuse_texture: TextureInfo | None = None


class Materials:
    """The materials of one document; textures and sets of uv are numbered as they are asked for."""

    def __init__(self, drawn: Drawn, shelf: Shelf) -> None:
        self._gltf = drawn.document.gltf
        self._folder = drawn.document.path.parent
        self._accessors = drawn.accessors
        self._shelf = shelf
        self.uv_sets: list[int] = []

    def material(self, number: int) -> Material:
        """Material ``number`` of the document.

        Raises
        ------
        MeshError
            If a reference dangles or an extension is malformed.
        """
        record = at(self._gltf.materials, number, "material", "primitive")
        where = f"material {number}"
        colour = record.pbr_metallic_roughness or self._glossy(record, where)
        strength = extension(record.extensions, "KHR_materials_emissive_strength", _Strength, where)
        factor = (strength or _Strength()).emissive_strength
        red, green, blue = (
            self._number(factor * value, where) for value in record.emissive_factor or (0, 0, 0)
        )
        r, g, b, a = (self._number(value, where) for value in colour.base_color_factor or (1, 1, 1, 1))
        glows = any((red, green, blue))
        if record.alpha_mode not in _ALPHA_MODES:
            unknown = record.alpha_mode[:20]
            self._shelf.warn(f"{where} has the unknown alpha mode {unknown!r}, taken as OPAQUE")
        return Material(
            name=record.name,
            base_colour=(r, g, b, a),
            base_texture=self._use(colour.base_color_texture, where, MAGENTA),
            emissive=(red, green, blue),
            emissive_texture=self._use(record.emissive_texture, where, BLACK) if glows else None,
            alpha_mode=_ALPHA_MODES.get(record.alpha_mode, "opaque"),
            alpha_cutoff=self._number(record.alpha_cutoff, where),
            double_sided=record.double_sided,
        )

    def _glossy(self, record: MaterialRecord, where: str) -> Metallic:
        """Diffuse colour of the older way to write materials, in place of the base colour."""
        glossy = extension(record.extensions, "KHR_materials_pbrSpecularGlossiness", _Glossy, where)
        if glossy is None:
            return Metallic()
        return Metallic(glossy.diffuse_factor, glossy.diffuse_texture)

    def _number(self, value: float, where: str) -> float:
        if math.isfinite(value) and value >= 0:
            return float(value)
        self._shelf.warn(f"{where} has a factor of {value:g}, taken as 0")
        return 0.0

    def _use(self, info: TextureInfo | None, where: str, stand_in: Texel) -> TextureUse | None:
        if info is None:
            return None
        if info.index is None:
            raise MeshError(f"glTF {where} uses a texture without saying which; repair or re-export the file")
        moved = extension(info.extensions, "KHR_texture_transform", TextureTransform, where)
        uv_set = info.tex_coord if moved is None or moved.tex_coord is None else moved.tex_coord
        if uv_set not in self.uv_sets:
            self.uv_sets.append(uv_set)
        matrix = None if moved is None else _matrix(moved)
        if matrix is not None and not np.isfinite(matrix).all():
            self._shelf.warn(f"{where} has a texture transform that is not finite, left out")
            matrix = None
        return TextureUse(self._texture(info.index, where, stand_in), self.uv_sets.index(uv_set), matrix)

    def _texture(self, number: int, where: str, stand_in: Texel) -> int:
        texture = at(self._gltf.textures, number, "texture", where)
        sampler = Sampler()
        if texture.sampler is not None:
            sampler = at(self._gltf.samplers, texture.sampler, "sampler", f"texture {number}")
        source = texture.source
        for name in _OTHER_IMAGES:
            other = texture.extensions.get(name)
            if source is None and isinstance(other, dict) and isinstance(other.get("source"), int):
                source = max(0, other["source"])
        filters = sampler.min_filter if sampler.mag_filter is None else sampler.mag_filter
        wrap = (self._wrap(sampler.wrap_s), self._wrap(sampler.wrap_t))
        if source is None:
            return self._shelf.texture(
                ("none", number), f"texture {number}", _nothing, wrap, filters not in _NEAREST, stand_in
            )
        image = at(self._gltf.images, source, "image", f"texture {number}")
        name = texture.name or image.name or _short(image.uri) or f"image {source}"
        decode = self._decoder(image, source)
        return self._shelf.texture(source, name, decode, wrap, filters not in _NEAREST, stand_in)

    def _wrap(self, number: int) -> Wrap:
        if number not in _WRAPS:
            self._shelf.warn(f"a sampler has the unknown wrap mode {number}, taken as repeat")
        return _WRAPS.get(number, "repeat")

    def _decoder(self, image: Image, number: int) -> Callable[[Allowance], Pixels]:
        """What decodes an image: from the file, a data URI or a buffer view."""
        if image.uri is None and image.buffer_view is None:
            return _nothing
        if image.uri is None:
            view = image.buffer_view or 0
            return lambda allowance: unpack_picture(
                self._accessors.view_bytes(view, f"image {number}"), allowance
            )
        return lambda allowance: self._of_uri(image.uri or "", allowance)

    def _of_uri(self, uri: str, allowance: Allowance) -> Pixels:
        if uri.startswith("data:"):
            try:
                data = base64.b64decode(uri.partition(",")[2], validate=True)
            except (binascii.Error, ValueError):
                raise PictureError("is no base64 data") from None
            return unpack_picture(data, allowance)
        if len(urlsplit(uri).scheme) > 1:
            raise PictureError("is not named relative to the file, and nothing is fetched from elsewhere")
        found = find_beside(self._folder, unquote(uri))
        if found is None:
            raise PictureError("is missing")
        return read_picture(found, allowance)


def extension(extensions: Extensions, name: str, kind: type[_KIND], where: str) -> _KIND | None:
    """Content of an extension, None where it is not used.

    Raises
    ------
    MeshError
        If its members are of the wrong types.
    """
    content: Any = extensions.get(name)
    if content is None:
        return None
    try:
        return msgspec.convert(content, kind)
    except msgspec.ValidationError as error:
        raise MeshError(f"glTF {where} has a malformed {name}: {error}; repair the file") from error


def _matrix(moved: TextureTransform) -> Any:
    """(2, 3) offset * rotation * scale; None where it does nothing."""
    c, s = math.cos(moved.rotation), math.sin(moved.rotation)
    (du, dv), (su, sv) = moved.offset, moved.scale
    matrix = np.array([[c * su, s * sv, du], [-s * su, c * sv, dv]])
    return None if np.array_equal(matrix, np.eye(2, 3)) else matrix


def _nothing(allowance: Allowance) -> Pixels:
    raise PictureError("names no image that can be read")


def _short(uri: str | None) -> str:
    return "" if uri is None or uri.startswith("data:") else unquote(uri)
