"""Polygons and strips into triangles, in the order of the file."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

IntArray = npt.NDArray[np.integer]


def fans(indices: IntArray, counts: npt.NDArray[np.int64]) -> IntArray:
    """Triangulate each polygon as a fan around its first corner; fewer than three corners give none.

    Parameters
    ----------
    indices : (sum of counts,) int
        Corners of all polygons, one after the other.
    counts : (P,) int64
        Corners of each polygon.

    Returns
    -------
    (F, 3), of the type of ``indices``
        Polygon ``p`` gives ``counts[p] - 2`` triangles (first, k, k + 1).
    """
    if len(counts) and (counts == 3).all():
        return indices.reshape(-1, 3)
    triangles = np.maximum(counts - 2, 0)
    first = np.repeat(np.cumsum(counts) - counts, triangles)
    fan = np.arange(int(triangles.sum())) - np.repeat(np.cumsum(triangles) - triangles, triangles)
    return np.stack([indices[first], indices[first + fan + 1], indices[first + fan + 2]], axis=1)


def strips(indices: IntArray, restart: int | None = None) -> IntArray:
    """Triangles of a strip; every second one is turned so that all face the same way.

    Parameters
    ----------
    indices : (N,) int
        Corners along the strip.
    restart : int, optional
        Value that ends one strip and begins the next.

    Returns
    -------
    (F, 3), of the type of ``indices``
        Degenerate triangles, by which strips are often joined, are kept.
    """
    if len(indices) < 3:
        return np.zeros((0, 3), indices.dtype)
    triangles = np.stack([indices[:-2], indices[1:-1], indices[2:]], axis=1)
    position = np.arange(len(triangles))
    if restart is not None:
        breaks = indices == restart
        begin = np.where(breaks, np.arange(1, len(indices) + 1), 0)
        position = position - np.maximum.accumulate(begin)[:-2]
        whole = ~(breaks[:-2] | breaks[1:-1] | breaks[2:])
        triangles, position = triangles[whole], position[whole]
    turned = position % 2 == 1
    triangles[turned] = triangles[turned][:, [1, 0, 2]]
    return triangles


def fan(indices: IntArray) -> IntArray:
    """(F, 3) triangles of one fan around its first corner; none for fewer than three corners."""
    return fans(indices, np.array([len(indices)], np.int64))
