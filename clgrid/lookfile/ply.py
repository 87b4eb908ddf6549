"""The look of PLY files: colours of vertices, and a texture that a comment names."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from clgrid.colour import linear
from clgrid.look import Look, Material, TextureUse
from clgrid.lookfile import require_same
from clgrid.lookfile.names import find_beside
from clgrid.lookfile.pictures import Allowance, PictureError, Pixels, read_picture
from clgrid.lookfile.shelf import Shelf
from clgrid.mesh import Mesh
from clgrid.meshfile.content import Content
from clgrid.meshfile.ply import index_lists, read_tables
from clgrid.meshfile.ply_header import Element, Header, read_header
from clgrid.meshfile.ply_tables import Table
from clgrid.meshfile.polygons import fans

Floats = npt.NDArray[np.float32]

_COLOURS = (("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"), ("r", "g", "b"))
_UVS = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"), ("texture_s", "texture_t"))
_OF_CORNERS = ("texcoord", "texcoords")


def read(data: Content, path: Path, mesh: Mesh) -> Look | None:
    """Read the look of the file that `clgrid.meshfile.ply` makes a mesh of.

    Colours in integers are sRGB, colours in floats linear light.

    Raises
    ------
    MeshError
        If the file is malformed, or holds another mesh by now.
    """
    header = read_header(data)
    vertex = next((element for element in header.elements if element.name == "vertex"), None)
    picture = picture_name(header)
    if not header.has_faces or vertex is None or not (_named(vertex, _COLOURS) or picture):
        return None
    tables = read_tables(data, header)
    require_same(mesh, vertex.count, mesh.triangle_count)
    shelf = Shelf(path)
    colours = _colours(vertex, tables["vertex"], shelf)
    material, uvs, uv_faces = Material(), [], []
    if picture:
        uv, of_corners = _coordinates(vertex, header, tables, mesh, shelf)
        if uv is None:
            shelf.warn(f"left out: texture {picture!r}, for which there are no coordinates")
        else:
            number = shelf.texture(picture, picture, lambda allowance: _read(path, picture, allowance))
            material, uvs, uv_faces = Material(base_texture=TextureUse(number)), [uv], [of_corners]
    if colours is None and material == Material() and not shelf.has_warnings:
        return None
    return shelf.look([material], np.zeros(mesh.triangle_count, np.int64), uvs, uv_faces, colours)


def picture_name(header: Header) -> str:
    """Name after ``TextureFile``; the first of them, as faces have one texture here."""
    found = [line.split(None, 1) for line in header.comments if line.lower().startswith("texturefile")]
    return next((words[1].strip() for words in found if len(words) > 1), "")


def _read(path: Path, name: str, allowance: Allowance) -> Pixels:
    found = find_beside(path.parent, name)
    if found is None:
        raise PictureError("is missing")
    return read_picture(found, allowance)


def _named(element: Element, choices: tuple[tuple[str, ...], ...]) -> tuple[str, ...]:
    """The first choice of which the element has all as single values; empty where there is none."""
    single = {entry.name for entry in element.properties if entry.count_type is None}
    return next((names for names in choices if single.issuperset(names)), ())


def _colours(element: Element, table: Table, shelf: Shelf) -> Floats | None:
    """(V, 4) linear colours, None where there are none."""
    names = _named(element, _COLOURS)
    if not names or not element.count:
        return None
    colours = np.ones((element.count, 4), np.float32)
    prefix = names[0].removesuffix("red") if names[0] != "r" else ""
    alpha = next((name for name in (f"{prefix}alpha", "alpha", "a") if _named(element, ((name,),))), None)
    for channel, name in enumerate((*names, alpha) if alpha else names):
        entry = element.find(name)
        values = np.asarray(table.values[name], np.float64)
        if entry is not None and not entry.type.startswith("f"):
            values = np.clip(values / np.iinfo(entry.type).max, 0.0, 1.0)
            values = linear(values) if channel < 3 else values
        with np.errstate(over="ignore", invalid="ignore"):
            colours[:, channel] = values
    return np.clip(shelf.finite(colours, "vertex colours"), 0, None)


def _coordinates(
    vertex: Element, header: Header, tables: dict[str, Table], mesh: Mesh, shelf: Shelf
) -> tuple[Floats | None, npt.NDArray[np.uint32] | None]:
    """(U, 2) from the top left corner, of vertices or else of corners, and which corner has which."""
    names = _named(vertex, _UVS)
    if names and vertex.count:
        pairs = [np.asarray(tables["vertex"].values[name], np.float64) for name in names]
        return _from_the_top(np.stack(pairs, axis=1), shelf), None
    face = next((element for element in header.elements if element.name == "face"), None)
    listed = None if face is None else face.find(*_OF_CORNERS)
    if face is None or listed is None or listed.count_type is None or not face.count:
        return None, None
    flat, numbers = tables["face"].lists[listed.name]
    _, corners = index_lists(face, tables["face"])
    triangles = fans(np.arange(int(corners.sum())), corners)
    if not np.array_equal(numbers, 2 * corners) or len(triangles) != mesh.triangle_count:
        return None, None
    return _from_the_top(flat.astype(np.float64).reshape(-1, 2), shelf), triangles.astype(np.uint32)


def _from_the_top(pairs: npt.NDArray[np.float64], shelf: Shelf) -> Floats:
    """Texture coordinates with v downwards: PLY has it upwards."""
    with np.errstate(over="ignore", invalid="ignore"):
        uv = np.stack([pairs[:, 0], 1.0 - pairs[:, 1]], axis=1).astype(np.float32)
    return shelf.finite(uv, "texture coordinates")
