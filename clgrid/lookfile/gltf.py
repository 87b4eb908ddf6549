"""The look of glTF scenes: materials a primitive, texture coordinates and colours a vertex, lights a node."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from clgrid.errors import MeshError
from clgrid.look import Look, Material
from clgrid.lookfile import require_same
from clgrid.lookfile.gltf_lights import lights_of
from clgrid.lookfile.gltf_materials import Materials
from clgrid.lookfile.shelf import Shelf
from clgrid.mesh import Mesh
from clgrid.meshfile.content import Content
from clgrid.meshfile.gltf_draws import Drawn, Rows, draw_file

Floats = npt.NDArray[np.float32]
# What glTF gives primitives without a material.
DEFAULT = Material(double_sided=False)


def read(data: Content, path: Path, mesh: Mesh) -> Look | None:
    """Read the look of the scene that `clgrid.meshfile.gltf` makes a mesh of.

    Raises
    ------
    MeshError
        If anything is malformed but pictures, or the file holds another mesh by now.
    """
    drawn = draw_file(data, path)
    rows = list(drawn.rows())
    faces = rows[-1].faces.stop if rows else 0
    if not faces:
        rows = []
    require_same(mesh, max((row.vertices.stop for row in rows), default=0), faces)
    shelf = Shelf(path)
    reader = Materials(drawn, shelf)
    used = sorted({row.piece.primitive.material for row in rows}, key=lambda k: -1 if k is None else k)
    materials = [DEFAULT if number is None else reader.material(number) for number in used] or [DEFAULT]
    ids = np.zeros(faces, np.int64)
    for row in rows:
        ids[row.faces] = used.index(row.piece.primitive.material)
    uvs = [_coordinates(drawn, rows, number, materials, used, shelf) for number in reader.uv_sets]
    colours = _colours(drawn, rows, len(mesh.vertices), shelf)
    lights = lights_of(drawn.document.gltf, drawn.placed, shelf)
    plain = all(_plain(material) for material in materials)
    if plain and colours is None and not lights and not shelf.has_warnings:
        return None
    return shelf.look(materials, ids, uvs, [None] * len(uvs), colours, lights)


def _plain(material: Material) -> bool:
    """Whether a picture shows nothing of the material; which sides it has is none of its look."""
    return material == Material(name=material.name, double_sided=material.double_sided)


def _coordinates(
    drawn: Drawn,
    rows: list[Rows],
    number: int,
    materials: list[Material],
    used: list[int | None],
    shelf: Shelf,
) -> Floats:
    """(V, 2) of one TEXCOORD set; zero where a primitive has none."""
    name = f"TEXCOORD_{number}"
    uv = np.zeros((max(row.vertices.stop for row in rows), 2), np.float32)
    for row in rows:
        if name in row.piece.primitive.attributes:
            if row.first:
                uv[row.vertices] = _attribute(drawn, row, name, (2,))
        elif _has_texture(materials[used.index(row.piece.primitive.material)]):
            shelf.warn(f"primitives with a texture and without {name}, which is taken as 0")
    return shelf.finite(uv, name)


def _has_texture(material: Material) -> bool:
    return material.base_texture is not None or material.emissive_texture is not None


def _colours(drawn: Drawn, rows: list[Rows], count: int, shelf: Shelf) -> Floats | None:
    """(V, 4) linear colours, white where a primitive has none; None where none has."""
    coloured = [row for row in rows if row.first and "COLOR_0" in row.piece.primitive.attributes]
    if not coloured:
        return None
    colours = np.ones((count, 4), np.float32)
    for row in coloured:
        values = _attribute(drawn, row, "COLOR_0", (3, 4))
        colours[row.vertices, : values.shape[1]] = values
    return np.clip(shelf.finite(colours, "vertex colours"), 0, None)


def _attribute(drawn: Drawn, row: Rows, name: str, widths: tuple[int, ...]) -> npt.NDArray[np.floating]:
    """Values of an attribute, one row a vertex; integers of colours stand for 0 to 1, said or not."""
    piece = row.piece
    number = piece.primitive.attributes[name]
    values = drawn.accessors.scaled(number, piece.where)
    accessor = drawn.document.gltf.accessors[number]
    if name == "COLOR_0" and not accessor.normalized and accessor.component_type != 5126:
        stored = drawn.accessors.array(number, piece.where)
        values = stored.astype(np.float64) / np.iinfo(stored.dtype.str).max
    if values.shape[1] not in widths or len(values) != len(piece.positions):
        raise MeshError(
            f"glTF {piece.where} has {name} of shape {values.shape} for {len(piece.positions)} vertices; "
            "repair or re-export the file"
        )
    return values
