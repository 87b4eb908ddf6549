"""Meshes and arrays of other libraries, known by their attributes, as clgrid's."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from clgrid.errors import MeshError
from clgrid.mesh import MAX_COUNT, FloatArray, Mesh

if TYPE_CHECKING:
    import trimesh

Ids = npt.NDArray[np.uint32]


def on_host(values: Any) -> Any:
    """Tensors as numpy arrays; all else as it is."""
    if not callable(getattr(values, "numpy", None)):
        return values
    return (values.cpu() if hasattr(values, "cpu") else values).numpy()


def mesh_of(mesh: Any, source: str) -> Mesh:
    """Copy a mesh of another library, or one of clgrid's as a single geometry.

    Parameters
    ----------
    mesh
        With ``vertex["positions"]`` and ``triangle["indices"]``, or with ``vertices`` and ``faces`` or
        ``triangles``.
    source : str
        What messages call it.

    Raises
    ------
    MeshError
        If it is no mesh, or one that ``Mesh`` refuses.
    """
    return mesh_of_arrays(*_arrays_of(mesh, source), source)


def mesh_of_arrays(vertices: Any, triangles: Any, source: str) -> Mesh:
    """Copy (V, 3) real vertices, float32 or else as float64, and (M, 3) integer triangles.

    Raises
    ------
    MeshError
        If they are not, or ``Mesh`` refuses them.
    """
    return Mesh(_positions(vertices, source), _indices(triangles, source), source=source)


def _arrays_of(mesh: Any, source: str) -> tuple[Any, Any]:
    """Vertices and triangles of a mesh of any library that is known by its attributes."""
    if hasattr(mesh, "vertex") and hasattr(mesh, "triangle"):
        for part, key in ((mesh.vertex, "positions"), (mesh.triangle, "indices")):
            if key not in part:
                raise MeshError(f"{source}: the mesh has no {key}; give one with vertices and triangles")
        return mesh.vertex["positions"], mesh.triangle["indices"]
    for faces in ("faces", "triangles"):
        if hasattr(mesh, "vertices") and hasattr(mesh, faces):
            return mesh.vertices, getattr(mesh, faces)
    raise MeshError(f"{source}: a {type(mesh).__name__} is no mesh; give vertices and triangles, or a mesh")


def _array(values: Any, what: str) -> npt.NDArray[Any]:
    try:
        return np.asarray(on_host(values))
    except ValueError as error:
        raise MeshError(f"{what} are no array of numbers: {error}") from None


def _positions(values: Any, source: str) -> FloatArray:
    """A copy, float32 if that is what it is, else float64; its shape is left to ``Mesh``."""
    array = _array(values, f"{source}: vertices")
    if array.dtype.kind not in "fiu":
        raise MeshError(f"{source}: vertices have dtype {array.dtype}; give real numbers")
    if array.dtype == np.float32:
        return np.array(array, np.float32, order="C")
    return np.array(array, np.float64, order="C")


def _indices(values: Any, source: str) -> Ids:
    """A copy in uint32; its shape is left to ``Mesh``."""
    array = _array(values, f"{source}: triangles")
    if array.dtype.kind not in "iu":
        raise MeshError(f"{source}: triangles have dtype {array.dtype}; give integers")
    if array.size and (array.min() < 0 or array.max() > MAX_COUNT):
        raise MeshError(
            f"{source}: triangles name vertices {array.min()} to {array.max()}; count vertices from 0"
        )
    return np.array(array, np.uint32, order="C")


def joined(meshes: list[Mesh], source: str = "scene") -> Mesh:
    """One mesh of the geometries of all, in order; MeshError if they are too many."""
    vertices = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    triangles = np.cumsum([0, *(mesh.triangle_count for mesh in meshes)])
    if max(vertices[-1], triangles[-1]) > MAX_COUNT:
        raise MeshError(
            f"{source}: {vertices[-1]:,} vertices and {triangles[-1]:,} triangles, at most {MAX_COUNT:,} fit;"
            " make several scenes"
        )
    names = tuple(name for mesh in meshes for name in mesh.geometry_names)
    faces = [mesh.faces + np.uint32(first) for mesh, first in zip(meshes, vertices, strict=False)]
    starts = [mesh.geometry_starts[1:] + first for mesh, first in zip(meshes, triangles, strict=False)]
    return Mesh(
        np.concatenate([np.zeros((0, 3), np.float32), *(mesh.vertices for mesh in meshes)]),
        np.concatenate([np.zeros((0, 3), np.uint32), *faces]),
        geometry_starts=np.concatenate([np.zeros(1, np.int64), *starts]),
        geometry_names=names,
        source=source,
    )


def of_trimesh(given: trimesh.Trimesh | trimesh.Scene) -> Mesh:
    """What ``Mesh.from_trimesh`` returns, and raises."""
    source = f"<trimesh.{type(given).__name__}>"
    if hasattr(given, "geometry") and hasattr(given, "graph"):
        return joined(list(_nodes(given)), source)
    if not (hasattr(given, "vertices") and hasattr(given, "faces")):
        raise MeshError(f"a {type(given).__name__} has no triangles; give a trimesh.Trimesh or trimesh.Scene")
    return Mesh(*_copied(given), source=source)


def _copied(mesh: trimesh.Trimesh) -> tuple[npt.NDArray[np.float64], Ids]:
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


def _nodes(scene: trimesh.Scene) -> Iterator[Mesh]:
    """Each node that shows a trimesh.Trimesh, in the scene's coordinates."""
    for node in scene.graph.nodes_geometry:
        world, name = scene.graph[node]
        shown: Any = scene.geometry[name]
        if not hasattr(shown, "faces"):
            continue  # paths and clouds of points
        vertices, faces = _copied(shown)
        turned = np.linalg.det(world[:3, :3]) < 0
        yield Mesh(
            vertices @ world[:3, :3].T + world[:3, 3],
            np.ascontiguousarray(faces[:, ::-1]) if turned else faces,
            geometry_names=(str(node),),
            source=f"{node}",
        )
