"""How many cells along each axis: the density rule, with care for flat and endless scenes."""

from __future__ import annotations

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
    longest = float(extents.max())
    resolution = np.ones(3, np.int64)
    free = [axis for axis in range(3) if longest > 0 and extents[axis] > _FLATTEST * longest]
    while free:
        shares = extents[free]
        per_unit = (wanted / float(np.prod(resolution)) / float(np.prod(shares))) ** (1 / len(free))
        cells = np.rint(shares * per_unit)
        caps = np.maximum(1, np.floor(shares / _THINNEST_CELL))
        settled = (cells < 2) | (cells >= caps)
        if not settled.any():
            resolution[free] = cells.astype(np.int64)
            break
        # The shortest goes first: what it gives up is shared by the rest.
        least = int(np.argmin(np.where(settled, cells, np.inf)))
        resolution[free[least]] = max(1, int(min(cells[least], caps[least])))
        free.pop(least)
    return checked((int(resolution[0]), int(resolution[1]), int(resolution[2])))


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
