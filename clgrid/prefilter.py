"""Which triangles a line may cross: what the exact reference need not look at, dropped in float64.

Decides nothing: a triangle is dropped only where the line misses it by more than the error of the test.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import numpy.typing as npt

from clgrid.errors import InputError
from clgrid.mesh import FloatArray, Mesh

F64 = npt.NDArray[np.float64]
Ids = npt.NDArray[np.int64]

MARGIN = 2.0**-49
"""Bounds the error of a projected coordinate of ``Triangles.near``, in units of the mesh.

With u = 2^-53 and coordinates of at most 1: a corner is off by u, the slope by u and its product with the
depth by 3u; their difference, rounded, by 6u. The line's own position is at most 3 and off by 3u, the
distance from it at most 5 and rounded by 5u: 14u in all, and what underflows is some 2^-1074.
"""

_BLOCK = 64
_BLOCKS_AT_ONCE = 1 << 11
_FARTHEST = 3


@dataclass(frozen=True, eq=False)
class Triangles:
    """Triangles prepared for many rays; the functions of ``clgrid.rational`` take them in place of corners.

    Attributes
    ----------
    vertices : (V, 3) float32 or float64
        Scene units.
    faces : (F, 3) integers
        Corners of each triangle.
    order : (F,) int64
        Ids sorted along a Morton curve, so that blocks of them are small whatever the order of the file.
    centre : (3,) float64
        A point near the middle.
    exponent : int
        All corners lie within 2**exponent of the centre, on each axis.
    low, high : (B, 3) float64
        Bounds of each 64 triangles of ``order``, in units of 2**exponent around the centre.
    """

    vertices: FloatArray
    faces: npt.NDArray[np.integer]
    order: Ids
    centre: F64
    exponent: int
    low: F64
    high: F64

    @classmethod
    def of_corners(cls, corners: FloatArray) -> Triangles:
        """Of the corners of each triangle.

        Parameters
        ----------
        corners : (F, 3, 3) float32 or float64
            Scene units.

        Raises
        ------
        InputError
            If the shape or dtype is another, or a coordinate is not finite.
        """
        check_corners(corners)
        vertices = corners.reshape(-1, 3)
        return cls._of(vertices, np.arange(len(vertices)).reshape(-1, 3))

    @classmethod
    def of_mesh(cls, mesh: Mesh) -> Triangles:
        """Of a mesh, without a copy of its arrays."""
        return cls._of(mesh.vertices, mesh.faces)

    @classmethod
    def _of(cls, vertices: FloatArray, faces: npt.NDArray[np.integer]) -> Triangles:
        if not len(faces):
            nothing = np.zeros((0, 3))
            return cls(vertices, faces, np.zeros(0, np.int64), np.zeros(3), 0, nothing, nothing)
        lows, highs = _bounds(vertices, faces, np.arange(len(faces)), 1)
        order = np.argsort(_morton(lows, highs), kind="stable")
        lows, highs = _bounds(vertices, faces, order, _BLOCK)
        first, last = lows.min(axis=0), highs.max(axis=0)
        centre = first / 2 + last / 2
        exponent = int(np.frexp(max((last - centre).max(), (centre - first).max()))[1])
        # Rounding is monotone: the bounds of local corners are the local bounds.
        low, high = (np.ldexp(part - centre, -exponent) for part in (lows, highs))
        return cls(vertices, faces, order, centre, exponent, low, high)

    def __len__(self) -> int:
        return len(self.faces)

    def corners(self, ids: Ids) -> F64:
        """(K, 3, 3) float64, exact: the corners of these triangles, scene units."""
        corners: F64 = self.vertices[self.faces[ids]].astype(np.float64)
        return corners

    def near(self, origin: list[float], direction: list[float]) -> Ids:
        """Ids of all triangles that the line may cross, in any order; every other one is surely missed.

        Seen along the line, a corner lies at x - z dx/dz, z being the direction's largest axis; its distance
        from the line is off by at most MARGIN. A triangle is dropped where all its corners lie on one side of
        the line on an axis, or two of its edge functions differ in sign beyond their error.

        Parameters
        ----------
        origin, direction : three finite float
            Scene units; the direction must not be zero.
        """
        seen = self._line(origin, direction)
        if seen is None:
            return np.zeros(0, np.int64)
        axes, slopes, at = seen
        met = np.ones(len(self.low), np.bool_)
        for axis, slope, place in zip(axes[:2], slopes, at, strict=True):
            shift = self.low[:, axes[2]] * slope, self.high[:, axes[2]] * slope
            low = self.low[:, axis] - np.maximum(*shift)
            high = self.high[:, axis] - np.minimum(*shift)
            met &= ~(low > place + MARGIN) & ~(high < place - MARGIN)
        blocks = np.flatnonzero(met)
        kept = [np.zeros(0, np.int64)]
        for start in range(0, len(blocks), _BLOCKS_AT_ONCE):
            part = blocks[start : start + _BLOCKS_AT_ONCE]
            places = (part[:, None] * _BLOCK + np.arange(_BLOCK)).reshape(-1)
            ids = self.order[places[places < len(self)]]
            local = np.ldexp(self.corners(ids) - self.centre, -self.exponent)
            x, y = (
                (local[..., axis] - slope * local[..., axes[2]]) - place
                for axis, slope, place in zip(axes[:2], slopes, at, strict=True)
            )
            kept.append(ids[~_surely_apart(x, y)])
        return np.concatenate(kept)

    def _line(
        self, origin: list[float], direction: list[float]
    ) -> tuple[list[int], list[float], list[float]] | None:
        """Axes x, y and z, with z along the line; slopes and position in x and y; None far from the mesh."""
        depth = max(range(3), key=lambda axis: abs(direction[axis]))
        axes = [(depth + 1) % 3, (depth + 2) % 3, depth]
        slopes = [direction[axis] / direction[depth] for axis in axes[:2]]
        from_centre = [Fraction(o) - Fraction(float(c)) for o, c in zip(origin, self.centre, strict=True)]
        along = from_centre[depth] / Fraction(direction[depth])
        at = [
            (from_centre[axis] - Fraction(direction[axis]) * along) / Fraction(2) ** self.exponent
            for axis in axes[:2]
        ]
        # No corner is farther than 1 + |slope| <= 2 from the centre.
        if max(map(abs, at)) > _FARTHEST:
            return None
        return axes, slopes, [float(place) for place in at]


def _bounds(vertices: FloatArray, faces: npt.NDArray[np.integer], order: Ids, block: int) -> tuple[F64, F64]:
    """(B, 3) lowest and highest corner of each block of triangles; some at a time, to spare memory."""
    lows, highs = [], []
    for start in range(0, len(order), _BLOCK * _BLOCKS_AT_ONCE):
        corners = vertices[faces[order[start : start + _BLOCK * _BLOCKS_AT_ONCE]]]
        starts = np.arange(0, len(corners), block)
        lows.append(np.minimum.reduceat(corners.min(axis=1), starts))
        highs.append(np.maximum.reduceat(corners.max(axis=1), starts))
    return np.concatenate(lows).astype(np.float64), np.concatenate(highs).astype(np.float64)


def _morton(lows: F64, highs: F64) -> npt.NDArray[np.uint32]:
    """(F,) place of boxes along a Morton curve of 10 bits an axis; any order would do."""
    middle = lows / 2 + highs / 2
    first = middle.min(axis=0)
    with np.errstate(all="ignore"):
        share = (middle - first) / (middle.max(axis=0) - first)
    places = (np.where(np.isfinite(share), share, 0.0) * 1023).astype(np.uint32)
    code = np.zeros(len(places), np.uint32)
    for bit in range(10):
        for axis in range(3):
            code |= ((places[:, axis] >> np.uint32(bit)) & np.uint32(1)) << np.uint32(3 * bit + axis)
    return code


def _surely_apart(x: F64, y: F64) -> npt.NDArray[np.bool_]:
    """(K,): whether the origin lies outside of triangles in the plane, (K, 3) coordinates off by MARGIN.

    An edge function x q - y p is off by at most MARGIN (|x| + |y| + |p| + |q|), twice MARGIN^2, and its own
    rounding, which is less than MARGIN (|y| + |p|) for coordinates of at most 5.
    """
    apart = (x.min(1) > MARGIN) | (x.max(1) < -MARGIN) | (y.min(1) > MARGIN) | (y.max(1) < -MARGIN)
    p, q = np.roll(x, -1, axis=1), np.roll(y, -1, axis=1)
    edges = x * q - y * p
    bound = 2 * MARGIN * (np.abs(x) + np.abs(y) + np.abs(p) + np.abs(q) + 8 * MARGIN)
    mixed: npt.NDArray[np.bool_] = apart | ((edges > bound).any(1) & (edges < -bound).any(1))
    return mixed


def check_corners(corners: FloatArray) -> None:
    """Refuse what are not the corners of triangles, (F, 3, 3), all finite.

    Raises
    ------
    InputError
        Saying what is wrong.
    """
    if corners.ndim != 3 or corners.shape[1:] != (3, 3) or corners.dtype not in ("float32", "float64"):
        raise InputError(
            f"corners have shape {corners.shape} and dtype {corners.dtype}; "
            "give shape (F, 3, 3) and dtype float32 or float64"
        )
    if not np.isfinite(corners).all():
        raise InputError("a corner is NaN or infinite; remove its triangle")


__all__ = ["F64", "MARGIN", "Ids", "Triangles", "check_corners"]
