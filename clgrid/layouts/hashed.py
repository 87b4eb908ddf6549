"""The hashed grid (Lagae & Dutré 2008): a bit per cell, and lists found through a perfect hash.

Rows of 64 consecutive cells are overlaid in a table so that no two full cells share a slot (row
displacement, first fit). A row of fixed length in the order of cells makes the table of offsets as small as
any axis would, whatever the resolution. Rows with many full cells would leave holes and collapse the search
(walls of interiors): their full cells alone are stored, one after another. Each slab of the build packs its
rows in a table of its own, which is what makes the build parallel, keeps an offset in 16 bits, and bounds
the search; the tables then lie one after another. A slot's list ends where the next slot's begins.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from clgrid.layouts.binning import Binned, Work
from clgrid.layouts.lists import Array, CellLists
from clgrid.layouts.planes import ROW_CELLS


@dataclass(frozen=True)
class Placed:
    """Rows with their places in the tables.

    Attributes
    ----------
    domain : buffer of uint64
        A bit per cell.
    offsets : buffer of uint16
        By row.
    starts : (slabs + 1,) uint32
        First slot of each slab's table; the last is the number of slots.
    full_cells : int
    """

    domain: Any
    offsets: Any
    starts: npt.NDArray[np.uint32]
    full_cells: int

    @property
    def slots(self) -> int:
        """Slots of all tables."""
        return int(self.starts[-1])


def place(work: Work, binned: Binned) -> Placed:
    """Mark the full cells and find every row its place."""
    allocator, rows = work.allocator, -(-work.cells // ROW_CELLS)
    with work.stage("place"):
        domain, offsets = allocator.buffer(8 * rows), allocator.buffer(2 * rows)
        slots, full = allocator.buffer(4 * work.slabs), allocator.buffer(4 * work.slabs)
        work.each_slab("place_rows", binned.slab_starts, binned.entries, domain, offsets, slots, full)
        starts = np.zeros(work.slabs + 1, np.uint32)
        np.cumsum(allocator.take(slots, "uint32", work.slabs), out=starts[1:])
        full_cells = int(allocator.take(full, "uint32", work.slabs).sum())
    return Placed(domain, offsets, starts, full_cells)


def nbytes(work: Work, placed: Placed) -> dict[str, int]:
    """Bytes by array, known once rows are placed."""
    rows = -(-work.cells // ROW_CELLS)
    return {
        "domain": 8 * rows,
        "offsets": 2 * rows,
        "table_starts": 4 * (work.slabs + 1),
        "table": work.index_bytes * (placed.slots + 1),
        "references": 4 * work.reference_count,
    }


def finish(work: Work, binned: Binned) -> CellLists:
    """Place the rows, then insert each slab's references into its table; releases ``binned``."""
    allocator, placed = work.allocator, place(work, binned)
    sizes = nbytes(work, placed)
    allocator.check_arrays(sizes, work.name)
    with work.stage("insert"):
        table_starts = allocator.filled(placed.starts)
        table, references = allocator.buffer(sizes["table"]), allocator.buffer(sizes["references"])
        work.run(
            "insert_hashed", work.slabs, np.uint32(work.slab_shift), *binned.arguments,
            placed.domain, placed.offsets,
            table_starts, table, references,
        )  # fmt: skip
    allocator.release(binned.slab_starts, binned.ends, binned.entries)
    buffers = (placed.domain, placed.offsets, table_starts, table, references)
    return CellLists(
        layout="hashed",
        params=work.params,
        arrays={name: Array(buffer, sizes[name]) for name, buffer in zip(sizes, buffers, strict=True)},
        resolution=work.resolution,
        reference_count=work.reference_count,
        full_cells=placed.full_cells,
        build_s=work.seconds,
        slots=placed.slots,
        wide=work.wide,
    )
