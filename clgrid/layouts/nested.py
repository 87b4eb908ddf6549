"""Nested grids: cells of a coarse top grid get grids of their own, from what is in them.

CONTROL FLOW. ``plan`` decides which cells get a subgrid, and of how many cells, before any list is made:

``weigh_cells``     Counts how many triangles of a sample are entered in each cell.
``shape_subgrids``  Turns counts into subgrids: of about ``density`` cells a triangle, or, where triangles
                    are very many, coarse ones, whose cells are weighed in turn: three levels at most.
``place_subgrids``  Numbers subgrids and their cells: the top grid's cells come first, then those of
                    coarse subgrids, then all others.

From then on a nested grid is a grid like any: one row of cells, each with a list, in the compact or the
hashed layout. ``count_nested`` and ``bin_nested`` take the place of the stages of ``binning`` that know
where cells are. A cell that has a subgrid lists nothing but that, as a reference from ``first_subgrid`` on.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from clgrid import structs
from clgrid.errors import GridTooLargeError
from clgrid.layouts.binning import MOST_REFERENCES, Binned, Work, chunk_size_of
from clgrid.layouts.planes import slab_shift
from clgrid.resolution import MOST_CELLS, by_density

DEFAULT_DENSITY = 0.5
"""Cells of subgrids for each triangle of a cell."""

TOP_DENSITY = 0.0625
"""Cells of the top grid a triangle (Kalojanov et al. 2011)."""

MOST_ALONG_AXIS = 4096
"""Cells of the top grid along an axis: halved FINEST times, they are no more than a float32 can number."""

MOST_TOP_CELLS = 1 << 18

_SAMPLE = 1 << 17
_WEIGHING_ITEMS = 4
_BLOCK_CELLS, _BLOCK_OWNERS = 2048, 16
# A cell with fewer triangles gets no subgrid.
_FEWEST = 6.0


def top_resolution(extents: npt.NDArray[np.float64], triangles: int) -> tuple[int, int, int]:
    """Cells of the top grid along x, y and z, over a mesh of such extents."""
    wanted = min(max(TOP_DENSITY * triangles, 1.0), MOST_TOP_CELLS)
    return within_nest(by_density(extents, 1, wanted))


def within_nest(resolution: tuple[int, int, int]) -> tuple[int, int, int]:
    """The resolution with no more cells along an axis than a top grid may have."""
    x, y, z = (min(n, MOST_ALONG_AXIS) for n in resolution)
    return x, y, z


@dataclass(frozen=True)
class Nest:
    """Which cells have a subgrid, and where those are.

    Attributes
    ----------
    subgrids : buffer of Subgrid
    parents : buffer of uint32
        By subgrid, the cell that it is in.
    count : int
        Of subgrids.
    children : buffer of uint32
        By cell, the number of its subgrid, plus one; or 0.
    parent_cells : int
        Cells that ``children`` knows: the first ones.
    cells : int
        Of all grids together.
    """

    subgrids: Any
    parents: Any
    count: int
    children: Any
    parent_cells: int
    cells: int

    @property
    def nbytes(self) -> int:
        """Bytes of the subgrids."""
        return max(self.count, 1) * structs.SUBGRID.dtype.itemsize


class _Plan:
    """Subgrids as they are found, pass by pass."""

    def __init__(self, work: Work, density: float) -> None:
        self.work = work
        self.density = density
        self.subgrids = work.allocator.buffer(structs.SUBGRID.dtype.itemsize)
        self.parents = work.allocator.buffer(4)
        self.children = work.allocator.buffer(4)
        self.count = self.known = 0
        self.cells = work.cells

    def refine(self, first: int, cells: int, owners: int) -> tuple[int, int]:
        """Give subgrids to the cells first .. first + cells - 1: coarse ones that are found, and their cells.

        Those cells are the top grid's, or those of ``owners`` coarse subgrids, which are the first ones.
        """
        work, allocator = self.work, self.work.allocator
        stride = -(-work.triangles // _SAMPLE)
        weights = allocator.buffer(4 * _WEIGHING_ITEMS * cells)
        work.run(
            "weigh_cells", _WEIGHING_ITEMS, work.params, work.vertices, work.faces,
            np.uint32(stride), np.uint32(work.triangles // stride), self.subgrids, self.children,
            np.uint32(self.known), np.uint32(first), np.uint32(cells), weights,
        )  # fmt: skip
        block = _BLOCK_OWNERS if owners else _BLOCK_CELLS
        blocks = -(-(owners or cells) // block)
        totals = allocator.buffer(16 * blocks)
        place = (np.uint32(owners), np.uint32(first), np.uint32(cells), np.uint32(block))
        work.run(
            "shape_subgrids", blocks, work.params, self.subgrids, *place, np.uint32(_WEIGHING_ITEMS),
            np.float32(stride), np.float32(self.density), np.float32(_FEWEST), np.uint32(owners),
            weights, totals,
        )  # fmt: skip
        found = allocator.take(totals, "uint32", 4 * blocks).reshape(blocks, 4).astype(np.int64)
        starts, sums = _starts(found, self.count, self.cells)
        self._check(int(sums[1] + sums[3]))
        self._grow(int(sums[0] + sums[2]), first + cells)
        numbers = allocator.filled(starts.astype(np.uint32))
        work.run(
            "place_subgrids", blocks, work.params, *place, weights, numbers, self.subgrids, self.children,
            self.parents,
        )  # fmt: skip
        allocator.release(weights, numbers)
        self.count += int(sums[0] + sums[2])
        self.cells += int(sums[1] + sums[3])
        return int(sums[0]), int(sums[1])

    def _check(self, more: int) -> None:
        if self.cells + more > MOST_CELLS:
            raise GridTooLargeError(
                f"a nested grid of {self.cells + more:,} cells has more than {MOST_CELLS:,}; lower the density"
            )

    def _grow(self, subgrids: int, known: int) -> None:
        """Room for so many more subgrids, and for the children of so many cells."""
        size = structs.SUBGRID.dtype.itemsize
        self.subgrids = self._grown(self.subgrids, size * self.count, size * (self.count + subgrids))
        self.parents = self._grown(self.parents, 4 * self.count, 4 * (self.count + subgrids))
        self.children = self._grown(self.children, 4 * self.known, 4 * known)
        self.known = known

    def _grown(self, buffer: Any, used: int, nbytes: int) -> Any:
        import pyopencl as cl

        larger = self.work.allocator.buffer(nbytes)
        if used:
            cl.enqueue_copy(self.work.device.queue, larger, buffer, byte_count=used)
            self.work.device.queue.finish()
        self.work.allocator.release(buffer)
        return larger

    def nest(self) -> Nest:
        return Nest(self.subgrids, self.parents, self.count, self.children, self.known, self.cells)


def _starts(
    found: npt.NDArray[np.int64], count: int, cells: int
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Numbers of each block's first subgrids and cells, coarse ones before all others; and the sums."""
    sums = found.sum(axis=0)
    before = np.cumsum(found, axis=0) - found
    return before + np.array([count, cells, count + sums[0], cells + sums[1]]), sums


