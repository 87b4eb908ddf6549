"""Scenes as pieces of one material each, for any renderer: as clgrid reads files, and as trimesh does."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from clgrid.errors import InputError
from clgrid.look import Look, Material, Wrap
from clgrid.mesh import Mesh

F32 = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Picture:
    """A texture: (H, W, 3) uint8 in sRGB, row 0 on top, and how it is looked up."""

    pixels: npt.NDArray[np.uint8]
    wrap: Wrap = "repeat"
    smooth: bool = True


@dataclass(frozen=True)
class Piece:
    """Triangles of one material.

    Attributes
    ----------
    vertices : (V, 3) float32
    faces : (F, 3) uint32
    triangles : (F,) int64
        Their numbers in clgrid's mesh; -1 where they are not known.
    normals : (V, 3) float32 or None
        Unit.
    uvs : (V, 2) float32 or None
        v downward, as the look-up takes them.
    picture : Picture or None
    colour : 3 floats
        Linear, times the picture.
    """

    vertices: F32
    faces: npt.NDArray[np.uint32]
    triangles: npt.NDArray[np.int64]
    normals: F32 | None
    uvs: F32 | None
    picture: Picture | None
    colour: tuple[float, float, float]


def pieces_of(mesh: Mesh, look: Look | None, grey: float) -> list[Piece]:
    """The pieces of a scene as clgrid has it; each corner is a vertex of its own.

    Raises
    ------
    InputError
        If the look has what pieces do not: vertex colours, or wraps that differ by axis.
    """
    if look is None:
        plain = Material(base_colour=(grey, grey, grey, 1.0))
        look = Look((plain,), np.zeros(mesh.triangle_count, np.uint16))
    if look.colours is not None:
        raise InputError(f"{mesh.source}: vertex colours are not compared; give another scene")
    groups = np.argsort(look.material_ids, kind="stable")
    ends = np.cumsum(np.bincount(look.material_ids, minlength=len(look.materials)))
    chosen = np.split(groups, ends[:-1])
    return [
        _piece(mesh, look, material, triangles)
        for material, triangles in zip(look.materials, chosen, strict=True)
        if len(triangles)
    ]


def _piece(mesh: Mesh, look: Look, material: Material, triangles: npt.NDArray[np.int64]) -> Piece:
    corners = mesh.faces[triangles].reshape(-1)
    use, picture, uvs = material.base_texture, None, None
    if look.uvs:
        number = 0 if use is None else use.uv_set
        rows = look.uv_faces[number] if look.uv_faces else None
        uvs = look.uvs[number][(mesh.faces if rows is None else rows)[triangles].reshape(-1)]
    if use is not None and uvs is not None:
        texture = look.textures[use.texture]
        if texture.wrap[0] != texture.wrap[1]:
            raise InputError(f"{mesh.source}: wraps that differ by axis are not compared; give another scene")
        picture = Picture(texture.pixels[..., :3], texture.wrap[0], texture.smooth)
        if use.transform is not None:
            uvs = (uvs @ use.transform[:, :2].T + use.transform[:, 2]).astype(np.float32)
    red, green, blue, _ = material.base_colour
    return Piece(
        vertices=mesh.vertices[corners].astype(np.float32),
        faces=np.arange(len(corners), dtype=np.uint32).reshape(-1, 3),
        triangles=triangles,
        normals=_normals(mesh, triangles),
        uvs=uvs,
        picture=picture,
        colour=(red, green, blue),
    )


def _normals(mesh: Mesh, triangles: npt.NDArray[np.int64]) -> F32 | None:
    """Unit normals of the corners; where a vertex has none, its triangle's."""
    if mesh.vertex_normals is None:
        return None
    faces = mesh.faces[triangles]
    own = mesh.vertex_normals[faces].astype(np.float64)
    corners = mesh.vertices[faces].astype(np.float64)
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat *= np.where((flat * own.sum(1)).sum(-1, keepdims=True) < 0.0, -1.0, 1.0)
    lengths = np.linalg.norm(own, axis=-1, keepdims=True)
    own = np.where(lengths > 0.0, own, flat[:, None, :])
    return unit(own).reshape(-1, 3).astype(np.float32)


def unit(vectors: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    """The vectors at length 1; zero ones stay."""
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.where(lengths > 0.0, lengths, 1.0), np.float64)


def pieces_by_trimesh(path: Path) -> list[Piece]:
    """The pieces of a glTF or OBJ file as trimesh reads it: its nodes, materials, pictures and coordinates.

    Its OBJ reader gives a position that has several normals one of them, so those are not taken.
    """
    import trimesh

    loaded: Any = trimesh.load(path, process=False)
    if isinstance(loaded, trimesh.Trimesh):
        nodes = [(loaded, np.eye(4))]
    else:
        places = (loaded.graph[node] for node in loaded.graph.nodes_geometry)
        nodes = [(loaded.geometry[name], matrix) for matrix, name in places]
    return [_trimesh_piece(mesh, matrix, path.suffix != ".obj") for mesh, matrix in nodes]


def _trimesh_piece(mesh: Any, matrix: npt.NDArray[np.float64], has_normals: bool) -> Piece:
    material = getattr(mesh.visual, "material", None)
    image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    factor = getattr(material, "baseColorFactor", None)
    if factor is None:
        factor = getattr(material, "diffuse", None)
    colour = (1.0, 1.0, 1.0)
    if factor is not None:
        red, green, blue = (float(part) / 255.0 for part in factor[:3])
        colour = (red, green, blue)
    uvs = getattr(mesh.visual, "uv", None)
    # trimesh keeps the normals of a file in its cache, and makes its own only when asked
    normals = mesh.vertex_normals if has_normals and "vertex_normals" in mesh._cache else None
    linear = matrix[:3, :3]
    return Piece(
        vertices=(mesh.vertices @ linear.T + matrix[:3, 3]).astype(np.float32),
        faces=np.asarray(mesh.faces, np.uint32),
        triangles=np.full(len(mesh.faces), -1),
        normals=None if normals is None else unit(normals @ np.linalg.inv(linear)).astype(np.float32),
        uvs=None if uvs is None else np.stack([uvs[:, 0], 1.0 - uvs[:, 1]], 1).astype(np.float32),
        picture=None if image is None or uvs is None else Picture(np.asarray(image.convert("RGB"))),
        colour=colour,
    )
