"""The node tree of a glTF scene, flattened: each node that is drawn with its matrix to the world."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgrid.errors import MeshError
from clgrid.meshfile.gltf_accessors import at
from clgrid.meshfile.gltf_schema import Gltf, Node

Matrix = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Placed:
    """A node and where it stands.

    Attributes
    ----------
    number : int
        Of the node.
    node : Node
    world : (4, 4) float64
        Node to world, for column vectors.
    """

    number: int
    node: Node
    world: Matrix


def placed_nodes(gltf: Gltf, poses: Mapping[int, Node] | None = None) -> list[Placed]:
    """Nodes of the default scene in depth-first order; of all scenes' trees where no scene is defined.

    ``poses`` holds nodes by number that stand in for those of the file, with the same children.

    Raises
    ------
    MeshError
        If a reference dangles, a node is reached twice (a cycle or a shared child), or a rotation is zero.
    """
    _require_trees(gltf)
    reached = np.zeros(len(gltf.nodes), np.bool_)
    found: list[Placed] = []
    todo = [(number, np.eye(4)) for number in reversed(_roots(gltf))]
    while todo:
        number, parent = todo.pop()
        node = at(gltf.nodes, number, "node", "scene")
        node = poses.get(number, node) if poses else node
        if reached[number]:
            raise MeshError(f"glTF node {number} is drawn twice by its scene; repair or re-export the file")
        reached[number] = True
        # what overflows here ends as an infinite vertex, which is refused with its place
        with np.errstate(over="ignore", invalid="ignore"):
            world = product(parent, _local(node, number))
        found.append(Placed(number, node, world))
        todo.extend((child, world) for child in reversed(node.children))
    return found


def product(first: Matrix, second: Matrix) -> Matrix:
    """(4, 4) matrix product in plain float64 sums, so that its bits do not depend on a BLAS library."""
    total: Matrix = (first[:, :, None] * second[None, :, :]).sum(axis=1)
    return total


def _require_trees(gltf: Gltf) -> None:
    """Refuse nodes with two parents, and cycles, wherever in the document."""
    parent = np.full(len(gltf.nodes), -1, np.int64)
    for number, node in enumerate(gltf.nodes):
        for child in node.children:
            at(gltf.nodes, child, "child node", f"node {number}")
            if parent[child] >= 0:
                raise MeshError(
                    f"glTF node {child} has two parents, {parent[child]} and {number}; repair the file"
                )
            parent[child] = number
    # with one parent each, whatever is not below a node without parent goes round in a circle
    below: list[int] = np.flatnonzero(parent < 0).tolist()
    count = 0
    while below:
        count += 1
        below.extend(gltf.nodes[below.pop()].children)
    if count < len(gltf.nodes):
        raise MeshError(
            f"glTF has a cycle of nodes ({len(gltf.nodes) - count} nodes hang in it); repair the file"
        )


def _roots(gltf: Gltf) -> list[int]:
    """Where to begin: a file without scenes is a library of parts, and all of them count."""
    if gltf.scenes:
        return list(at(gltf.scenes, gltf.scene or 0, "scene", "file").nodes)
    children = {child for node in gltf.nodes for child in node.children}
    return [number for number in range(len(gltf.nodes)) if number not in children]


def _local(node: Node, number: int) -> Matrix:
    """(4, 4) node to parent."""
    if node.matrix is not None:
        return np.array(node.matrix, np.float64).reshape(4, 4).T
    local = np.eye(4)
    if node.rotation is not None:
        local[:3, :3] = _rotation(node.rotation, number)
    if node.scale is not None:
        local[:3, :3] *= np.array(node.scale, np.float64)
    if node.translation is not None:
        local[:3, 3] = node.translation
    return local


def _rotation(quaternion: list[float], number: int) -> Matrix:
    """(3, 3) rotation of a quaternion (x, y, z, w), brought to unit length."""
    values = np.array(quaternion, np.float64)
    length = float(np.sqrt((values * values).sum()))
    if not 0 < length < np.inf:
        raise MeshError(
            f"glTF node {number} has a rotation of length {length:g}; repair or re-export the file"
        )
    x, y, z, w = values / length
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
