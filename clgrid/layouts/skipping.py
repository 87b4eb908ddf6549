"""Empty-space skipping: a byte for every 4 x 4 x 4 cells says how far the nearest reference is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clgrid.layouts.binning import Work
from clgrid.layouts.lists import Array, CellLists, bricks_of
from clgrid.program import kernel


def nbytes(resolution: tuple[int, int, int]) -> int:
    """Bytes of the distances: one a brick."""
    x, y, z = bricks_of(resolution)
    return x * y * z


def with_distances(work: Work, lists: CellLists) -> CellLists:
    """The grid with a distance byte a brick, which lets rays leap over empty space."""
    queue, bricks = work.device.queue, bricks_of(work.resolution)
    size = nbytes(work.resolution)
    work.allocator.check_arrays({**lists.nbytes, "distances": size}, work.name)
    with work.stage("distances"):
        distances = work.allocator.buffer(size)
        mark = kernel(work.device, "mark_bricks.cl", "mark_bricks", **lists.list_defines)
        mark(queue, (bricks[2],), (1,), work.params, *lists.list_arguments, distances)
        spread = kernel(work.device, "spread_distances.cl", "spread_distances")
        spread(queue, (1,), (1,), *(np.int32(n) for n in bricks), distances)
    return replace(lists, distances=Array(distances, size))
