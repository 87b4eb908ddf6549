"""glTF 2.0 and GLB: the default scene, flattened into one mesh.

Read here and not through trimesh, which leaves out triangle strips and fans, lets indices beyond the vertices
and infinite vertices through, takes a cycle of nodes or a truncated GLB for an empty scene, opens textures.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from clgrid.errors import MeshError
from clgrid.mesh import MAX_COUNT
from clgrid.meshfile.content import Content
from clgrid.meshfile.gltf_accessors import Accessors, at
from clgrid.meshfile.gltf_document import UNREADABLE, open_document
from clgrid.meshfile.gltf_nodes import Matrix, Placed, placed_nodes
from clgrid.meshfile.gltf_schema import Gltf, Node, Primitive
from clgrid.meshfile.parts import Parts, empty
from clgrid.meshfile.polygons import IntArray, fan, strips

TRIANGLES, STRIP, FAN = 4, 5, 6


@dataclass(frozen=True)
class Piece:
    """Triangles of one primitive, in the coordinates of its node.

    Attributes
    ----------
    positions : (V, 3) float32 or float64
    normals : (V, 3) float32 or float64, or None
    triangles : (F, 3) int
    vertices_key : tuple
        Pieces of a node with the same key have the same vertices.
    """

    positions: npt.NDArray[np.floating]
    normals: npt.NDArray[np.floating] | None
    triangles: IntArray
    vertices_key: tuple[int, int | None]


@dataclass(frozen=True)
class Draw:
    """The pieces of one node."""

    placed: Placed
    name: str
    pieces: list[Piece]


def parse(data: Content, path: Path) -> Parts:
    """Read a glTF or GLB file: one geometry a primitive and node, transformed in float64.

    Vertices stay float32 where no node moves anything. Triangles of a mirroring node are turned, as glTF
    asks, so that their front stays their front. Textures are not opened.

    Raises
    ------
    MeshError
        If anything is malformed, missing (but textures), or out of range.
    """
    document = open_document(data, path)
    gltf = document.gltf
    accessors = Accessors(document)
    # without a mesh nothing else looks at the data, and "no triangles" must not cover up that it is broken
    accessors.check_all(contents=not gltf.meshes)
    warnings: dict[str, int] = {}
    cache: dict[int, list[Piece]] = {}
    draws = []
    for placed in _placed_meshes(gltf):
        number = placed.node.mesh
        if number is not None:
            record = at(gltf.meshes, number, "mesh", f"node {placed.number}")
            if number not in cache:
                cache[number] = _pieces(gltf, number, accessors, warnings)
            _note_left_out(placed.node, gltf, number, warnings)
            draws.append(Draw(placed, placed.node.name or record.name, cache[number]))
    lines = tuple(f"{what} ({count})" for what, count in warnings.items())
    lines += tuple(
        f"requires the glTF extension {name}, which is not read"
        for name in gltf.extensions_required
        if not name.startswith(
            ("KHR_materials", "KHR_texture", "EXT_texture", "KHR_lights", "KHR_mesh_quantization")
        )
    )
    if not any(len(piece.triangles) for draw in draws for piece in draw.pieces):
        return empty("the scene holds no triangles", *lines)
    return _flattened(draws, lines)


def _placed_meshes(gltf: Gltf) -> list[Placed]:
    """Nodes to draw; a file without nodes and scenes is a library of meshes, and all of them count."""
    if gltf.nodes or gltf.scenes:
        return placed_nodes(gltf)
    return [Placed(-1, Node(mesh=number), np.eye(4)) for number in range(len(gltf.meshes))]


def _note_left_out(node: Node, gltf: Gltf, mesh: int, warnings: dict[str, int]) -> None:
    """Count what would change the shape and is not applied."""
    left_out = {
        "skinned meshes are shown unposed": node.skin is not None,
        "meshes are shown without their morph targets": any(node.weights or gltf.meshes[mesh].weights),
        "nodes are shown once and not instanced": not UNREADABLE.isdisjoint(node.extensions),
    }
    for what, present in left_out.items():
        if present:
            warnings[what] = warnings.get(what, 0) + 1


def _pieces(gltf: Gltf, number: int, accessors: Accessors, warnings: dict[str, int]) -> list[Piece]:
    pieces = []
    for index, primitive in enumerate(gltf.meshes[number].primitives):
        where = f"mesh {number} primitive {index}"
        if primitive.mode in (TRIANGLES, STRIP, FAN) and "POSITION" in primitive.attributes:
            pieces.append(_piece(primitive, accessors, where))
        elif primitive.mode > FAN:
            raise MeshError(
                f"glTF {where} has the unknown mode {primitive.mode}; repair or re-export the file"
            )
        else:
            what = "left out: primitives without positions"
            if primitive.mode < TRIANGLES:
                what = "left out: primitives of points or lines"
            warnings[what] = warnings.get(what, 0) + 1
    return pieces


def _piece(primitive: Primitive, accessors: Accessors, where: str) -> Piece:
    position_number = primitive.attributes["POSITION"]
    normal_number = primitive.attributes.get("NORMAL")
    positions = _vectors(accessors, position_number, where)
    normals = None if normal_number is None else _vectors(accessors, normal_number, where)
    if normals is not None and len(normals) != len(positions):
        raise MeshError(
            f"glTF {where} has {len(normals)} normals for {len(positions)} positions; repair the file"
        )
    corners = _corners(primitive, accessors, len(positions), where)
    if primitive.mode == STRIP:
        triangles = strips(corners)
    elif primitive.mode == FAN:
        triangles = fan(corners)
    elif len(corners) % 3:
        raise MeshError(
            f"glTF {where} has {len(corners)} corners, not whole triangles; repair or re-export the file"
        )
    else:
        triangles = corners.reshape(-1, 3)
    return Piece(positions, normals, triangles, (position_number, normal_number))


def _vectors(accessors: Accessors, number: int, where: str) -> npt.NDArray[np.floating]:
    values = accessors.scaled(number, where)
    if values.ndim != 2 or values.shape[1] != 3:
        raise MeshError(
            f"glTF {where} has {values.shape[1]}-component vectors in accessor {number}; repair the file"
        )
    return values


def _corners(primitive: Primitive, accessors: Accessors, count: int, where: str) -> IntArray:
    """Vertex of each corner, all below ``count``."""
    if primitive.indices is None:
        return np.arange(count)
    stored = accessors.array(primitive.indices, where)
    if stored.dtype.kind != "u" or stored.shape[1] != 1:
        raise MeshError(
            f"glTF {where} has indices that are no unsigned scalars; repair or re-export the file"
        )
    corners: IntArray = np.ascontiguousarray(stored.reshape(-1).astype(stored.dtype.newbyteorder("=")))
    if len(corners) and int(corners.max()) >= count:
        bad = np.flatnonzero(corners >= count)
        raise MeshError(
            f"glTF {where}: {len(bad)} of {len(corners)} indices name a missing vertex, "
            f"first index {bad[0]}: vertex {corners[bad[0]]} of {count}; repair or re-export the file"
        )
    return corners


def _flattened(draws: list[Draw], warnings: tuple[str, ...]) -> Parts:
    """All draws in one set of arrays, allocated once and only when their size is known to be possible."""
    vertex_count = sum(len(positions) for draw in draws for positions in _distinct(draw).values())
    face_count = sum(len(piece.triangles) for draw in draws for piece in draw.pieces)
    moved = any(not np.array_equal(draw.placed.world, np.eye(4)) for draw in draws)
    doubles = moved or any(piece.positions.dtype == np.float64 for draw in draws for piece in draw.pieces)
    with_normals = any(piece.normals is not None for draw in draws for piece in draw.pieces)
    _require_possible(vertex_count, face_count, 12 * (1 + doubles * 2 + with_normals))
    vertices = np.empty((vertex_count, 3), np.float64 if doubles else np.float32)
    normals = np.zeros((vertex_count, 3), np.float32) if with_normals else None
    faces = np.empty((face_count, 3), np.uint32)
    starts, names = [0], []
    vertex = face = 0
    for draw in draws:
        world = draw.placed.world
        turned = _orientation(world) < 0
        offsets: dict[tuple[int, int | None], int] = {}
        for piece in draw.pieces:
            if piece.vertices_key not in offsets:
                offsets[piece.vertices_key] = vertex
                rows = slice(vertex, vertex + len(piece.positions))
                _move_points(piece.positions, world, vertices[rows])
                if normals is not None and piece.normals is not None:
                    _move_normals(piece.normals, world, normals[rows])
                vertex += len(piece.positions)
            target = faces[face : face + len(piece.triangles)]
            target[:] = piece.triangles[:, [0, 2, 1]] if turned else piece.triangles
            target += np.uint32(offsets[piece.vertices_key])
            face += len(target)
            starts.append(face)
            names.append(draw.name)
    return Parts(
        vertices, faces, normals, np.array(starts, np.int64), tuple(names), warnings=warnings, untyped=doubles
    )


def _distinct(draw: Draw) -> dict[tuple[int, int | None], npt.NDArray[np.floating]]:
    """Vertex arrays of a draw; primitives that share accessors share vertices."""
    return {piece.vertices_key: piece.positions for piece in draw.pieces}


def _require_possible(vertices: int, faces: int, vertex_bytes: int) -> None:
    """Refuse scenes that instances blow up beyond 32-bit indices or beyond the memory of the machine."""
    if max(vertices, faces) > MAX_COUNT:
        raise MeshError(
            f"places {faces} triangles and {vertices} vertices, at most {MAX_COUNT} fit; split the scene"
        )
    needed = vertices * vertex_bytes + faces * 12
    if hasattr(os, "sysconf"):
        memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
        if needed > memory:
            raise MeshError(f"places {faces} triangles, {needed >> 20} MiB of arrays; use a smaller scene")


def _orientation(world: Matrix) -> float:
    """Determinant of the linear part: negative where the node mirrors."""
    a, b, c = world[:3, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        return float((a * _cross(b, c)).sum())


def _cross(a: Matrix, b: Matrix) -> Matrix:
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _move_points(points: npt.NDArray[np.floating], world: Matrix, out: npt.NDArray[np.floating]) -> None:
    """Write world positions into ``out``: float64 sums in a fixed order, so that all machines agree."""
    if np.array_equal(world, np.eye(4)):
        out[:] = points
        return
    x, y, z = (points[:, axis].astype(np.float64) for axis in range(3))
    with np.errstate(over="ignore", invalid="ignore"):
        for axis in range(3):
            row = world[axis]
            out[:, axis] = ((x * row[0] + y * row[1]) + z * row[2]) + row[3]


def _move_normals(normals: npt.NDArray[np.floating], world: Matrix, out: npt.NDArray[np.float32]) -> None:
    """Write unit world normals into ``out``, by the inverse transpose; as they are where nothing moves.

    The inverse transpose is the matrix of cofactors over the determinant; only the sign of the latter matters
    for unit normals, and a node that flattens (determinant 0) has cofactors where it has no inverse.
    """
    if np.array_equal(world, np.eye(4)):
        out[:] = normals
        return
    linear = world[:3, :3]
    largest = float(np.abs(linear).max())
    moved = np.empty((len(normals), 3), np.float64)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        a, b, c = linear / largest if 0 < largest < np.inf else linear
        cofactors = np.stack([_cross(b, c), _cross(c, a), _cross(a, b)])
        if _orientation(world) < 0:
            cofactors = -cofactors
        x, y, z = (normals[:, axis].astype(np.float64) for axis in range(3))
        for axis in range(3):
            moved[:, axis] = (x * cofactors[axis, 0] + y * cofactors[axis, 1]) + z * cofactors[axis, 2]
        length = np.sqrt((moved * moved).sum(axis=1, keepdims=True))
        out[:] = np.where(length > 0, moved / length, 0.0)
