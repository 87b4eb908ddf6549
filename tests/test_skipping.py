"""Empty-space skipping: distances are exact Chebyshev distances, and their bytes are counted."""

from __future__ import annotations

import numpy as np
import pytest
from cell_lists import lists_of

from clgrid import procedural
from clgrid.device import Device
from clgrid.grid import Grid, build
from clgrid.layouts import LAYOUTS
from clgrid.layouts.planes import BRICK


def occupied_bricks(grid: Grid) -> np.ndarray:
    """(Bz, By, Bx) bool from the grid's own cells."""
    lists = grid.parts[0].lists
    mx, my, mz = lists.resolution
    bx, by, bz = lists.brick_counts
    full = np.zeros((bz * BRICK, by * BRICK, bx * BRICK), bool)
    full[:mz, :my, :mx] = np.array([bool(cell) for cell in lists_of(grid)]).reshape(mz, my, mx)
    return full.reshape(bz, BRICK, by, BRICK, bx, BRICK).any(axis=(1, 3, 5))


def distances(grid: Grid) -> np.ndarray:
    lists = grid.parts[0].lists
    x, y, z = lists.brick_counts
    assert lists.distances is not None
    return grid._allocator.download(lists.distances.buffer, np.uint8, x * y * z).reshape(z, y, x)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("resolution", [(40, 40, 40), (37, 22, 9), (1, 1, 1), (70, 3, 1), (1, 5, 130)])
def test_distances_are_those_to_the_nearest_full_brick(
    resolution: tuple[int, int, int], layout: str, device: Device
) -> None:
    grid = build(procedural.icosphere(1), layout, resolution=resolution, skipping=True, device=device)
    full = occupied_bricks(grid)
    bricks = np.stack(np.meshgrid(*(np.arange(n) for n in full.shape), indexing="ij"), -1).reshape(-1, 3)
    apart = np.abs(bricks[:, None] - np.argwhere(full)[None]).max(axis=-1).min(axis=1)
    np.testing.assert_array_equal(distances(grid), apart.reshape(full.shape))


def test_distances_stop_at_the_largest_byte(device: Device) -> None:
    grid = build(procedural.icosphere(1), resolution=(4 * 700, 1, 1), skipping=True, device=device)
    assert distances(grid).max() <= 255


def test_bytes_are_one_a_brick_and_nothing_without_skipping(device: Device) -> None:
    mesh = procedural.icosphere(2)
    plain, skipping = (build(mesh, device=device, skipping=choice) for choice in (False, True))
    x, y, z = skipping.parts[0].lists.brick_counts
    assert skipping.stats.nbytes["distances"] == x * y * z
    assert skipping.nbytes - plain.nbytes == x * y * z
    assert "distances" not in plain.stats.nbytes
