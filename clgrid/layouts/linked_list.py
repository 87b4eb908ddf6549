"""The linked-list grid that the paper compares with: a head per cell, a node per reference.

A node is the triangle and the position of the next node. The binned references become the nodes' triangles
in place, so that only the links are left to set.
"""

from __future__ import annotations

from clgrid.layouts.binning import Binned, Work
from clgrid.layouts.lists import Array, CellLists


def nbytes(work: Work) -> dict[str, int]:
    """Bytes by array, known once references are counted."""
    return {
        "heads": work.index_bytes * work.cells,
        "next": work.index_bytes * work.reference_count,
        "triangles": 4 * work.reference_count,
    }


def finish(work: Work, binned: Binned) -> CellLists:
    """Link each slab's references; makes triangles of the entries of ``binned`` and releases the rest."""
    allocator, sizes = work.allocator, nbytes(work)
    allocator.check_arrays(sizes, work.name)
    with work.stage("link"):
        heads, links = allocator.buffer(sizes["heads"]), allocator.buffer(sizes["next"])
        full = allocator.buffer(4 * work.slabs)
        work.each_slab("link_references", *binned.arguments, heads, links, full)
    full_cells = int(allocator.take(full, "uint32", work.slabs).sum())
    allocator.release(binned.slab_starts, binned.ends)
    return CellLists(
        layout="linked-list",
        params=work.params,
        arrays={
            "heads": Array(heads, sizes["heads"]),
            "next": Array(links, sizes["next"]),
            "triangles": Array(binned.entries, sizes["triangles"]),
        },
        resolution=work.resolution,
        reference_count=work.reference_count,
        full_cells=full_cells,
        build_s=work.seconds,
        wide=work.wide,
    )