def plan(work: Work, density: float) -> Nest:
    """Decide on the subgrids; sets the work's cells and slabs, and its params.

    Parameters
    ----------
    work : Work
        Over the top grid.
    density : float
        Cells of subgrids a triangle.
    """
    with work.stage("plan"):
        building = _Plan(work, density)
        owners, cells = building.refine(0, work.cells, 0)
        if owners:
            building.refine(work.cells, cells, owners)
        nest = building.nest()
    _become(work, nest)
    return nest


def _become(work: Work, nest: Nest) -> None:
    """From the top grid to all cells."""
    work.cells = nest.cells
    work.slab_shift = slab_shift(nest.cells)
    work.slabs = ((work.cells - 1) >> work.slab_shift) + 1
    chunk_size = chunk_size_of(work.triangles)
    first = -(-work.triangles // chunk_size) * chunk_size
    if first + nest.count > MOST_REFERENCES:
        raise GridTooLargeError(
            f"{work.name}: {work.triangles:,} triangles and {nest.count:,} subgrids have no numbers of 32 bits"
        )
    params = work.host_params.copy()
    params["first_subgrid"], params["slab_shift"] = first, work.slab_shift
    work.host_params = params
    work.params = work.allocator.upload(params)


def sort_by_slab(work: Work, nest: Nest) -> Binned:
    """Count references and bring each to its slab, as ``binning`` does for a grid that is not nested."""
    allocator, chunk_size = work.allocator, chunk_size_of(work.triangles)
    chunks = -(-work.triangles // chunk_size)
    items = chunks + -(-nest.count // chunk_size)
    shape = (np.uint32(chunks), np.uint32(chunk_size), np.uint32(work.slab_shift), np.uint32(work.slabs))
    count, parent_cells = np.uint32(nest.count), np.uint32(nest.parent_cells)
    inside = (nest.subgrids, nest.parents, count, nest.children, parent_cells)
    with work.stage("count"):
        counts, totals = allocator.buffer(4 * items * work.slabs), allocator.buffer(8 * items)
        work.run(
            "count_nested", items, work.params, work.vertices, work.faces, *shape,
            np.uint64(MOST_REFERENCES), *inside, counts, totals,
        )  # fmt: skip
        total = int(allocator.take(totals, np.uint64, items).sum())
    if total > MOST_REFERENCES:
        raise GridTooLargeError(
            f"{work.name}: more than {MOST_REFERENCES:,} references; take a layout that is not nested"
        )
    work.reference_count = total
    starts, slab_starts = allocator.buffer(4 * items * work.slabs), allocator.buffer(4 * (work.slabs + 1))
    with work.stage("scan"):
        work.run("scan_slabs", 1, np.uint32(items), np.uint32(work.slabs), counts, starts, slab_starts)
    with work.stage("bin"):
        entries = allocator.buffer(4 * total)
        work.run(
            "bin_nested", items, work.params, work.vertices, work.faces, *shape, *inside, starts, entries
        )
    allocator.release(starts, nest.parents, nest.children)
    return Binned(slab_starts, counts, np.uint32(items), np.uint32(chunk_size), entries)
