"""The points of a mesh that are nearest to given points, by libigl's tree of boxes.

Source: libigl (https://libigl.github.io), ``igl.AABB``; in float64, exact but for rounding, triangles without
area too. It is an extra, since no ray needs it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from clgrid.errors import InputError, UnsupportedError
from clgrid.mesh import Mesh

Doubles = npt.NDArray[np.float64]

# In sizes of the mesh: squares of distances from beyond would overflow.
_FARTHEST = 2.0**500


@dataclass(frozen=True)
class NearestPoints:
    """Where a mesh is nearest to points.

    Attributes
    ----------
    points : (..., 3) float64
        Scene units; NaN where nothing is near.
    distances : (...) float64
        Scene units; inf where there are no triangles, NaN for a point that is not finite.
    primitive_ids : (...) int64
        Triangle, -1 where nothing is near.
    """

    points: Doubles
    distances: Doubles
    primitive_ids: npt.NDArray[np.int64]


class Nearest:
    """Answers what of a mesh is nearest; the tree is built here.

    Raises
    ------
    UnsupportedError
        If libigl is not installed.
    """

    def __init__(self, mesh: Mesh) -> None:
        self._mesh = mesh
        tree = _library().AABB()
        if not mesh.triangle_count:
            return
        # To a size near 1 by a power of two, which is exact: squares then neither over- nor underflow.
        self._exponent = int(np.frexp(np.abs(mesh.bounds).max())[1])
        self._corners = np.ldexp(mesh.vertices.astype(np.float64), -self._exponent)
        self._faces = mesh.faces.astype(np.int64)
        self._tree = tree
        self._tree.init(self._corners, self._faces)

    def of(self, points: npt.ArrayLike) -> NearestPoints:
        """The nearest point of the mesh to each point; of triangles equally near, one, always the same.

        Parameters
        ----------
        points : (..., 3) float32 or float64
            Scene units.

        Raises
        ------
        InputError
            If they are not numbers of that shape.
        """
        given = _checked(points)
        rows = given.reshape(-1, 3)
        nearest, distances = np.full(rows.shape, np.nan), np.full(len(rows), np.nan)
        ids = np.full(len(rows), -1, np.int64)
        if self._mesh.triangle_count:
            self._fill(rows, nearest, distances, ids)
        else:
            distances[np.isfinite(rows).all(-1)] = np.inf
        shape = given.shape[:-1]
        return NearestPoints(nearest.reshape(given.shape), distances.reshape(shape), ids.reshape(shape))

    def _fill(self, rows: Doubles, nearest: Doubles, distances: Doubles, ids: npt.NDArray[np.int64]) -> None:
        with np.errstate(over="ignore", invalid="ignore"):
            local = np.ldexp(rows, -self._exponent)
            sound = np.flatnonzero((np.abs(local) < _FARTHEST).all(-1))
        if not len(sound):
            return
        squares, found, places = self._tree.squared_distance(self._corners, self._faces, local[sound])
        nearest[sound] = np.ldexp(places.reshape(-1, 3), self._exponent)
        distances[sound] = np.ldexp(np.sqrt(squares), self._exponent)
        ids[sound] = found


def weights(mesh: Mesh, found: NearestPoints) -> Doubles:
    """(..., 2) float64: barycentric weights of second and third vertex; 0 for triangles without area."""
    shares = np.zeros((*found.primitive_ids.shape, 2))
    near = found.primitive_ids >= 0
    corners = mesh.vertices[mesh.faces[found.primitive_ids[near]]].astype(np.float64)
    edges = np.stack([corners[:, 1], corners[:, 2], found.points[near]], axis=1) - corners[:, :1]
    # To unit size first, so that no product over- or underflows.
    size = np.abs(edges[:, :2]).max((1, 2), initial=0.0)
    second, third, place = np.moveaxis(edges / np.where(size > 0, size, 1.0)[:, None, None], 1, 0)
    normal = np.cross(second, third)
    square = _dot(normal, normal)
    areas = np.stack([_dot(np.cross(place, third), normal), _dot(np.cross(second, place), normal)], axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        shares[near] = np.where(square[:, None] > 0, np.clip(areas / square[:, None], 0.0, 1.0), 0.0)
    return shares


def _dot(one: Doubles, other: Doubles) -> Doubles:
    product: Doubles = (one * other).sum(-1)
    return product


def _checked(points: npt.ArrayLike) -> Doubles:
    try:
        given = np.asarray(points)
    except ValueError as error:
        raise InputError(f"points are no array of numbers: {error}") from None
    if given.dtype.kind not in "fiu":
        raise InputError(f"points have dtype {given.dtype}; give real numbers")
    if given.ndim == 0 or given.shape[-1] != 3:
        raise InputError(f"points have shape {given.shape}; give (..., 3)")
    return np.ascontiguousarray(given, np.float64)


def _library() -> Any:
    try:
        import igl
    except ImportError as error:
        raise UnsupportedError(
            f"distances are libigl's, which cannot be imported ({error}); pip install 'clgrid[distances]'"
        ) from None
    return igl
