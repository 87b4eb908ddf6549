"""Nested grids: cells of a coarse top grid get grids of their own, from what is in them.

CONTROL FLOW. ``build`` starts from a compact top grid, made by the stages that all layouts share, and goes
down:

``shape_subgrids``   Decides which cells get a subgrid, and of how many cells, by the lengths of their lists:
                     of about ``density`` cells a triangle, or, where triangles are very many, coarse ones,
                     whose cells get lists (``count_subgrids``, ``fill_subgrids``) and may get subgrids in
                     turn: three levels at most.
``place_subgrids``   Numbers subgrids and their cells: the top grid's cells come first, then those of coarse
                     subgrids, then all others.
``count_kept``, ``count_subgrids``
                     Count the references of all cells. A cell that has a subgrid lists nothing but that, as
                     a reference from ``first_subgrid`` on; others of the upper levels keep their lists.
``fill_kept``, ``fill_subgrids``
                     Write them. A nested grid is then a compact grid like any other: one row of cells, each
                     with a list.
``mark_rows``, ``fill_table``
                     Hashed: keep the beginnings of the lists of full cells alone.

A work-item takes some cells, or some subgrids, so that the bytes depend on nothing but mesh and density.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from clgrid import structs
from clgrid.errors import GridTooLargeError
from clgrid.layouts import binning, compact
from clgrid.layouts.binning import MOST_REFERENCES, Work
from clgrid.layouts.lists import NESTED, Array, CellLists
from clgrid.layouts.planes import ROW_CELLS, slab_shift
from clgrid.resolution import MOST_CELLS, by_density

DEFAULT_DENSITY = 0.5
"""Cells of subgrids for each triangle in them."""

TOP_DENSITY = 0.0625
"""Cells of the top grid a triangle (Kalojanov et al. 2011)."""

MOST_ALONG_AXIS = 4096
"""Cells of the top grid along an axis: halved FINEST times, they are no more than a float32 can number."""

MOST_TOP_CELLS = 1 << 22

_BLOCK_CELLS, _BLOCK_SUBGRIDS = 2048, 4
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
class _Lists:
    """Lists with the triangles of consecutive cells.

    Attributes
    ----------
    first, cells : int
        Number of the first cell, and of cells.
    begins : buffer of (cells + 1) uint32
        Where each one's list begins.
    entries : buffer of R uint32
        All lists.
    entry_count : int
        R.
    """

    first: int
    cells: int
    begins: Any
    entries: Any
    entry_count: int


@dataclass(frozen=True)
class _Run:
    """Consecutive subgrids, the lists of the cells that they are in, and how many a work-item takes."""

    first: int
    end: int
    lists: _Lists
    block: int = _BLOCK_SUBGRIDS

    @property
    def blocks(self) -> int:
        """Work-items."""
        return -(-(self.end - self.first) // self.block)


class _Nest:
    """A nested grid while it is built.

    Attributes
    ----------
    subgrids, parents : buffer of Subgrid, buffer of uint32
        By subgrid, what it is, and the cell that it is in.
    children : buffer of uint32
        By cell that may have a subgrid, its number plus one, or 0.
    count, cells : int
        Of subgrids, and of the cells of all grids together.
    """

    def __init__(self, work: Work, density: float) -> None:
        self.work = work
        self.allocator = work.allocator
        self.density = density
        self.subgrids = self.allocator.buffer(_SUBGRID_BYTES)
        self.parents = self.allocator.buffer(4)
        self.children = self.allocator.buffer(4)
        self.count = self.known = 0
        self.cells = work.cells

    def refine(self, lists: _Lists, owners: int) -> tuple[int, int]:
        """Give subgrids to cells with such lists: how many coarse ones, and the number of their cells.

        The cells are the top grid's, or those of ``owners`` coarse subgrids, which are the first ones.
        """
        work, allocator = self.work, self.allocator
        block = _BLOCK_SUBGRIDS if owners else _BLOCK_CELLS
        blocks = -(-(owners or lists.cells) // block)
        halvings, totals = allocator.buffer(4 * lists.cells), allocator.buffer(16 * blocks)
        place = (np.uint32(owners), np.uint32(lists.first), np.uint32(lists.cells), np.uint32(block))
        work.run(
            "shape_subgrids", blocks, work.params, self.subgrids, *place, lists.begins,
            np.float32(self.density), np.float32(_FEWEST), halvings, totals,
        )  # fmt: skip
        found = allocator.take(totals, "uint32", 4 * blocks).reshape(blocks, 4).astype(np.int64)
        coarse, coarse_cells, others, other_cells = (int(n) for n in found.sum(axis=0))
        self._check(coarse_cells + other_cells)
        before = np.cumsum(found, axis=0) - found
        starts = before + np.array([self.count, self.cells, self.count + coarse, self.cells + coarse_cells])
        self._grow(coarse + others, lists.first + lists.cells)
        numbers = allocator.filled(starts.astype(np.uint32))
        work.run(
            "place_subgrids", blocks, work.params, *place, halvings, numbers, self.subgrids, self.children,
            self.parents,
        )  # fmt: skip
        work.device.queue.finish()
        allocator.release(halvings, numbers)
        self.count += coarse + others
        self.cells += coarse_cells + other_cells
        return coarse, coarse_cells

    def _check(self, more: int) -> None:
        total = self.cells + more
        if total > MOST_CELLS:
            raise GridTooLargeError(
                f"a nested grid of {total:,} cells has more than {MOST_CELLS:,}; lower the density"
            )
        self.allocator.check(4 * (total + 1), f"a nested grid of {total:,} cells")

    def _grow(self, subgrids: int, known: int) -> None:
        """Room for so many more subgrids, and for the children of so many cells."""
        count = self.count
        self.subgrids = self._grown(
            self.subgrids, _SUBGRID_BYTES * count, _SUBGRID_BYTES * max(count + subgrids, 1)
        )
        self.parents = self._grown(self.parents, 4 * count, 4 * (count + subgrids))
        self.children = self._grown(self.children, 4 * self.known, 4 * known)
        self.known = known

    def _grown(self, buffer: Any, used: int, nbytes: int) -> Any:
        import pyopencl as cl

        larger = self.allocator.buffer(nbytes)
        if used:
            cl.enqueue_copy(self.work.device.queue, larger, buffer, byte_count=used)
            self.work.device.queue.finish()
        self.allocator.release(buffer)
        return larger

    def count_run(self, run: _Run, first_counted: int, counts: Any) -> tuple[Any, npt.NDArray[np.uint64]]:
        """Count the cells of some subgrids: marks of their lists' entries, and totals by block."""
        work, blocks = self.work, run.blocks
        marks, totals = self.allocator.buffer(8 * run.lists.entry_count), self.allocator.buffer(8 * blocks)
        work.run(
            "count_subgrids", blocks, work.params, work.vertices, work.faces, *self._of(run), marks,
            np.uint32(first_counted), counts, totals,
        )  # fmt: skip
        return marks, self.allocator.take(totals, np.uint64, blocks)

    def fill_run(
        self,
        run: _Run,
        first_counted: int,
        counts: Any,
        marks: Any,
        starts: npt.NDArray[np.uint64],
        references: Any,
    ) -> int:
        """Write the lists of their cells, each block's from its start on; how many cells have one."""
        work, allocator, blocks = self.work, self.allocator, len(starts)
        numbers, full = allocator.filled(starts.astype(np.uint32)), allocator.buffer(4 * blocks)
        work.run(
            "fill_subgrids", blocks, work.params, work.vertices, work.faces, *self._of(run), marks,
            np.uint32(first_counted), counts, numbers, references, full,
        )  # fmt: skip
        found = allocator.take(full, "uint32", blocks)
        allocator.release(numbers, marks)
        return int(found.sum())

    def _of(self, run: _Run) -> tuple[Any, ...]:
        lists = run.lists
        numbers = (
            np.uint32(run.first),
            np.uint32(run.end),
            np.uint32(run.block),
            np.uint32(lists.first),
        )
        return self.subgrids, self.parents, *numbers, lists.begins, lists.entries

    def count_kept(self, lists: _Lists) -> npt.NDArray[np.uint64]:
        """References of cells that may have a subgrid, by block."""
        blocks = -(-lists.cells // _BLOCK_CELLS)
        totals = self.allocator.buffer(8 * blocks)
        self.work.run("count_kept", blocks, *_place(lists), lists.begins, self.children, totals)
        return self.allocator.take(totals, np.uint64, blocks)

    def fill_kept(self, lists: _Lists, starts: npt.NDArray[np.uint64], begins: Any, references: Any) -> int:
        """Write their lists; how many of them have one."""
        allocator, blocks = self.allocator, len(starts)
        numbers, full = allocator.filled(starts.astype(np.uint32)), allocator.buffer(4 * blocks)
        self.work.run(
            "fill_kept", blocks, *_place(lists), lists.begins, lists.entries, self.children,
            np.uint32(self.work.triangles), numbers, begins, references, full,
        )  # fmt: skip
        found = allocator.take(full, "uint32", blocks)
        allocator.release(numbers)
        return int(found.sum())


_SUBGRID_BYTES = structs.SUBGRID.dtype.itemsize


def _place(lists: _Lists) -> tuple[np.uint32, np.uint32, np.uint32]:
    return np.uint32(lists.first), np.uint32(lists.cells), np.uint32(_BLOCK_CELLS)


def _total(work: Work, counts: npt.NDArray[np.uint64]) -> int:
    """Their sum, if references can be numbered."""
    total = int(counts.sum())
    if total + work.triangles > MOST_REFERENCES:
        raise GridTooLargeError(
            f"{work.name} with grids in them: {total:,} references are too many;"
            " take a layout that is not nested"
        )
    return total


def _begins(counts: npt.NDArray[np.uint64]) -> npt.NDArray[np.uint64]:
    return np.cumsum(counts) - counts


def _top_lists(work: Work) -> _Lists:
    """The compact grid over the top cells."""
    top = compact.finish(work, binning.sort_by_slab(work, binning.count(work)))
    if top.wide:
        raise GridTooLargeError(f"{work.name} has too many references; take a layout that is not nested")
    cells, references = top.arrays["cells"], top.arrays["references"]
    return _Lists(0, work.cells, cells.buffer, references.buffer, top.reference_count)


def _inner_lists(nest: _Nest, owners: int, cells: int, top: _Lists) -> _Lists:
    """The lists of the cells of coarse subgrids."""
    # Each is of very many triangles.
    run, first, allocator = _Run(0, owners, top, block=1), nest.work.cells, nest.allocator
    begins = allocator.buffer(4 * (cells + 1))
    marks, counts = nest.count_run(run, first, begins)
    total = _total(nest.work, counts)
    entries = allocator.buffer(4 * total)
    nest.fill_run(run, first, begins, marks, _begins(counts), entries)
    _end(nest.work, begins, cells, total)
    return _Lists(first, cells, begins, entries, total)


def _end(work: Work, begins: Any, cells: int, total: int) -> None:
    """Where the last list ends."""
    import pyopencl as cl

    cl.enqueue_copy(
        work.device.queue, begins, np.array([total], np.uint32), dst_offset=4 * cells, is_blocking=True
    )


def build(work: Work, layout: str, density: float) -> CellLists:
    """Build a nested grid.

    Parameters
    ----------
    work : Work
        Over the top grid.
    layout : str
        One of NESTED.
    density : float
        Cells of subgrids for each triangle in them.

    Raises
    ------
    GridTooLargeError
        If the arrays exceed the allocator's limit or the device, or references have no numbers of 32 bits.
    """
    allocator, top = work.allocator, _top_lists(work)
    nest, kept = _Nest(work, density), [top]
    with work.stage("plan"):
        owners, cells = nest.refine(top, 0)
    runs = [_Run(owners, nest.count, top)]
    if owners:
        with work.stage("split"):
            kept.append(_inner_lists(nest, owners, cells, top))
        with work.stage("plan"):
            first = nest.count
            nest.refine(kept[1], owners)
        runs.append(_Run(first, nest.count, kept[1]))
    lists = _finish(nest, layout, kept, [run for run in runs if run.end > run.first])
    allocator.release(nest.parents, nest.children, *(b for each in kept for b in (each.begins, each.entries)))
    return lists


def _finish(nest: _Nest, layout: str, kept: list[_Lists], runs: list[_Run]) -> CellLists:
    """The lists of all cells, in their order."""
    work, allocator = nest.work, nest.allocator
    subgrids = Array(nest.subgrids, max(nest.count, 1) * _SUBGRID_BYTES)
    sizes = {"cells": 4 * (nest.cells + 1), "subgrids": subgrids.nbytes}
    allocator.check_arrays(sizes, work.name)
    with work.stage("count in subgrids"):
        begins = allocator.buffer(sizes["cells"])
        counts = [nest.count_kept(each) for each in kept]
        marks = []
        for run in runs:
            mark, total = nest.count_run(run, 0, begins)
            marks.append(mark)
            counts.append(total)
    references = _total(work, np.concatenate(counts))
    sizes["references"] = 4 * references
    if NESTED[layout] == "compact":
        allocator.check_arrays(sizes, work.name)
    with work.stage("insert in subgrids"):
        entries = allocator.buffer(sizes["references"])
        starts = np.split(_begins(np.concatenate(counts)), np.cumsum([len(each) for each in counts])[:-1])
        full = sum(nest.fill_kept(each, at, begins, entries) for each, at in zip(kept, starts, strict=False))
        for run, mark, at in zip(runs, marks, starts[len(kept) :], strict=True):
            full += nest.fill_run(run, 0, begins, mark, at, entries)
        _end(work, begins, nest.cells, references)
    _become(nest)
    arrays = {"cells": Array(begins, sizes["cells"]), "references": Array(entries, sizes["references"])}
    if NESTED[layout] == "hashed":
        arrays = _hashed(nest, begins, full, arrays["references"], subgrids)
    return CellLists(
        layout=layout,
        params=work.params,
        arrays=arrays,
        resolution=work.resolution,
        reference_count=references,
        full_cells=full,
        build_s=work.seconds,
        slots=full if NESTED[layout] == "hashed" else 0,
        subgrids=subgrids,
        cells=nest.cells,
    )


def _become(nest: _Nest) -> None:
    """The work's cells and params: from those of the top grid to all."""
    work = nest.work
    work.cells, work.slab_shift = nest.cells, slab_shift(nest.cells)
    work.slabs = ((work.cells - 1) >> work.slab_shift) + 1
    params = work.host_params.copy()
    params["first_subgrid"], params["slab_shift"] = work.triangles, work.slab_shift
    work.params = work.allocator.upload(params)


def _hashed(nest: _Nest, begins: Any, full: int, references: Array, subgrids: Array) -> dict[str, Array]:
    """A bit for every cell, and the beginnings of the lists of those that have one; releases ``begins``."""
    work, allocator, rows = nest.work, nest.allocator, -(-nest.cells // ROW_CELLS)
    sizes = {
        "domain": 8 * rows,
        "offsets": 2 * rows,
        "table_starts": 4 * (work.slabs + 1),
        "table": 4 * (full + 1),
    }
    allocator.check_arrays({**sizes, "references": references.nbytes, "subgrids": subgrids.nbytes}, work.name)
    with work.stage("hash"):
        domain, offsets = allocator.buffer(sizes["domain"]), allocator.buffer(sizes["offsets"])
        slots, table = allocator.buffer(4 * work.slabs), allocator.buffer(sizes["table"])
        work.each_slab("mark_rows", begins, domain, offsets, slots)
        starts = np.zeros(work.slabs + 1, np.uint32)
        np.cumsum(allocator.take(slots, "uint32", work.slabs), out=starts[1:])
        table_starts = allocator.filled(starts)
        work.each_slab("fill_table", begins, table_starts, table)
    allocator.release(begins)
    buffers = (domain, offsets, table_starts, table)
    arrays = {name: Array(buffer, sizes[name]) for name, buffer in zip(sizes, buffers, strict=True)}
    return {**arrays, "references": references}
