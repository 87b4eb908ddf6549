"""Random lines through a mesh's box: how far each is open, and what it passes before a surface ends it.

A coarse grid holds the surface per volume; half of it is met per length of a line in a random direction. So
a sculpture, a room full of furniture and a heap of splinters differ, as they do for rays.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from clgrid.scatter import Scatter

FloatArray = npt.NDArray[np.float64]

_CELLS_ALONG = 16
_LINES = 96
_STEPS = 24
# No box is flatter than this, so that lines cross it.
_FLATTEST = 1e-3


class Sightlines:
    """Lines through a mesh of which some triangles are known.

    Parameters
    ----------
    scatter : Scatter
        Over it.
    bounds : (2, 3) float64
        Of the whole mesh.

    Attributes
    ----------
    open : float
        Share of the lines' length before the first surface.
    """

    def __init__(
        self,
        scatter: Scatter,
        bounds: FloatArray,
    ) -> None:
        rng = np.random.default_rng(0)
        size = bounds[1] - bounds[0]
        longest = float(size.max()) or 1.0
        self._origin, self._cell = bounds[0], longest / _CELLS_ALONG
        size = np.maximum(size, _FLATTEST * longest)
        self._shape = np.maximum(1, np.ceil(size / self._cell)).astype(np.int64)
        self._scatter = scatter
        self._places = self._numbers(scatter.places)
        per_volume = np.bincount(self._places, scatter.surface, int(self._shape.prod())) / self._cell**3
        cells, lengths = self._walk(size, rng)
        met = np.cumsum(0.5 * per_volume[cells] * lengths, axis=1)
        before = np.concatenate([np.zeros((len(met), 1)), met[:, :-1]], axis=1)
        seen = np.exp(-before) * lengths
        self.open = min(1.0, float(seen.sum() / (lengths.sum() * _STEPS)))
        # Of each coarse cell: the lines' length in it, and what of that is before their first surface.
        self._length, self._seen = (
            np.bincount(cells.reshape(-1), np.broadcast_to(each, cells.shape).reshape(-1), len(per_volume))
            for each in (lengths, seen)
        )

    def passed(self, amounts: FloatArray) -> float:
        """Share of what lies at the triangles, by length, that lines pass before their first surface.

        Parameters
        ----------
        amounts : (n,) float64
            Of each triangle.
        """
        held = np.bincount(self._places, self._scatter.spread(amounts), len(self._seen))
        whole = float(held @ self._length)
        return float(held @ self._seen) / whole if whole > 0 else 1.0

    def _numbers(self, points: FloatArray) -> npt.NDArray[np.int64]:
        """Number of the coarse cell of each of (3, ...) points."""
        x, y, z = (
            np.clip(
                ((points[axis] - self._origin[axis]) / self._cell).astype(np.int64), 0, self._shape[axis] - 1
            )
            for axis in range(3)
        )
        numbers: npt.NDArray[np.int64] = (z * self._shape[1] + y) * self._shape[0] + x
        return numbers

    def _walk(self, size: FloatArray, rng: np.random.Generator) -> tuple[npt.NDArray[np.int64], FloatArray]:
        """Coarse cells at equal steps of each line, and the length of its steps."""
        start = _points_around(size, rng)
        along = _points_around(size, rng) - start
        lengths = np.sqrt((along * along).sum(axis=0))[:, None] / _STEPS
        times = (np.arange(_STEPS) + 0.5) / _STEPS
        places = self._origin[:, None, None] + start[:, :, None] + along[:, :, None] * times
        return self._numbers(places), lengths


def _points_around(size: FloatArray, rng: np.random.Generator) -> FloatArray:
    """(3, _LINES) points evenly on the sides of a box at the origin."""
    sides = np.array([size[1] * size[2], size[0] * size[2], size[0] * size[1]])
    side = rng.choice(6, _LINES, p=np.repeat(sides / sides.sum() / 2, 2))
    points = rng.random((3, _LINES))
    points[side // 2, np.arange(_LINES)] = side % 2
    return points * size[:, None]
