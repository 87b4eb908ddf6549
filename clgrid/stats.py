"""What a build made, and what it took."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from clgrid.layouts.lists import CellLists
from clgrid.shown import Facts
from clgrid.units import bytes_text


@dataclass(frozen=True)
class GridStats:
    """What a build made, and what it took.

    Attributes
    ----------
    triangles, cells, references : int
    resolution : (int, int, int)
        Of the first part.
    density : float
        Cells per triangle, as built.
    empty_share : float
        Share of cells with an empty list.
    slots : int
        Of the hash table; 0 for a layout without one.
    load_factor : float
        Share of the slots that hold a list; 0 without a hash table.
    parts : int
        Grids, each over a run of triangles: one unless the device's largest buffer is too small for that.
    build_s : dict of str to float
        Seconds of each stage on the device: count, scan, bin, then the layout's own.
    upload_s : float
        Seconds to bring the mesh into its local frame and to the device.
    nbytes : dict of str to int
        Bytes by array.
    peak_nbytes : int
        Most bytes that the build held on the device at once, the finished grid included.
    """

    triangles: int
    cells: int
    references: int
    resolution: tuple[int, int, int]
    density: float
    empty_share: float
    slots: int
    load_factor: float
    parts: int
    build_s: dict[str, float]
    upload_s: float
    nbytes: dict[str, int]
    peak_nbytes: int


NO_STATS = GridStats(0, 0, 0, (0, 0, 0), 0.0, 1.0, 0, 0.0, 0, {}, 0.0, {}, 0)
"""Of a mesh without triangles."""


def stats_of(lists: Sequence[CellLists], triangles: int, upload_s: float, peak_nbytes: int) -> GridStats:
    """Of the parts of a grid over so many triangles."""
    cells, slots = sum(part.cell_count for part in lists), sum(part.slots for part in lists)
    full = sum(part.full_cells for part in lists)
    return GridStats(
        triangles=triangles,
        cells=cells,
        references=sum(part.reference_count for part in lists),
        resolution=lists[0].resolution,
        density=cells / triangles,
        empty_share=(cells - full) / cells,
        slots=slots,
        load_factor=full / slots if slots else 0.0,
        parts=len(lists),
        build_s=sums([part.build_s for part in lists]),
        upload_s=upload_s,
        nbytes=sums([part.nbytes for part in lists]),
        peak_nbytes=peak_nbytes,
    )


def facts_of(stats: GridStats) -> Facts:
    """What a table shows of them."""
    cells = f"{stats.cells:,} ({'x'.join(map(str, stats.resolution))})"
    seconds = sum(stats.build_s.values())
    arrays = ", ".join(f"{name} {bytes_text(nbytes)}" for name, nbytes in stats.nbytes.items())
    return {
        "cells": cells + (f", in {stats.parts} parts" if stats.parts > 1 else ""),
        "cells per triangle": f"{stats.density:.3g}",
        "references": f"{stats.references:,}",
        "empty cells": f"{stats.empty_share:.1%}",
        "bytes": f"{bytes_text(sum(stats.nbytes.values()))}: {arrays}",
        "peak of the build": bytes_text(stats.peak_nbytes),
        "build": f"{seconds:.3g} s, and {stats.upload_s:.3g} s to the device",
    }


def sums(tables: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The tables added up, key by key."""
    total: dict[str, Any] = {}
    for table in tables:
        for key, value in table.items():
            total[key] = total.get(key, 0) + value
    return total
