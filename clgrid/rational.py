"""The exact reference: lines against triangles in integers, for tests and ``clgrid verify``.

Every double is an integer times a power of two, so signs and distances have no error at all. A line through
an edge or a vertex is decided as if its origin were moved by (e, e^2, e^3) for an infinitely small e > 0
(Edelsbrunner, Mücke 1990): triangles that share an edge then agree on its side, and each crossing of a closed
surface counts once.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from fractions import Fraction
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from clgrid.errors import InputError
from clgrid.mesh import FloatArray
from clgrid.prefilter import F64, Ids, Triangles, check_corners

Vector = tuple[int, int, int]

_FEW = 64
"""So many triangles are looked at one by one sooner than they are prepared."""


class Crossing(NamedTuple):
    """Where a line crosses a triangle.

    Attributes
    ----------
    id : int
        The triangle.
    t : Fraction
        Exact distance from the origin in units of the direction; negative behind the origin.
    """

    id: int
    t: Fraction


def crossings(
    triangles: FloatArray | Triangles, origin: npt.ArrayLike, direction: npt.ArrayLike
) -> list[Crossing]:
    """All crossings of a line, on both sides of its origin, sorted by (t, id).

    Parameters
    ----------
    triangles : (F, 3, 3) float32 or float64, or Triangles
        Corners, scene units; prepare them once for many rays.
    origin, direction : (3,) float32 or float64
        Scene units. A line with NaN, infinite values or a zero direction crosses nothing.

    Returns
    -------
    list of Crossing
        Triangles in the line's plane or without area are never crossed.

    Raises
    ------
    InputError
        For arrays of another shape or dtype, and for corners that are not finite.
    """
    found = [Crossing(id_, Fraction(*at) * unit) for id_, at, _, unit in _met(triangles, origin, direction)]
    return sorted(found, key=lambda crossing: (crossing.t, crossing.id))


def closest(
    triangles: FloatArray | Triangles,
    origin: npt.ArrayLike,
    direction: npt.ArrayLike,
    t_min: float | Fraction = 0.0,
    t_max: float | Fraction = math.inf,
) -> Crossing | None:
    """The crossing of least (t, id) with t_min <= t <= t_max, or None; arguments as of ``crossings``."""
    return next((c for c in crossings(triangles, origin, direction) if t_min <= c.t <= t_max), None)


def count(
    triangles: FloatArray | Triangles,
    origin: npt.ArrayLike,
    direction: npt.ArrayLike,
    t_min: float | Fraction = 0.0,
    t_max: float | Fraction = math.inf,
) -> int:
    """Number of crossings with t_min <= t <= t_max; arguments as of ``crossings``."""
    return sum(t_min <= c.t <= t_max for c in crossings(triangles, origin, direction))


def inside(triangles: FloatArray | Triangles, point: npt.ArrayLike, direction: npt.ArrayLike) -> bool:
    """Whether the half line from a point crosses the triangles an odd number of times.

    A crossing at the point itself counts where it is in front of the moved point: for a closed mesh the
    answer is then the same in every direction. Arguments as of ``crossings``; False where NaN or infinite.
    """
    odd = False
    for _, (numerator, slope), normal, _ in _met(triangles, point, direction):
        # t of the moved point is t - n.(e, e^2, e^3) / slope.
        odd ^= (numerator or -_first(normal)) * slope > 0
    return odd


def crossing_t(triangle: FloatArray, origin: npt.ArrayLike, direction: npt.ArrayLike) -> Fraction | None:
    """Exact t at which the line crosses one triangle, (3, 3) corners, or None."""
    found = crossings(triangle[None], origin, direction)
    return found[0].t if found else None


def plane_t(triangle: FloatArray, origin: npt.ArrayLike, direction: npt.ArrayLike) -> Fraction | None:
    """Exact t at which the line meets the plane of a triangle, within it or not.

    Parameters
    ----------
    triangle : (3, 3) float32 or float64
        Corners, scene units.
    origin, direction : (3,) float32 or float64
        Scene units.

    Returns
    -------
    Fraction or None
        None where the line is parallel to the plane, the triangle has no area or a value is not finite.
    """
    ray = _finite_ray(origin, direction)
    if ray is None or not np.isfinite(triangle).all():
        return None
    (a, b, c), d, unit = _integers(triangle.astype(np.float64)[None], *ray)
    normal = _cross(_sub(b, a), _sub(c, a))
    slope = _dot(normal, d)
    return Fraction(_dot(normal, a), slope) * unit if slope else None


_Met = tuple[int, tuple[int, int], Vector, Fraction]


def _met(
    triangles: FloatArray | Triangles, origin: npt.ArrayLike, direction: npt.ArrayLike
) -> Iterator[_Met]:
    """Of each crossing: id, numerator and denominator of t, normal (any length), unit of t."""
    if not isinstance(triangles, Triangles):
        check_corners(triangles)
    ray = _finite_ray(origin, direction)
    if ray is None:
        return
    ids, corners = _candidates(triangles, *ray)
    points, d, unit = _integers(corners, *ray)
    for k, id_ in enumerate(ids.tolist()):
        a, b, c = points[3 * k : 3 * k + 3]
        normal = _cross(_sub(b, a), _sub(c, a))
        slope = _dot(normal, d)
        if slope and _side(a, b, d) == _side(b, c, d) == _side(c, a, d):
            yield id_, (_dot(normal, a), slope), normal, unit


def _candidates(
    triangles: FloatArray | Triangles, origin: list[float], direction: list[float]
) -> tuple[Ids, F64]:
    """Ids and corners of all triangles that the line may cross."""
    if not isinstance(triangles, Triangles):
        if len(triangles) <= _FEW:
            return np.arange(len(triangles)), triangles.astype(np.float64)
        triangles = Triangles.of_corners(triangles)
    ids = triangles.near(origin, direction)
    return ids, triangles.corners(ids)


def _side(p: Vector, q: Vector, d: Vector) -> bool:
    """Whether the edge function d.(P x Q) of an edge not parallel to d is positive for the moved origin."""
    edge = _dot(d, _cross(p, q))
    return (edge or _first(_cross(d, _sub(q, p)))) > 0


def _first(v: Vector) -> int:
    """The sign of v.(e, e^2, e^3) is that of the first component that is not zero."""
    return v[0] or v[1] or v[2]


def _finite_ray(origin: npt.ArrayLike, direction: npt.ArrayLike) -> tuple[list[float], list[float]] | None:
    """Both as lists, or None where a value is not finite or the direction is zero."""
    rows = []
    for name, values in (("origin", origin), ("direction", direction)):
        row = np.asarray(values)
        if row.shape != (3,):
            raise InputError(f"{name} has shape {row.shape}; give three numbers")
        rows.append(row.astype(np.float64))
    if not np.isfinite(rows).all() or not rows[1].any():
        return None
    return rows[0].tolist(), rows[1].tolist()


def _integers(
    corners: F64, origin: list[float], direction: list[float]
) -> tuple[list[Vector], Vector, Fraction]:
    """Corners relative to the origin, and direction, each scaled to integers; and the unit of t."""
    flat, scale = _scaled(origin + corners.reshape(-1).tolist())
    o, points = flat[:3], flat[3:]
    d, d_scale = _scaled(direction)
    relative = [
        (points[i] - o[0], points[i + 1] - o[1], points[i + 2] - o[2]) for i in range(0, len(points), 3)
    ]
    return relative, (d[0], d[1], d[2]), Fraction(1 << d_scale, 1 << scale)


def _scaled(values: list[float]) -> tuple[list[int], int]:
    """The values times the least power of two, not below 1, that makes them integers; and its exponent."""
    ratios = [value.as_integer_ratio() for value in values]
    bits = max(denominator.bit_length() for _, denominator in ratios)
    return [numerator << (bits - denominator.bit_length()) for numerator, denominator in ratios], bits - 1


def _sub(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _dot(a: Vector, b: Vector) -> int:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


__all__ = [
    "Crossing",
    "Triangles",
    "closest",
    "count",
    "crossing_t",
    "crossings",
    "inside",
    "plane_t",
]
