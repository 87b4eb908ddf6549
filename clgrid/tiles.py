"""How rays given as arrays are divided among work-items: runs of them, or square tiles of an image's rows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from clgrid.rays import Rays

RAYS_PER_ITEM = 64  # as in cl/rays_in_out.h
_SIDE = 8
# Rays looked at for rows, and how much farther than the median two neighbours must be for a row to end there.
_LOOKED_AT, _JUMP = 1 << 14, 6.0
# Rays glanced at before that, and the farthest that two may be from each other.
_GLANCE, _FARTHEST = 256, 4.0
_SHORTEST_ROW = 2 * _SIDE
# Rows looked at, at most, for whether they run alike.
_ROWS = 4
# Sum of the mean steps in directions and origins along rows and across, beyond which they are no image's.
_ALIKE = 0.2


@dataclass(frozen=True)
class Division:
    """Rays by work-item.

    Attributes
    ----------
    row : int
        Rays of a row; a work-item takes 8 of each of 8 rows. 0: a work-item takes consecutive rays.
    size : int
        How many, if they are consecutive.
    """

    row: int = 0
    size: int = RAYS_PER_ITEM

    @property
    def in_rows(self) -> bool:
        """Whether they are known to be an image's."""
        return self.row >= _SHORTEST_ROW

    def items(self, count: int) -> int:
        """Work-items for so many rays."""
        if not self.row:
            return -(-count // self.size)
        rows = -(-count // self.row)
        return -(-self.row // _SIDE) * -(-rows // _SIDE)

    def launch_of(self, most: int) -> int:
        """How many rays a launch takes, at most: whole tiles, if there is room for one."""
        band = self.row * _SIDE
        return most // band * band or most if band else most


def division_of(rays: Rays) -> Division:
    """By the rows of an image if the rays come in such, else consecutive ones, which may need an order.

    What is chosen costs or saves time alone: hits do not depend on it.
    """
    count = rays.origins.size // 3
    shape = rays.origins.shape[:-1]
    row = shape[-1] if len(shape) > 1 else _row_of(rays)
    if _SHORTEST_ROW <= row <= count // _SIDE and _is_row(rays, row):
        return Division(row)
    return Division()


def _row_of(rays: Rays) -> int:
    """Length of the rows in which neighbours are near each other, and ends far apart; 0 if there are none."""
    count = len(rays.origins)
    if count < _SHORTEST_ROW * _SHORTEST_ROW:
        return 0
    if _JUMP * np.median(_both_steps(rays, _GLANCE)) > _FARTHEST:
        return 0  # rays without any order: no jump could stand out
    steps = _both_steps(rays, _LOOKED_AT)
    if not np.isfinite(steps).all():
        return 0
    jumps = np.flatnonzero(steps > _JUMP * np.median(steps))
    row = int(jumps[0]) + 1 if len(jumps) else 0
    regular = row and np.array_equal(jumps, np.arange(row, len(steps) + 1, row)[: len(jumps)] - 1)
    return row if regular and len(jumps) > 1 and count % row == 0 else 0


def _is_row(rays: Rays, row: int) -> bool:
    """Whether rays of a row run nearly alike, and so do those above each other."""
    rows = max(2, min(_ROWS, _LOOKED_AT // row))
    spread = 0.0
    for vectors in (rays.directions, rays.origins):
        some = np.nan_to_num(vectors.reshape(-1, 3)[: rows * row].astype(np.float64), posinf=0, neginf=0)
        image = (some / (np.abs(some).max() or 1)).reshape(-1, row, 3)
        spread += sum(float(np.abs(np.diff(image, axis=axis)).mean()) for axis in (0, 1))
    return spread < _ALIKE


def _both_steps(rays: Rays, count: int) -> npt.NDArray[np.float64]:
    """Of directions and origins together, between so many rays at the start."""
    return _steps(rays.directions[: count + 1]) + _steps(rays.origins[: count + 1])


def _steps(vectors: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    """How far each is from the next, as a share of the largest component of all."""
    largest = np.abs(vectors).max(initial=0)
    with np.errstate(all="ignore"):
        return np.asarray(np.abs(np.diff(vectors, axis=0)).max(axis=1) / (largest or 1), np.float64)
