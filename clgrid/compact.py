"""Builds the compact grid (Lagae & Dutré 2008) on the device.

CONTROL FLOW. Everything starts and ends in ``build``; the kernels are one stage a file.

``count_references``  A *chunk* of triangles is one work-item. It turns each triangle's padded box
                      into a range of cells, and counts references per *slab*: 2^slab_shift
                      consecutive cells, small enough that a slab's counters stay in the L2 cache.
``scan_slabs``        Prefix sum over (slab, chunk): where each chunk writes into each slab.
``bin_references``    The chunks write (cell within slab, triangle) pairs to their slabs. Within a slab,
                      chunks follow one another, so triangles are ascending.
``insert_references`` A slab is one work-item: count, prefix sum, reverse insertion, as in the paper,
                      but in cache. It yields the slab's cells and lists, already in place.

No atomics and no barriers: the bytes depend on nothing but the mesh and the resolution.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from clgrid import structs
from clgrid.device import Device
from clgrid.errors import GridTooLargeError
from clgrid.memory import Allocator
from clgrid.program import kernel
from clgrid.resolution import BOX_PAD

_MOST_REFERENCES = 2**32 - 1
_LARGEST_SLAB_SHIFT = 16  # a cell within its slab is a ushort
_FEWEST_SLABS = 64
_SMALLEST_CHUNK = 4096
BRICK = 4
"""Cells along an edge of a brick, as in cl/config.h."""
_MOST_CHUNKS = 64


@dataclass(frozen=True)
class CompactGrid:
    """The finished arrays on the device.

    Attributes
    ----------
    cells : buffer of (M + 1) uint32
        Where each cell's list starts; the last entry is R.
    references : buffer of R uint32
        Triangle ids, ascending within each list.
    params : buffer of one GridParams
    resolution : (int, int, int)
    reference_count : int
        R.
    build_s : dict of str to float
        Seconds of each stage.
    """

    cells: Any
    references: Any
    params: Any
    resolution: tuple[int, int, int]
    reference_count: int
    build_s: dict[str, float]
    distances: Any = None

    @property
    def brick_counts(self) -> tuple[int, int, int]:
        """Bricks along x, y and z."""
        x, y, z = (-(-n // BRICK) for n in self.resolution)
        return x, y, z

    @property
    def arguments(self) -> list[Any]:
        """The kernel arguments of the grid, in the order of GRID_PARAMETERS in cl/grid.h."""
        skipping = [] if self.distances is None else [self.distances]
        return [self.params, self.cells, self.references, *skipping]

    @property
    def defines(self) -> dict[str, int | str]:
        """The options with which kernels that walk this grid are compiled."""
        return {} if self.distances is None else {"SKIP_EMPTY": 1}

    @property
    def cell_count(self) -> int:
        """M."""
        return self.resolution[0] * self.resolution[1] * self.resolution[2]

    @property
    def nbytes(self) -> dict[str, int]:
        """Bytes by array: exactly one index per cell (and one more), and one per reference."""
        nbytes = {"cells": 4 * (self.cell_count + 1), "references": 4 * self.reference_count}
        if self.distances is not None:
            x, y, z = self.brick_counts
            nbytes["distances"] = x * y * z
        return nbytes


def plane_params(
    bounds: npt.NDArray[np.float64], resolution: tuple[int, int, int], triangles: int
) -> npt.NDArray[np.void]:
    """The planes that build and walk share.

    Parameters
    ----------
    bounds : (2, 3) float64
        Of the mesh, local units.
    resolution : (int, int, int)
    triangles : int
    """
    # The lower corner is a float32, so that the build's float32 planes have no error of their own.
    lower = np.nextafter((bounds[0] - 2 * BOX_PAD).astype(np.float32), np.float32(-4)).astype(np.float64)
    cell_size = (bounds[1] + 2 * BOX_PAD - lower) / np.array(resolution)
    return structs.GRID.pack(
        lower=lower,
        upper=lower + np.array(resolution) * cell_size,
        cell_size=cell_size,
        lower_f=lower,
        cells_per_unit=1 / cell_size,
        resolution=resolution,
        triangle_count=triangles,
    )


def build(
    device: Device,
    allocator: Allocator,
    vertices: Any,
    faces: Any,
    params: npt.NDArray[np.void],
    skipping: bool,
) -> CompactGrid:
    """Build the grid of the triangles on the device.

    Parameters
    ----------
    device : Device
    allocator : Allocator
        Accounts for every byte, and refuses what exceeds its limit.
    vertices : buffer of 3 V + 1 float32
        Local coordinates, within [-1, 1].
    faces : buffer of 3 F uint32
    params : GridParams record
        From ``plane_params``.

    Raises
    ------
    GridTooLargeError
        If cells and references exceed the allocator's limit, or references 32 bits.
    """
    triangles = int(params["triangle_count"])
    mx, my, mz = (int(n) for n in params["resolution"])
    cell_count = mx * my * mz
    allocator.check(4 * (cell_count + 1), f"a grid of {mx}x{my}x{mz} cells")
    chunk_size = max(_SMALLEST_CHUNK, -(-triangles // _MOST_CHUNKS))
    chunks = -(-triangles // chunk_size)
    shift = min(_LARGEST_SLAB_SHIFT, max(0, (cell_count // _FEWEST_SLABS).bit_length() - 1))
    slabs = ((cell_count - 1) >> shift) + 1
    queue, seconds = device.queue, {}

    start = time.perf_counter()
    params_buffer = allocator.upload(params)
    ranges = allocator.buffer(8 * triangles)
    counts = allocator.buffer(4 * chunks * slabs)
    totals = allocator.buffer(8 * chunks)
    shape = (np.uint32(chunk_size), np.uint32(shift), np.uint32(slabs))
    kernel(device, "count_references.cl", "count_references")(
        queue, (chunks,), (1,), params_buffer, vertices, faces, *shape,
        np.uint64(_MOST_REFERENCES), ranges, counts, totals,
    )  # fmt: skip
    reference_count = int(allocator.download(totals, np.uint64, chunks).sum())
    seconds["count"] = time.perf_counter() - start
    _check_size(allocator, triangles, cell_count, reference_count, (mx, my, mz))

    start = time.perf_counter()
    slab_starts = allocator.buffer(4 * (slabs + 1))
    kernel(device, "scan_slabs.cl", "scan_slabs")(
        queue, (1,), (1,), np.uint32(chunks), np.uint32(slabs), counts, slab_starts
    )
    queue.finish()
    seconds["scan"] = time.perf_counter() - start

    start = time.perf_counter()
    binned_cells = allocator.buffer(2 * reference_count)
    binned_triangles = allocator.buffer(4 * reference_count)
    kernel(device, "bin_references.cl", "bin_references")(
        queue, (chunks,), (1,), params_buffer, vertices, faces, *shape,
        ranges, counts, binned_cells, binned_triangles,
    )  # fmt: skip
    queue.finish()
    allocator.release(ranges, counts, totals)
    seconds["bin"] = time.perf_counter() - start

    start = time.perf_counter()
    cells = allocator.buffer(4 * (cell_count + 1))
    references = allocator.buffer(4 * reference_count)
    kernel(device, "insert_references.cl", "insert_references")(
        queue, (slabs,), (1,), np.uint32(cell_count), np.uint32(shift), slab_starts,
        binned_cells, binned_triangles, cells, references,
    )  # fmt: skip
    queue.finish()
    allocator.release(slab_starts, binned_cells, binned_triangles)
    seconds["insert"] = time.perf_counter() - start
    grid = CompactGrid(cells, references, params_buffer, (mx, my, mz), reference_count, seconds)
    return _with_distances(device, allocator, grid) if skipping else grid


def _with_distances(device: Device, allocator: Allocator, grid: CompactGrid) -> CompactGrid:
    """The grid with a distance byte a brick, which lets rays leap over empty space."""
    start = time.perf_counter()
    bricks = grid.brick_counts
    distances = allocator.buffer(bricks[0] * bricks[1] * bricks[2])
    kernel(device, "mark_bricks.cl", "mark_bricks")(
        device.queue, (bricks[2],), (1,), grid.params, grid.cells, distances
    )
    kernel(device, "spread_distances.cl", "spread_distances")(
        device.queue, (1,), (1,), *(np.int32(n) for n in bricks), distances
    )
    device.queue.finish()
    seconds = {**grid.build_s, "distances": time.perf_counter() - start}
    return replace(grid, distances=distances, build_s=seconds)


def _check_size(
    allocator: Allocator,
    triangles: int,
    cell_count: int,
    reference_count: int,
    resolution: tuple[int, int, int],
) -> None:
    """Refuse, before anything large is allocated, a grid that cannot be."""
    what = f"a grid of {'x'.join(map(str, resolution))} cells and {reference_count:,} references"
    if reference_count > _MOST_REFERENCES:
        raise GridTooLargeError(f"{what} overflows 32-bit indices; lower the density or the resolution")
    finished, binned = 4 * (cell_count + 1) + 4 * reference_count, 6 * reference_count
    largest = 4 * max(cell_count + 1, reference_count)
    allocator.check(finished, what, largest, transient=binned + 8 * triangles)
