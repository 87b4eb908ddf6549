"""The dynamic-array grid that the paper compares with: a pointer, a size and a capacity per cell.

Counted blocks: capacities are those that doubling would leave, but each array is laid out once, from a
count, since a device has no heap. So the bytes are those of growth by doubling with every outgrown array
given back, and the copies that growth would make are not paid for.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from clgrid.layouts.binning import Binned, Work
from clgrid.layouts.lists import Array, CellLists


@dataclass(frozen=True)
class Sized:
    """Arrays with their sizes and capacities, not yet filled.

    Attributes
    ----------
    sizes, capacities : buffer of M uint32
    starts : (slabs + 1,) uint64
        First entry of each slab's arrays in the pool; the last is their number.
    full_cells : int
    """

    sizes: Any
    capacities: Any
    starts: npt.NDArray[np.uint64]
    full_cells: int


def measure(work: Work, binned: Binned) -> Sized:
    """Size every cell's array."""
    allocator = work.allocator
    allocator.check(12 * work.cells, work.name, largest=4 * work.cells)
    with work.stage("size"):
        sizes, capacities = allocator.buffer(4 * work.cells), allocator.buffer(4 * work.cells)
        room, full = allocator.buffer(8 * work.slabs), allocator.buffer(4 * work.slabs)
        work.each_slab("size_arrays", binned.slab_starts, binned.entries, sizes, capacities, room, full)
        starts = np.zeros(work.slabs + 1, np.uint64)
        np.cumsum(allocator.take(room, "uint64", work.slabs), out=starts[1:])
        full_cells = int(allocator.take(full, "uint32", work.slabs).sum())
    return Sized(sizes, capacities, starts, full_cells)


def nbytes(work: Work, sized: Sized) -> dict[str, int]:
    """Bytes by array, known once arrays are sized."""
    return {
        "pointers": work.index_bytes * work.cells,
        "sizes": 4 * work.cells,
        "capacities": 4 * work.cells,
        "pool": 4 * int(sized.starts[-1]),
    }


def finish(work: Work, binned: Binned) -> CellLists:
    """Size the arrays, then append each slab's references to them; releases ``binned``."""
    allocator, sized = work.allocator, measure(work, binned)
    sizes = nbytes(work, sized)
    allocator.check_arrays(sizes, work.name)
    with work.stage("append"):
        pointers, pool = allocator.buffer(sizes["pointers"]), allocator.buffer(sizes["pool"])
        starts = allocator.filled(sized.starts)
        work.each_slab(
            "append_references", *binned.arguments, starts,
            pointers, sized.sizes, sized.capacities, pool,
        )  # fmt: skip
    allocator.release(starts, binned.slab_starts, binned.ends, binned.entries)
    buffers = (pointers, sized.sizes, sized.capacities, pool)
    return CellLists(
        layout="dynamic-array",
        params=work.params,
        arrays={name: Array(buffer, sizes[name]) for name, buffer in zip(sizes, buffers, strict=True)},
        resolution=work.resolution,
        reference_count=work.reference_count,
        full_cells=sized.full_cells,
        build_s=work.seconds,
        wide=work.wide,
    )
