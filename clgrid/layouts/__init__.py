"""Layouts: how cells find their lists. Each finishes a build in a file of its own.

CONTROL FLOW. Everything starts and ends in ``build``: references are counted and sorted by slab
(``binning``), the layout finishes each slab, and ``skipping`` adds its distances where asked for.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from clgrid.device import Device
from clgrid.layouts import compact, dynamic_array, hashed, linked_list, nested, skipping
from clgrid.layouts.binning import Binned, Work, count, sort_by_slab
from clgrid.layouts.lists import NESTED, CellLists
from clgrid.layouts.planes import ROW_CELLS
from clgrid.memory import Allocator
from clgrid.resolution import DEFAULT_DENSITY

_FINISH = {
    "compact": compact.finish,
    "hashed": hashed.finish,
    "linked-list": linked_list.finish,
    "dynamic-array": dynamic_array.finish,
}
LAYOUTS = tuple(_FINISH)
"""Of grids whose cells are all of one size."""
ALL_LAYOUTS = (*LAYOUTS, *NESTED)
_STAGES = {
    "compact": ("insert_references",),
    "hashed": ("place_rows", "insert_hashed"),
    "linked-list": ("link_references",),
    "dynamic-array": ("size_arrays", "append_references"),
}


_NESTED_STAGES = (
    "shape_subgrids", "place_subgrids", "count_kept", "count_subgrids", "fill_kept", "fill_subgrids",
)  # fmt: skip


def programs(layout: str, *, skip: bool) -> tuple[str, ...]:
    """The files that a build compiles."""
    if layout in NESTED:
        stages = ["count_references", "scan_slabs", "bin_references", *_STAGES["compact"], *_NESTED_STAGES]
        stages += ["mark_rows", "fill_table"] if NESTED[layout] == "hashed" else []
    else:
        stages = ["count_references", "scan_slabs", "bin_references", *_STAGES[layout]]
    stages += ["mark_bricks", "spread_distances"] if skip else []
    return tuple(f"{stage}.cl" for stage in stages)


def build(
    device: Device,
    allocator: Allocator,
    vertices: Any,
    faces: Any,
    params: npt.NDArray[np.void],
    layout: str,
    skip: bool,
    density: float = DEFAULT_DENSITY,
) -> CellLists:
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
        From ``planes.plane_params``.
    layout : str
        One of LAYOUTS.
    skip : bool
        Whether to add the distances of empty-space skipping; a nested layout has none.
    density : float
        Cells of subgrids by triangle, of a nested layout.

    Raises
    ------
    GridTooLargeError
        If the arrays exceed the allocator's limit or the device.
    """
    work = Work(device, allocator, vertices, faces, params)
    if layout in NESTED:
        return nested.build(work, layout, density)
    lists = _FINISH[layout](work, _sorted(work, layout, skip))
    return skipping.with_distances(work, lists) if skip else lists


def predict(
    device: Device,
    allocator: Allocator,
    vertices: Any,
    faces: Any,
    params: npt.NDArray[np.void],
    layout: str,
    skip: bool,
    density: float = DEFAULT_DENSITY,
) -> dict[str, int]:
    """Bytes by array of the grid that ``build`` would make, exactly; none of them is kept.

    References are counted; only layouts whose size depends on where they fall sort them too.
    """
    work = Work(device, allocator, vertices, faces, params)
    if layout in NESTED:
        return _predict_nested(work, layout, density)
    sizes = _predict(work, layout)
    return {**sizes, "distances": skipping.nbytes(work.resolution)} if skip else sizes


def _predict_nested(work: Work, layout: str, density: float) -> dict[str, int]:
    """Where lists fall decides on everything, so that the grid is made and given back."""
    lists = nested.build(work, layout, density)
    work.allocator.release(*lists.buffers)
    return lists.nbytes


def _predict(work: Work, layout: str) -> dict[str, int]:
    allocator, counted = work.allocator, count(work)
    if layout in ("compact", "linked-list"):
        allocator.release(*counted.buffers)
        return compact.nbytes(work) if layout == "compact" else linked_list.nbytes(work)
    binned = sort_by_slab(work, counted)
    if layout == "hashed":
        placed = hashed.place(work, binned)
        sizes, made = hashed.nbytes(work, placed), [placed.domain, placed.offsets]
    else:
        sized = dynamic_array.measure(work, binned)
        sizes, made = dynamic_array.nbytes(work, sized), [sized.sizes, sized.capacities]
    allocator.release(binned.slab_starts, binned.ends, binned.entries, *made)
    return sizes


def _sorted(work: Work, layout: str, skip: bool) -> Binned:
    """References by slab, once it is known that at least what must be of the grid can be."""
    allocator, least = work.allocator, _least_nbytes(work, layout)
    allocator.check(sum(least.values()), work.name, largest=max(least.values()))
    counted = count(work)
    least = _least_nbytes(work, layout)
    sorting = 4 * work.reference_count
    what = f"{work.name} and {work.reference_count:,} references"
    extra = skipping.nbytes(work.resolution) if skip else 0
    allocator.check(
        sum(least.values()) + extra, what, largest=max(least.values()), transient=sorting + 8 * work.triangles
    )
    return sort_by_slab(work, counted)


def _least_nbytes(work: Work, layout: str) -> dict[str, int]:
    """What the layout's arrays take in any case, whatever is not counted yet."""
    if layout == "compact":
        return compact.nbytes(work)
    if layout == "linked-list":
        return linked_list.nbytes(work)
    if layout == "hashed":
        return {"domain": 8 * (work.cells // ROW_CELLS), "references": 4 * work.reference_count}
    each = dict.fromkeys(("pointers", "sizes", "capacities"), 4 * work.cells)
    return {**each, "pool": 4 * work.reference_count}
