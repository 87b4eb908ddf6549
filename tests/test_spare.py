"""Buffers wait for the next build: it allocates nothing, and makes the same bytes."""

from __future__ import annotations

import gc

import numpy as np
import pytest

import clgrid
from clgrid import spare
from clgrid.device import Device
from clgrid.grid import Grid
from clgrid.memory import Allocator


@pytest.fixture(autouse=True)
def nothing_waits(device: Device) -> None:
    gc.collect()
    spare.forget(device)


def made(device: Device, layout: str = "compact") -> Grid:
    return clgrid.build(clgrid.load_scene("icosphere:3").mesh, layout, density=2.0, device=device)


def waiting(device: Device) -> list[int]:
    return [buffer.int_ptr for _, buffer in spare._waiting.get(device, [])]


def test_the_next_of_its_size_takes_a_buffer(device: Device) -> None:
    allocator = Allocator(device)
    large, small = allocator.buffer(1 << 20), allocator.buffer(1 << 16)
    addresses = large.int_ptr, small.int_ptr
    allocator.release(large, small)
    del large, small
    assert allocator.in_use == 0
    assert spare.take(device, (1 << 20) + 1) is None
    assert spare.take(device, (1 << 20) - 1) is None, "a grid takes the bytes that are said of it"
    found = [allocator.buffer(1 << 20), allocator.buffer(1 << 16)]
    assert [buffer.int_ptr for buffer in found] == list(addresses)
    assert allocator.in_use == (1 << 20) + (1 << 16)
    assert spare.take(device, 1 << 16) is None


def test_the_oldest_go_first(device: Device) -> None:
    allocator = Allocator(device)
    quarter = spare.MOST_BYTES // 4
    buffers = [allocator.buffer(quarter) for _ in range(5)]
    addresses = [buffer.int_ptr for buffer in buffers]
    allocator.release(*buffers)
    assert waiting(device) == addresses[1:]
    allocator.release(allocator.buffer(spare.MOST_BYTES + 1))
    assert waiting(device) == addresses[1:], "one that is too large never waits"


@pytest.mark.parametrize("layout", ["compact", "nested-hashed"])
def test_a_build_after_a_grid_that_is_gone_allocates_nothing(layout: str, device: Device) -> None:
    grid = made(device, layout)
    first, peak = grid.arrays(), grid.peak_nbytes
    assert grid._allocator.allocations
    del grid
    gc.collect()
    again = made(device, layout)
    assert again._allocator.allocations == 0
    assert again.peak_nbytes == peak
    for name, array in again.arrays().items():
        np.testing.assert_array_equal(array, first[name], name)


def test_no_buffer_waits_that_a_grid_holds(device: Device) -> None:
    grid = made(device)
    held = {buffer.int_ptr for buffer in grid.parts[0].lists.buffers}
    assert not held & set(waiting(device))
    other = made(device)
    assert not held & {buffer.int_ptr for buffer in other.parts[0].lists.buffers}


def test_what_is_released_by_hand_goes_back_to_the_device(device: Device) -> None:
    grid = made(device)
    held = {buffer.int_ptr for buffer in grid.parts[0].lists.buffers}
    grid.release()
    del grid
    gc.collect()
    assert not held & set(waiting(device))


def test_no_buffer_waits_twice(device: Device) -> None:
    grid = made(device)
    vertices = grid.mesh.vertices
    for scale in (2.0, 0.5):
        grid.update((vertices * scale).astype(vertices.dtype))
    del grid
    gc.collect()
    addresses = waiting(device)
    assert len(addresses) == len(set(addresses)) > 0
