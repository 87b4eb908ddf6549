"""What a glTF scene draws: the pieces of each node, in the order that mesh, look and frames share."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from clgrid.errors import MeshError
from clgrid.meshfile.content import Content
from clgrid.meshfile.gltf_accessors import Accessors, at
from clgrid.meshfile.gltf_document import UNREADABLE, Document, open_document
from clgrid.meshfile.gltf_nodes import Placed, placed_nodes
from clgrid.meshfile.gltf_schema import Gltf, Node, Primitive
from clgrid.meshfile.gltf_skins import Pose, is_skinned, pose_of
from clgrid.meshfile.polygons import IntArray, fan, strips

TRIANGLES, STRIP, FAN = 4, 5, 6


# Attributes by which vertices differ; primitives that share all of these share vertices.
_TELLING = ("POSITION", "NORMAL", "TEXCOORD_", "COLOR_0", "JOINTS_", "WEIGHTS_")

VerticesKey = tuple[tuple[tuple[str, int], ...], ...]


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
    primitive : Primitive
        What it was made of.
    where : str
        Mesh and primitive, for messages.
    """

    positions: npt.NDArray[np.floating]
    normals: npt.NDArray[np.floating] | None
    triangles: IntArray
    vertices_key: VerticesKey
    primitive: Primitive
    where: str


@dataclass(frozen=True)
class Draw:
    """The pieces of one node, the weights of their morph targets, and the pose of its skin if it has one."""

    placed: Placed
    name: str
    pieces: list[Piece]
    weights: list[float]
    pose: Pose | None = None

    def skins(self, piece: Piece) -> Pose | None:
        """The pose that a piece follows in place of its node."""
        return self.pose if is_skinned(piece.primitive) else None


@dataclass(frozen=True)
class Rows:
    """Where a piece of a draw lies in the arrays of the whole scene.

    Attributes
    ----------
    vertices, faces : slice
        Of ``Mesh.vertices`` and of ``Mesh.faces``.
    first : bool
        Whether no piece before it has these vertices.
    """

    draw: Draw
    piece: Piece
    vertices: slice
    faces: slice
    first: bool


@dataclass(frozen=True)
class Drawn:
    """A file and what its scene draws."""

    document: Document
    accessors: Accessors
    placed: list[Placed]
    draws: list[Draw]
    warnings: tuple[str, ...]

    def rows(self) -> Iterator[Rows]:
        """Each piece of each draw with its rows: the one order of vertices and triangles."""
        vertex = face = 0
        for draw in self.draws:
            begun: dict[VerticesKey, slice] = {}
            for piece in draw.pieces:
                first = piece.vertices_key not in begun
                if first:
                    begun[piece.vertices_key] = slice(vertex, vertex + len(piece.positions))
                    vertex += len(piece.positions)
                faces = slice(face, face + len(piece.triangles))
                face = faces.stop
                yield Rows(draw, piece, begun[piece.vertices_key], faces, first)


def draw_file(data: Content, path: Path) -> Drawn:
    """Open a file and gather what it draws.

    Raises
    ------
    MeshError
        If anything that places triangles is malformed, missing or out of range.
    """
    document = open_document(data, path)
    gltf = document.gltf
    accessors = Accessors(document)
    # without a mesh nothing else looks at the data, and "no triangles" must not cover up that it is broken
    accessors.check_all(contents=not gltf.meshes)
    warnings: dict[str, int] = {}
    cache: dict[int, list[Piece]] = {}
    draws = []
    placed_all = _placed(gltf)
    for placed in placed_all:
        number = placed.node.mesh
        if number is not None:
            record = at(gltf.meshes, number, "mesh", f"node {placed.number}")
            if number not in cache:
                cache[number] = _pieces(gltf, number, accessors, warnings)
            _note_left_out(placed.node, warnings)
            name = placed.node.name or record.name
            weights = weights_of(placed.node, gltf)
            pose = _pose(placed.node, gltf, placed_all, accessors)
            draws.append(Draw(placed, name, cache[number], weights, pose))
    lines = tuple(f"{what} ({count})" for what, count in warnings.items())
    return Drawn(document, accessors, placed_all, draws, lines)


def _pose(node: Node, gltf: Gltf, placed: list[Placed], accessors: Accessors) -> Pose | None:
    return None if node.skin is None else pose_of(gltf, node.skin, placed, accessors)


def redrawn(drawn: Drawn, placed: list[Placed]) -> Drawn:
    """The same draws with their nodes placed elsewhere; ``placed`` holds the same nodes in the same order."""
    gltf = drawn.document.gltf
    by_number = {each.number: each for each in placed}
    draws = [
        replace(
            draw,
            placed=place,
            weights=weights_of(place.node, gltf),
            pose=_pose(place.node, gltf, placed, drawn.accessors),
        )
        for draw in drawn.draws
        for place in [by_number.get(draw.placed.number, draw.placed)]
    ]
    return replace(drawn, placed=placed, draws=draws)


def weights_of(node: Node, gltf: Gltf) -> list[float]:
    """Weights of the morph targets of a node's mesh: its own, else those of the mesh."""
    return node.weights or (gltf.meshes[node.mesh].weights if node.mesh is not None else [])


def morphed(
    values: npt.NDArray[np.floating], attribute: str, piece: Piece, weights: list[float], accessors: Accessors
) -> npt.NDArray[np.floating]:
    """Positions or normals of a piece with its morph targets added: as they are where no weight counts.

    Raises
    ------
    MeshError
        If a target is malformed or of another length.
    """
    moved = values
    for weight, target in zip(weights, piece.primitive.targets, strict=False):
        if weight != 0 and attribute in target:
            change = _vectors(accessors, target[attribute], piece.where)
            if len(change) != len(values):
                raise MeshError(
                    f"glTF {piece.where} has a morph target of {len(change)} rows for {len(values)}; "
                    "repair the file"
                )
            with np.errstate(over="ignore", invalid="ignore"):
                moved = moved + weight * change.astype(np.float64)
    return moved


def _placed(gltf: Gltf) -> list[Placed]:
    """Nodes to draw; a file without nodes and scenes is a library of meshes, and all of them count."""
    if gltf.nodes or gltf.scenes:
        return placed_nodes(gltf)
    return [Placed(-1, Node(mesh=number), np.eye(4)) for number in range(len(gltf.meshes))]


def _note_left_out(node: Node, warnings: dict[str, int]) -> None:
    """Count what would change the shape and is not applied."""
    if not UNREADABLE.isdisjoint(node.extensions):
        what = "nodes are shown once and not instanced"
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
    return Piece(positions, normals, triangles, _vertices_key(primitive), primitive, where)


def _vertices_key(primitive: Primitive) -> VerticesKey:
    own = sorted(item for item in primitive.attributes.items() if item[0].startswith(_TELLING))
    return (tuple(own), *(tuple(sorted(target.items())) for target in primitive.targets))


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
