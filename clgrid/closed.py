"""Whether a surface is closed: each edge, by the positions of its ends, in an even number of triangles."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from clgrid.mesh import Mesh, used_vertices

_FACES_AT_ONCE = 1 << 18


def open_edges(mesh: Mesh) -> int:
    """Number of edges that belong to an odd number of triangles.

    The mesh is closed if there are none: every line then crosses it an even number of times. Edges are told
    apart by the positions of their ends, -0.0 being 0.0, so that seams of normals or of files without
    shared vertices do not open a mesh. Edges whose ends coincide are left out; a triangle that names an edge
    twice counts twice.

    Parameters
    ----------
    mesh : Mesh
        Of any number of triangles; some 100 bytes a triangle are needed for a while.
    """
    if not mesh.triangle_count:
        return 0
    keys = _edge_keys(mesh.faces, _places(mesh))
    keys.sort()
    new = np.ones(len(keys), np.bool_)
    np.not_equal(keys[1:], keys[:-1], out=new[1:])
    uses = np.diff(np.flatnonzero(new), append=len(keys))
    return int(np.count_nonzero(uses & 1))


def _edge_keys(faces: npt.NDArray[np.uint32], places: npt.NDArray[np.uint32]) -> npt.NDArray[np.uint64]:
    """One key an edge and triangle, the same for both directions; none where the ends coincide."""
    kept, filled = np.empty(faces.size, np.uint64), 0
    for start in range(0, len(faces), _FACES_AT_ONCE):
        corners = places[faces[start : start + _FACES_AT_ONCE]].astype(np.uint64)
        ends = np.roll(corners, -1, axis=1)
        # Vertices are fewer than 2^32.
        keys = (np.minimum(corners, ends) << np.uint64(32)) | np.maximum(corners, ends)
        keys = keys[corners != ends]
        kept[filled : filled + len(keys)] = keys
        filled += len(keys)
    return kept[:filled]


def _places(mesh: Mesh) -> npt.NDArray[np.uint32]:
    """(V,) the same number for vertices at the same position; vertices out of use have any number."""
    ids = np.flatnonzero(used_vertices(mesh))
    positions = mesh.vertices if len(ids) == len(mesh.vertices) else mesh.vertices[ids]
    order = np.lexsort((positions[:, 0], positions[:, 1], positions[:, 2]))
    new = np.zeros(len(order), np.bool_)
    for axis in range(3):
        column = positions[order, axis]
        new[1:] |= column[1:] != column[:-1]
    numbers = np.empty(len(order), np.uint32)
    numbers[order] = np.cumsum(new)
    places = np.zeros(len(mesh.vertices), np.uint32)
    places[ids] = numbers
    return places


__all__ = ["open_edges"]
