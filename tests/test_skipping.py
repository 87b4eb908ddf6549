"""Empty-space skipping: distances are exact Chebyshev distances, and their bytes are counted."""

from __future__ import annotations

import numpy as np
import pytest
from cell_lists import lists_of

from clgrid import procedural
from clgrid.device import Device
from clgrid.grid import Grid, build
from clgrid.layouts import LAYOUTS
from clgrid.layouts.lists import bricks_of
from clgrid.layouts.planes import BRICK
from clgrid.mesh import Mesh


def occupied_bricks(grid: Grid) -> np.ndarray:
    """(Bz, By, Bx) bool from the grid's own cells."""
    lists = grid.parts[0].lists
    mx, my, mz = lists.resolution
    bx, by, bz = bricks_of(lists.resolution)
    full = np.zeros((bz * BRICK, by * BRICK, bx * BRICK), bool)
    full[:mz, :my, :mx] = np.array([bool(cell) for cell in lists_of(grid)]).reshape(mz, my, mx)
    return full.reshape(bz, BRICK, by, BRICK, bx, BRICK).any(axis=(1, 3, 5))


def distances(grid: Grid) -> np.ndarray:
    lists = grid.parts[0].lists
    x, y, z = bricks_of(lists.resolution)
    assert lists.distances is not None
    return grid._allocator.download(lists.distances.buffer, np.uint8, x * y * z).reshape(z, y, x)


@pytest.mark.thorough
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
    plain, skipping = (build(mesh, density=4, device=device, skipping=choice) for choice in (False, True))
    x, y, z = bricks_of(skipping.parts[0].lists.resolution)
    assert skipping.stats.nbytes["distances"] == x * y * z
    assert skipping.nbytes - plain.nbytes == x * y * z
    assert "distances" not in plain.stats.nbytes


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("x", "steps"), [(40, 12), (39, 11)])
def test_an_empty_brick_is_one_step_and_far_from_references_less(
    x: int, steps: int, sign: float, device: Device
) -> None:
    low, high = (
        np.array([[0, 0, 0], [0.01, 0.1, 0], [0, 0, 0.1]]),
        np.array([[1, 1, 1], [0.99, 0.9, 1], [1, 1, 0.9]]),
    )
    mesh = Mesh(np.concatenate([low, high]).astype(np.float32), np.arange(6, dtype=np.uint32).reshape(2, 3))
    ray = np.array([[0.5 - 2 * sign, 0.45, 0.45]]), np.array([[sign, 0.0, 0.0]])
    plain, skipping = (
        build(mesh, resolution=(x, 4, 4), skipping=choice, device=device).cast(*ray, fields=("steps",))
        for choice in (False, True)
    )
    assert plain.steps is not None
    assert skipping.steps is not None
    assert not plain.mask.any()
    # Distances 0 1 2 3 4 4 3 2 1 0: 4 cells, a brick, leaps of 2 and 4 bricks, a brick, 4 or 3 cells.
    assert (plain.steps.tolist(), skipping.steps.tolist()) == ([x], [steps])
