"""glTF 2.0 and GLB: the default scene, flattened into one mesh.

Read here and not through trimesh, which leaves out triangle strips and fans, lets indices beyond the vertices
and infinite vertices through, takes a cycle of nodes or a truncated GLB for an empty scene, opens textures.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import numpy.typing as npt

from clgrid.errors import MeshError
from clgrid.mesh import MAX_COUNT
from clgrid.meshfile.content import Content
from clgrid.meshfile.gltf_accessors import Accessors
from clgrid.meshfile.gltf_draws import Draw, Drawn, Rows, draw_file, morphed
from clgrid.meshfile.gltf_nodes import Matrix
from clgrid.meshfile.gltf_skins import matrices, skinned_normals, skinned_points
from clgrid.meshfile.parts import Parts, empty


def parse(data: Content, path: Path) -> Parts:
    """Read a glTF or GLB file: one geometry a primitive and node, transformed in float64.

    Morph targets and skins are applied as the file has them at rest. Vertices stay float32 where nothing
    moves them. Triangles of a mirroring node are turned, as glTF asks, so that their front stays their front.
    Textures are not opened.

    Raises
    ------
    MeshError
        If anything is malformed, missing (but textures), or out of range.
    """
    drawn = draw_file(data, path)
    gltf, draws = drawn.document.gltf, drawn.draws
    lines = drawn.warnings + tuple(
        f"requires the glTF extension {name}, which is not read"
        for name in gltf.extensions_required
        if not name.startswith(
            ("KHR_materials", "KHR_texture", "EXT_texture", "KHR_lights", "KHR_mesh_quantization")
        )
    )
    if not any(len(piece.triangles) for draw in draws for piece in draw.pieces):
        return empty("the scene holds no triangles", *lines)
    return _flattened(drawn, lines)


def _flattened(drawn: Drawn, warnings: tuple[str, ...]) -> Parts:
    """All draws in one set of arrays, allocated once and only when their size is known to be possible."""
    rows = list(drawn.rows())
    vertex_count, face_count = max(row.vertices.stop for row in rows), rows[-1].faces.stop
    doubles = any(_moves(row.draw) or row.piece.positions.dtype == np.float64 for row in rows)
    with_normals = any(row.piece.normals is not None for row in rows)
    _require_possible(vertex_count, face_count, 12 * (1 + doubles * 2 + with_normals))
    vertices = np.empty((vertex_count, 3), np.float64 if doubles else np.float32)
    normals = np.zeros((vertex_count, 3), np.float32) if with_normals else None
    faces = np.empty((face_count, 3), np.uint32)
    for row in rows:
        piece = row.piece
        if row.first:
            place_points(row, drawn.accessors, vertices[row.vertices])
            if normals is not None:
                _place_normals(row, drawn.accessors, normals[row.vertices])
        target = faces[row.faces]
        target[:] = piece.triangles[:, [0, 2, 1]] if _turned(row) else piece.triangles
        target += np.uint32(row.vertices.start)
    starts = np.array([0, *(row.faces.stop for row in rows)], np.int64)
    names = tuple(row.draw.name for row in rows)
    return Parts(vertices, faces, normals, starts, names, warnings=warnings, untyped=doubles)


def place_points(row: Rows, accessors: Accessors, out: npt.NDArray[np.floating]) -> None:
    """Write the positions of a piece, as its draw morphs and places it, into ``out``."""
    piece, draw = row.piece, row.draw
    positions = morphed(piece.positions, "POSITION", piece, draw.weights, accessors)
    pose = draw.skins(piece)
    if pose is None:
        _move_points(positions, draw.placed.world, out)
        return
    moves = matrices(pose, piece.primitive, len(positions), accessors, piece.where)
    with np.errstate(over="ignore"):
        out[:] = skinned_points(positions, moves)


def _place_normals(row: Rows, accessors: Accessors, out: npt.NDArray[np.float32]) -> None:
    """Write the normals of a piece, as `place_points` does its positions."""
    piece, draw = row.piece, row.draw
    if piece.normals is None:
        return
    normals = morphed(piece.normals, "NORMAL", piece, draw.weights, accessors)
    pose = draw.skins(piece)
    if pose is None:
        _move_normals(normals, draw.placed.world, out)
    else:
        moves = matrices(pose, piece.primitive, len(normals), accessors, piece.where)
        out[:] = skinned_normals(normals, moves)


def _turned(row: Rows) -> bool:
    """Whether the triangles of a piece are mirrored by its node; a skin's joints are taken not to mirror."""
    return row.draw.skins(row.piece) is None and _orientation(row.draw.placed.world) < 0


def _moves(draw: Draw) -> bool:
    """Whether positions are not those of the file."""
    return draw.pose is not None or any(draw.weights) or not np.array_equal(draw.placed.world, np.eye(4))


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
