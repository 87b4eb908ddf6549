"""What each cell holds, read from a grid's arrays as cl/lists.h says, for every layout."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import numpy.typing as npt

from clgrid import structs
from clgrid.grid import Grid
from clgrid.layouts.lists import NESTED
from clgrid.layouts.planes import ROW_CELLS

DENSE_ROW = 8
Arrays = dict[str, npt.NDArray[np.unsignedinteger]]  # type: ignore[type-arg]


def lists_of(grid: Grid, part: int = 0) -> list[list[int]]:
    """The list of each cell of a part, after checking that the arrays are sound.

    A cell of a nested grid that has a subgrid lists that, with its number from ``first_subgrid`` on.
    """
    lists = grid.parts[part].lists
    read = {"compact": compact, "hashed": hashed, "linked-list": linked, "dynamic-array": dynamic}[
        NESTED.get(lists.layout, lists.layout)
    ]
    # In a nested grid every row has its slots for itself.
    options = {"dense_row": 0} if read is hashed and lists.layout in NESTED else {}
    found = read(grid.arrays(part), lists.cell_count, 1 << int(slab_shift(grid, part)), **options)
    assert len(found) == lists.cell_count
    assert sum(map(len, found)) == lists.reference_count
    assert sum(1 for cell in found if cell) == lists.full_cells
    assert all(a < b for cell in found for a, b in pairwise(cell))
    return found


def slab_shift(grid: Grid, part: int) -> int:
    return int(params_of(grid, part)["slab_shift"])


def params_of(grid: Grid, part: int = 0) -> np.void:
    """The GridParams record that kernels read."""
    params: np.void = grid._allocator.download(grid.parts[part].lists.params, structs.GRID.dtype, 1)[0]
    return params


def compact(arrays: Arrays, cells: int, slab: int) -> list[list[int]]:
    starts, references = arrays["cells"].astype(np.int64), arrays["references"]
    assert len(starts) == cells + 1
    assert starts[0] == 0
    assert (np.diff(starts) >= 0).all()
    assert starts[-1] == len(references)
    return [part.tolist() for part in np.split(references, starts[1:-1])]


def hashed(arrays: Arrays, cells: int, slab: int, dense_row: int = DENSE_ROW) -> list[list[int]]:
    domain = np.unpackbits(arrays["domain"].view(np.uint8), bitorder="little")
    assert not domain[cells:].any()
    table, tables, references = arrays["table"].astype(np.int64), arrays["table_starts"], arrays["references"]
    assert len(domain) == len(arrays["offsets"]) * ROW_CELLS
    assert table[0] == 0
    assert (np.diff(table) >= 0).all()
    assert table[-1] == len(references)
    assert len(table) == int(tables[-1]) + 1
    taken: set[int] = set()
    found: list[list[int]] = []
    for cell in range(cells):
        if not domain[cell]:
            found.append([])
            continue
        x, row = cell % ROW_CELLS, int(arrays["domain"][cell // ROW_CELLS])
        dense = row.bit_count() > dense_row
        in_row = (row & ((1 << x) - 1)).bit_count() if dense else x
        within = (int(arrays["offsets"][cell // ROW_CELLS]) + in_row) % 2**16
        slot = int(tables[cell // slab]) + within
        assert slot < int(tables[cell // slab + 1]), "a cell's slot is in its slab's table"
        assert slot not in taken, "no two cells share a slot"
        taken.add(slot)
        found.append(references[table[slot] : table[slot + 1]].tolist())
        assert found[-1], "a domain bit means a list"
    return found


def linked(arrays: Arrays, cells: int, slab: int) -> list[list[int]]:
    heads, after, triangles = arrays["heads"], arrays["next"], arrays["triangles"]
    none = int(np.iinfo(heads.dtype).max)
    assert len(heads) == cells
    found = []
    for head in heads.tolist():
        cell, node = [], head
        while node != none:
            cell.append(int(triangles[node]))
            node = int(after[node])
        found.append(cell)
    return found


def dynamic(arrays: Arrays, cells: int, slab: int) -> list[list[int]]:
    pointers, sizes, capacities = arrays["pointers"], arrays["sizes"], arrays["capacities"]
    assert len(pointers) == len(sizes) == len(capacities) == cells
    assert (sizes <= capacities).all()
    ends = pointers.astype(np.int64) + capacities
    assert (ends[:-1] == pointers[1:]).all(), "arrays lie one after another"
    assert ends[-1] == len(arrays["pool"])
    for size, capacity in zip(sizes.tolist(), capacities.tolist(), strict=True):
        assert capacity == (0 if size == 0 else 1 << (size - 1).bit_length()), "what doubling leaves"
    return [arrays["pool"][int(p) : int(p) + int(n)].tolist() for p, n in zip(pointers, sizes, strict=True)]
