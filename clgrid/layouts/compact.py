"""The compact grid (Lagae & Dutré 2008): one index per cell and one per reference."""

from __future__ import annotations

from clgrid.layouts.binning import Binned, Work
from clgrid.layouts.lists import Array, CellLists


def nbytes(work: Work) -> dict[str, int]:
    """Bytes by array, known once references are counted."""
    return {"cells": work.index_bytes * (work.cells + 1), "references": 4 * work.reference_count}


def finish(work: Work, binned: Binned) -> CellLists:
    """Insert each slab's references into its cells; releases ``binned``."""
    allocator, sizes = work.allocator, nbytes(work)
    allocator.check_arrays(sizes, work.name)
    with work.stage("insert"):
        cells, references = (allocator.buffer(size) for size in sizes.values())
        full = allocator.buffer(4 * work.slabs)
        work.each_slab("insert_references", *binned.arguments, cells, references, full)
    full_cells = int(allocator.take(full, "uint32", work.slabs).sum())
    allocator.release(binned.slab_starts, binned.ends, binned.entries)
    return CellLists(
        layout="compact",
        params=work.params,
        arrays={"cells": Array(cells, sizes["cells"]), "references": Array(references, sizes["references"])},
        resolution=work.resolution,
        reference_count=work.reference_count,
        full_cells=full_cells,
        build_s=work.seconds,
        wide=work.wide,
    )
