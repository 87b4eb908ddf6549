"""A finished grid on the device: the arrays by which cells find their lists."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clgrid.layouts.planes import BRICK

NESTED = {"nested": "compact", "nested-hashed": "hashed"}
"""Nested layouts, with the one in which each keeps the lists of its cells."""

# Of the arrays of cl/lists.h; those of _POSITIONS are uint64 in a grid of more than 2^32 references.
_POSITIONS = ("cells", "table", "heads", "next", "pointers")
_DTYPES: dict[str, type[np.unsignedinteger[Any]]] = {
    **dict.fromkeys(
        (*_POSITIONS, "references", "table_starts", "triangles", "sizes", "capacities", "pool"), np.uint32
    ),
    "domain": np.uint64,
    "offsets": np.uint16,
}


@dataclass(frozen=True)
class Array:
    """A device buffer of which ``nbytes`` are in use."""

    buffer: Any
    nbytes: int


@dataclass(frozen=True)
class CellLists:
    """The arrays of a grid, of whatever layout.

    Attributes
    ----------
    layout : str
    params : buffer of one GridParams
    arrays : dict of str to Array
        In the order of LIST_PARAMETERS in cl/lists.h.
    resolution : (int, int, int)
    reference_count : int
        R.
    full_cells : int
        Cells with a list that is not empty.
    build_s : dict of str to float
        Seconds of each stage.
    slots : int
        Of the hash table; 0 for a layout without one.
    wide : bool
        Whether positions of references have 64 bits.
    distances : Array, optional
        A byte for every brick, by which rays leap over empty space.
    subgrids : Array, optional
        Of a nested grid.
    cells : int
        M, where the resolution does not say it: of a nested grid all cells, the top grid's among them.
    """

    layout: str
    params: Any
    arrays: dict[str, Array]
    resolution: tuple[int, int, int]
    reference_count: int
    full_cells: int
    build_s: dict[str, float]
    slots: int = 0
    wide: bool = False
    distances: Array | None = None
    subgrids: Array | None = None
    cells: int = 0

    @property
    def list_arguments(self) -> list[Any]:
        """The kernel arguments of LIST_PARAMETERS in cl/lists.h."""
        return [array.buffer for array in self.arrays.values()]

    @property
    def arguments(self) -> list[Any]:
        """The kernel arguments of GRID_PARAMETERS in cl/lists.h."""
        return [self.params, *self.buffers]

    @property
    def dtypes(self) -> dict[str, type[np.unsignedinteger[Any]]]:
        """Of the items of each array."""
        return {**_DTYPES, **dict.fromkeys(_POSITIONS, np.uint64)} if self.wide else _DTYPES

    @property
    def list_defines(self) -> dict[str, int | str]:
        """The options with which kernels that read lists are compiled."""
        return list_defines(self.layout, wide=self.wide)

    @property
    def defines(self) -> dict[str, int | str]:
        """The options with which kernels that walk this grid are compiled."""
        return {**self.list_defines, **({} if self.distances is None else {"SKIP_EMPTY": 1})}

    @property
    def cell_count(self) -> int:
        """M."""
        return self.cells or self.resolution[0] * self.resolution[1] * self.resolution[2]

    @property
    def nbytes(self) -> dict[str, int]:
        """Bytes by array."""
        nbytes = {name: array.nbytes for name, array in self.arrays.items()}
        for name, array in self._beside.items():
            nbytes[name] = array.nbytes
        return nbytes

    @property
    def _beside(self) -> dict[str, Array]:
        """Arrays that are not of the lists."""
        both = {"distances": self.distances, "subgrids": self.subgrids}
        return {name: array for name, array in both.items() if array is not None}

    @property
    def buffers(self) -> list[Any]:
        """Every buffer that goes with the grid."""
        return [*self.list_arguments, *(array.buffer for array in self._beside.values())]


def list_defines(layout: str, *, wide: bool) -> dict[str, int | str]:
    """The options of cl/lists.h for a layout; the compact one needs none."""
    if layout in NESTED:
        # A row has its slots for itself, without a search for holes that it would fit.
        dense: dict[str, int | str] = {"DENSE_ROW": "0u"} if NESTED[layout] == "hashed" else {}
        return {**list_defines(NESTED[layout], wide=wide), **dense, "NESTED": 1}
    defines: dict[str, int | str] = {} if layout == "compact" else {f"LAYOUT_{_macro(layout)}": 1}
    return {**defines, "WIDE_REFERENCES": 1} if wide else defines


def bricks_of(resolution: tuple[int, int, int]) -> tuple[int, int, int]:
    """Bricks along x, y and z that cover so many cells."""
    x, y, z = (-(-n // BRICK) for n in resolution)
    return x, y, z


def _macro(layout: str) -> str:
    return layout.upper().replace("-", "_")
