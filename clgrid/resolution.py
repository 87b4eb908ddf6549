"""How many cells along each axis: the density rule, with care for flat and endless scenes."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from clgrid.errors import SMALLER_GRID, GridTooLargeError, InputError

DEFAULT_DENSITY = 4.0
"""Cells per triangle; the paper's own value (derived in docs/numerics.md from its Figure 1)."""

BOX_PAD = 40 * 2.0**-24
"""The pad of cl/config.h: how far, in local units, a bounding box reaches beyond its triangle."""

# A flatter axis than this has one layer of cells.
_FLATTEST = 2.0**-20
# Cells thinner than the pad would hold every neighbour's triangles.
_THINNEST_CELL = 8 * BOX_PAD
# References are found by 32-bit offsets; the margin keeps a slab's end below 2^32 too.
MOST_CELLS = 2**32 - 2**17
# The walk counts the cells of one axis in a signed integer.
_MOST_ALONG_AXIS = 2**31 - 1


def by_density(extents: npt.NDArray[np.float64], triangles: int, density: float) -> tuple[int, int, int]:
    """Resolution of near-cubic cells, about ``density`` of them per triangle (Cleary et al. 1983).

    An axis that is flat, or so short that it gets no whole cell, has one layer; one so long that
    cells would be thinner than the insertion pad is capped. The others then share the cells.

    Parameters
    ----------
    extents : (3,) float64
        Size of the bounds, local units.
    triangles : int
        At least 1.
    density : float
        Cells per triangle, above 0.

    Returns
    -------
    (int, int, int)
        Cells along x, y and z, each at least 1.

    Raises
    ------
    InputError
        If the density is not a positive finite number.
    GridTooLargeError
        If more than 2**32 cells would be needed.
    """
    wanted = checked_density(density) * triangles
    # Plain numbers: numpy takes ten times as long over three of them, and "auto" asks ten times.
    sides = [float(side) for side in extents]
    resolution = [1, 1, 1]
    free = [axis for axis in range(3) if sides[axis] > _FLATTEST * max(sides)]
    while free:
        per_unit = (wanted / math.prod(resolution) / math.prod(sides[axis] for axis in free)) ** (
            1 / len(free)
        )
        cells = {axis: round(sides[axis] * per_unit) for axis in free}
        caps = {axis: max(1, math.floor(sides[axis] / _THINNEST_CELL)) for axis in free}
        settled = [axis for axis in free if cells[axis] < 2 or cells[axis] >= caps[axis]]
        if not settled:
            for axis in free:
                resolution[axis] = cells[axis]
            break
        # The shortest goes first: what it gives up is shared by the rest.
        least = min(settled, key=cells.__getitem__)
        resolution[least] = max(1, min(cells[least], caps[least]))
        free.remove(least)
    return checked((resolution[0], resolution[1], resolution[2]))


def checked_density(density: float) -> float:
    """The density itself, if it is a positive finite number.

    Raises
    ------
    InputError
        If it is not.
    """
    if not (np.isfinite(density) and density > 0):
        raise InputError(f"density is {density}; give a positive number of cells per triangle")
    return density


def checked(resolution: tuple[int, int, int]) -> tuple[int, int, int]:
    """The resolution itself, if every axis has a cell and the cells can be numbered in 32 bits.

    Raises
    ------
    InputError
        If it is not three whole numbers of at least 1.
    GridTooLargeError
        If cells cannot be numbered.
    """
    try:
        x, y, z = (int(n) for n in resolution)
        whole = (x, y, z) == tuple(resolution) and min(x, y, z) >= 1
    except (TypeError, ValueError, OverflowError):
        whole = False
    if not whole:
        raise InputError(f"resolution is {resolution}; give three whole numbers of at least 1")
    cells = x * y * z
    if cells > MOST_CELLS or max(x, y, z) > _MOST_ALONG_AXIS:
        raise GridTooLargeError(
            f"resolution {x}x{y}x{z} has {cells:,} cells, more than {MOST_CELLS:,}, or more than"
            f" {_MOST_ALONG_AXIS:,} along an axis; {SMALLER_GRID}"
        )
    return x, y, z
