"""The outermost of many points along each axis: how far out, and which they are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float32] | npt.NDArray[np.float64]

_LONG_ROW = 256


@dataclass(frozen=True)
class Outermost:
    """The least and the greatest coordinates of points, and a point for each.

    Attributes
    ----------
    bounds : (2, 3) of the points' dtype
        NaN where one is.
    places : list of 2 lists of 3 int
        The first point that has the coordinate.
    """

    bounds: FloatArray
    places: list[list[int]]


def extent(points: FloatArray) -> FloatArray:
    """(2, 3): least and greatest coordinates of (N, 3) points, N at least 1; NaN where one is."""
    return outermost(points).bounds


def outermost(points: FloatArray) -> Outermost:
    """Of (N, 3) points, N at least 1."""
    # Long rows: numpy reduces rows of three numbers one number at a time, which takes ten times as long.
    whole = len(points) // _LONG_ROW * _LONG_ROW
    long = points[:whole].reshape(-1, 3 * _LONG_ROW)
    bounds, found = np.empty((2, 3), points.dtype), []
    for side, (end, at_end) in enumerate(((np.min, np.argmin), (np.max, np.argmax))):
        places = at_end((end(long, axis=0) if whole else points).reshape(-1, 3), axis=0).tolist()
        if whole:
            rows = [int(at_end(long[:, 3 * place + axis])) for axis, place in enumerate(places)]
            places = [row * _LONG_ROW + place for row, place in zip(rows, places, strict=True)]
        if 0 < whole < len(points):
            others = (at_end(points[whole:], axis=0) + whole).tolist()
            both = np.stack([points[places, (0, 1, 2)], points[others, (0, 1, 2)]])
            places = np.choose(at_end(both, axis=0), (places, others)).tolist()
        bounds[side] = points[places, (0, 1, 2)]
        found.append(places)
    return Outermost(bounds, found)
