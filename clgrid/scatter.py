"""Points that stand for a mesh of which some triangles are known: evenly over these, and their middles."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

_POINTS = 1 << 10


@dataclass(frozen=True)
class Scatter:
    """Points on triangles.

    Attributes
    ----------
    places : (3, k) float64
    owners : (k,) int64
        The triangle of each.
    shares : (k,) float64
        What part of its triangle each stands for.
    surface : (k,) float64
        What part of the mesh's area each stands for; nothing the middles of triangles.
    """

    places: FloatArray
    owners: npt.NDArray[np.int64]
    shares: FloatArray
    surface: FloatArray

    @classmethod
    def over(
        cls, corners: tuple[FloatArray, FloatArray, FloatArray], areas: FloatArray, area: float, seed: int = 0
    ) -> Scatter:
        """Points on triangles that stand for a mesh.

        Parameters
        ----------
        corners : 3 arrays of (3, n) float64
            Of the triangles, by axis.
        areas : (n,) float64
        area : float
            Of the whole mesh.
        seed : int
        """
        points, of = _points_on(corners, areas, seed)
        owners = np.concatenate([of, np.arange(len(areas))])
        surface = np.zeros(len(owners))
        surface[: len(of)] = area / max(1, len(of))
        return cls(
            places=np.concatenate([points, sum(corners) / 3], axis=1),
            owners=owners,
            shares=1 / np.bincount(owners, minlength=len(areas))[owners],
            surface=surface,
        )

    def spread(self, amounts: FloatArray) -> FloatArray:
        """(k,) float64: to each point its share of its triangle's amount."""
        return amounts[self.owners] * self.shares


@functools.cache
def _draws(seed: int) -> tuple[FloatArray, FloatArray]:
    """By point: a share of the area before it, in order, and (2, k) coordinates in a triangle."""
    rng = np.random.default_rng(seed)
    shares = (np.arange(_POINTS) + rng.random(_POINTS)) / _POINTS
    u, v = rng.random((2, _POINTS))
    return shares, np.where(u + v > 1, (1 - u, 1 - v), (u, v))


def _points_on(
    corners: tuple[FloatArray, FloatArray, FloatArray], areas: FloatArray, seed: int
) -> tuple[FloatArray, npt.NDArray[np.int64]]:
    """(3, k) points evenly all over the triangles, and the triangle of each; none on a mesh without area."""
    ends = np.cumsum(areas)
    if not ends[-1] > 0:
        return np.zeros((3, 0)), np.zeros(0, np.int64)
    shares, (u, v) = _draws(seed)
    of = np.minimum(np.searchsorted(ends, shares * ends[-1]), len(areas) - 1)
    a, b, c = (corner[:, of] for corner in corners)
    return a + u * (b - a) + v * (c - a), of
