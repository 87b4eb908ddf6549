"""Meshes of other libraries as ours."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from clgrid.errors import MeshError
from clgrid.mesh import Mesh

if TYPE_CHECKING:
    import trimesh

_Placed = tuple[str, npt.NDArray[np.float64], npt.NDArray[np.uint32]]


def of_trimesh(given: trimesh.Trimesh | trimesh.Scene) -> Mesh:
    """What ``Mesh.from_trimesh`` returns, and raises."""
    source = f"<trimesh.{type(given).__name__}>"
    if hasattr(given, "geometry") and hasattr(given, "graph"):
        return _joined(list(_placed(given)), source)
    if not (hasattr(given, "vertices") and hasattr(given, "faces")):
        raise MeshError(f"a {type(given).__name__} has no triangles; give a trimesh.Trimesh or trimesh.Scene")
    return Mesh(*_arrays(given), source=source)


def _arrays(mesh: trimesh.Trimesh) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.uint32]]:
    """Copies: a trimesh.Trimesh may be changed where it is, a Mesh may not."""
    vertices = np.array(mesh.vertices, np.float64, order="C", subok=False).reshape(-1, 3)
    faces = np.asarray(mesh.faces).reshape(-1, 3)
    if faces.size and (faces.min() < 0 or faces.max() >= len(vertices)):
        bad = int(np.flatnonzero(((faces < 0) | (faces >= len(vertices))).any(axis=1))[0])
        raise MeshError(
            f"<trimesh.{type(mesh).__name__}>: triangle {bad} names vertices {faces[bad].tolist()} of"
            f" {len(vertices)}; repair the mesh"
        )
    return vertices, np.array(faces, np.uint32, order="C", subok=False)


def _placed(scene: trimesh.Scene) -> Iterator[_Placed]:
    """Name and arrays, in the scene's coordinates, of each node that shows a trimesh.Trimesh."""
    for node in scene.graph.nodes_geometry:
        world, name = scene.graph[node]
        shown: Any = scene.geometry[name]
        if not hasattr(shown, "faces"):
            continue  # paths and clouds of points
        vertices, faces = _arrays(shown)
        turned = np.linalg.det(world[:3, :3]) < 0
        yield (
            str(node),
            vertices @ world[:3, :3].T + world[:3, 3],
            np.ascontiguousarray(faces[:, ::-1]) if turned else faces,
        )


def _joined(placed: list[_Placed], source: str) -> Mesh:
    """One mesh, a geometry each."""
    starts = np.cumsum([0, *(len(faces) for _, _, faces in placed)], dtype=np.int64)
    firsts = np.cumsum([0, *(len(vertices) for _, vertices, _ in placed)])[:-1]
    if not placed:
        return Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.uint32), source=source)
    return Mesh(
        np.concatenate([vertices for _, vertices, _ in placed]),
        np.concatenate(
            [faces + np.uint32(first) for (_, _, faces), first in zip(placed, firsts, strict=True)]
        ),
        geometry_starts=starts,
        geometry_names=tuple(name for name, _, _ in placed),
        source=source,
    )
