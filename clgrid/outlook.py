"""What a camera sees of a mesh of which some triangles are known: how far, and what blocks of pixels pass.

A block of pixels passes a cell that it sees, and holds all triangles listed there against its rays. So
a triangle costs by the blocks that see its cells, whatever else these hold: far away few, near by many.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgrid.camera import Camera
from clgrid.frame import LocalFrame
from clgrid.scatter import Scatter

FloatArray = npt.NDArray[np.float64]

# Parts of the picture along a side, in each of which what is nearer hides what is behind it by chance.
_PARTS = 5
# What covers a part so many times lets nothing through; at the eye itself it is beyond numbers.
_OPAQUE = 1e3
# Share of an area that faces a ray, by mean of all directions.
_FACING = 0.5


@dataclass(frozen=True)
class Pictured:
    """References of a grid that a picture passes, as far as one may say so before its size is known.

    A cell of width c at distance z is seen by (1 + c / z / b)^2 blocks whose side is b at distance 1.

    Attributes
    ----------
    once, wide, area : float
        Sums of 1, c / z and its square over all references that are seen.
    side : float
        Of the picture, at distance 1.
    """

    once: float
    wide: float
    area: float
    side: float

    def tests(self) -> float:
        """Triangles that a ray alone tests, by mean."""
        return self.area / self.side**2

    def passed(self, blocks: float) -> float:
        """References that so many blocks, all of the picture, pass together."""
        along = float(blocks**0.5) / self.side
        return self.once + 2 * self.wide * along + self.area * along * along


class Outlook:
    """A square picture of a mesh.

    Parameters
    ----------
    view : Camera
    frame : LocalFrame
        Of the mesh.
    scatter : Scatter
        Over the mesh, in that frame.
    bounds : (2, 3) float64
        Of the mesh, in that frame.

    Attributes
    ----------
    length : float
        Of a ray's way from where it enters the bounds to where it ends, by mean of all rays.
    end : float
        Distance along the view axis at which rays end, by mean of those that meet the bounds.
    side : float
        Of the picture, at distance 1.
    """

    def __init__(self, view: Camera, frame: LocalFrame, scatter: Scatter, bounds: FloatArray) -> None:
        self._scatter = scatter
        eye = frame.to_local_wide(view.eye)
        across, up = view.steps(2, 2)
        self.side = 2 * float(np.linalg.norm(across))
        middles = (np.arange(_PARTS) + 0.5) * (2 / _PARTS) - 1
        ways = (view.forward + up * middles[:, None, None] + across * middles[:, None]).reshape(-1, 3)
        # An eye may be as far away as numbers go.
        with np.errstate(all="ignore"):
            near, far = _within(bounds, eye, ways)
            z, part = _places(scatter.places - eye[:, None], view.forward, across, up)
            inside = np.flatnonzero(np.isfinite(z))
            hidden = _FACING * scatter.surface[inside] / (z[inside] * self.side / _PARTS) ** 2
        hidden = np.minimum(np.nan_to_num(hidden), _OPAQUE)
        self.distances = z
        left, order, part, z = _transmitted(part[inside], z[inside], hidden, near, far)
        # How much of each gap between what is in a part, one after the other, is open.
        gaps = np.diff(z, prepend=0.0)
        gaps[np.diff(part, prepend=-1) != 0] = 0
        opened = np.bincount(part, gaps * left, len(near))
        meets = far > near
        self.length = float((opened * np.sqrt((ways * ways).sum(axis=1))).mean())
        self.end = float((near + opened)[meets].mean()) if meets.any() else 0.0
        self.visible = np.zeros(len(scatter.surface))
        own = order < len(inside)
        self.visible[inside[order[own]]] = left[own]

    def pictured(self, amounts: FloatArray, width: float | FloatArray) -> Pictured:
        """What lies at triangles, in cells of a width, as a picture passes it.

        Parameters
        ----------
        amounts : (n,) float64
            Of each triangle.
        width : float or (n,) float64
            Of the cells of each.
        """
        if isinstance(width, np.ndarray):
            width = width[self._scatter.owners]
        # A cell fills no more than the picture.
        seen = np.minimum(width / self.distances, self.side)
        weights = self._scatter.spread(amounts) * self.visible
        return Pictured(
            float(weights.sum()), float(weights @ seen), float(weights @ (seen * seen)), self.side
        )


def _places(
    away: FloatArray, forward: FloatArray, across: FloatArray, up: FloatArray
) -> tuple[FloatArray, npt.NDArray[np.int64]]:
    """Distance of each of (3, n) points along the view axis, inf outside of the picture, and its part."""
    z = forward @ away
    x, y = (axis @ away / (axis @ axis) / z for axis in (across, up))
    inside = (z > 0) & (np.abs(x) <= 1) & (np.abs(y) <= 1)
    column, row = (
        np.minimum((np.where(inside, each, 0) + 1) * (_PARTS / 2), _PARTS - 1).astype(np.int64)
        for each in (x, y)
    )
    return np.where(inside, z, np.inf), row * _PARTS + column


def _within(bounds: FloatArray, eye: FloatArray, ways: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distances at which rays enter and leave a box; the same for those that miss it."""
    sides = (bounds[:, None] - eye) / ways
    near = np.nan_to_num(np.maximum(np.fmin(*sides).max(axis=1), 0), posinf=0.0)
    return near, np.nan_to_num(np.maximum(np.fmax(*sides).min(axis=1), near), posinf=0.0)


def _transmitted(
    part: npt.NDArray[np.int64], z: FloatArray, hidden: FloatArray, near: FloatArray, far: FloatArray
) -> tuple[FloatArray, npt.NDArray[np.int64], npt.NDArray[np.int64], FloatArray]:
    """What is in the parts of a picture, part by part, by distance, within the box.

    Returns
    -------
    left : (n + 2 k,) float64
        Share of the part's rays that come as far.
    order, part, z : (n + 2 k,) arrays
        Number, part and distance of each; after the n points come the k ends where rays enter and leave.
    """
    parts = np.arange(len(near))
    part = np.concatenate([part, parts, parts])
    z = np.concatenate([np.clip(z, near[part[: len(z)]], far[part[: len(z)]]), near, far])
    order = np.lexsort((z, part))
    part, z = part[order], z[order]
    hides = np.concatenate([hidden, np.zeros(2 * len(near))])[order]
    before = np.cumsum(hides) - hides
    first = np.flatnonzero(np.diff(part, prepend=-1))
    return np.exp(before[first][part] - before), order, part, z
