"""Where the planes of a grid lie, and how its cells are dealt to slabs."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from clgrid import structs
from clgrid.resolution import BOX_PAD

BRICK = 4
"""Cells along an edge of a brick, as in cl/config.h."""
ROW_CELLS = 64
"""Cells of a row of the hashed layout, as in cl/config.h."""

_LARGEST_SLAB_SHIFT = 16  # a cell within its slab is a ushort
_SMALLEST_SLAB_SHIFT = 13  # fewer rows would overlay badly in a table of their own
_FEWEST_SLABS = 32


def plane_params(
    bounds: npt.NDArray[np.float64],
    resolution: tuple[int, int, int],
    triangles: int,
    first_triangle: int = 0,
) -> npt.NDArray[np.void]:
    """The planes that build and walk share.

    Parameters
    ----------
    bounds : (2, 3) float64
        Of the mesh, local units.
    resolution : (int, int, int)
    triangles : int
    first_triangle : int
        Id of the first of them.
    """
    lower, size = padded_box(bounds)
    cell_size = size / np.array(resolution)
    return structs.GRID.pack(
        lower=lower,
        upper=lower + np.array(resolution) * cell_size,
        cell_size=cell_size,
        lower_f=lower,
        cells_per_unit=1 / cell_size,
        resolution=resolution,
        triangle_count=triangles,
        first_triangle=first_triangle,
        slab_shift=slab_shift(resolution[0] * resolution[1] * resolution[2]),
        first_subgrid=2**32,
    )


def padded_box(bounds: npt.NDArray[np.float64]) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Lower corner and size of the grid over a mesh of such bounds, local units."""
    # The lower corner is a float32, so that the build's float32 planes have no error of their own.
    lower = np.nextafter((bounds[0] - 2 * BOX_PAD).astype(np.float32), np.float32(-4)).astype(np.float64)
    return lower, bounds[1] + 2 * BOX_PAD - lower


def slab_shift(cells: int) -> int:
    """Large slabs keep counters few, many of them keep all threads busy."""
    wanted = (cells // _FEWEST_SLABS).bit_length() - 1
    return min(_LARGEST_SLAB_SHIFT, max(_SMALLEST_SLAB_SHIFT, wanted))
