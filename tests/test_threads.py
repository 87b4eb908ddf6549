"""Threads: four at once get the bits that one gets, of one grid, of several, while others are built."""

from __future__ import annotations

import gc
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from same import answers

import clgrid
from clgrid import memory, procedural, target
from clgrid.device import Device
from clgrid.grid import Grid, build
from clgrid.layouts import ALL_LAYOUTS

THREADS, ROUNDS = 4, 5
Answers = dict[str, bytes]


def at_once(run: Callable[[int], object]) -> list[object]:
    """What each thread returns; they start together."""
    barrier = threading.Barrier(THREADS)

    def start(number: int) -> object:
        barrier.wait()
        return run(number)

    with ThreadPoolExecutor(THREADS) as pool:
        return list(pool.map(start, range(THREADS)))


def assert_all(found: list[Answers], expected: Answers) -> None:
    for each in found:
        assert [name for name in expected if each[name] != expected[name]] == []


@pytest.mark.thorough
@pytest.mark.parametrize("layout", ALL_LAYOUTS)
def test_four_threads_ask_one_grid(layout: str, device: Device) -> None:
    grid = build(procedural.icosphere(4), layout, device=device)
    expected = [answers(grid, seed) for seed in range(THREADS)]
    found = at_once(lambda number: [answers(grid, number) for _ in range(ROUNDS)])
    for own, alone in zip(found, expected, strict=True):
        assert_all(own, alone)  # type: ignore[arg-type]


@pytest.mark.parametrize("accuracy", ["precise", "exact", "fast"])
def test_of_every_accuracy(accuracy: str, device: Device) -> None:
    grid = build(procedural.icosphere(3), accuracy=accuracy, device=device)
    expected = answers(grid)
    assert_all(at_once(lambda number: answers(grid)), expected)  # type: ignore[arg-type]


@pytest.mark.thorough
def test_a_grid_of_several_parts(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """Kernels of all parts write to the same hits, one after another."""
    with monkeypatch.context() as patch:
        for module in (memory, target):
            patch.setattr(module, "largest_buffer", lambda device: 20_000)
        grid = build(procedural.icosphere(4), density=4, device=device)
    assert grid.stats.parts > 1
    expected = answers(grid)
    assert_all(at_once(lambda number: answers(grid)), expected)  # type: ignore[arg-type]


def test_threads_with_grids_of_their_own(device: Device, tmp_path: Path) -> None:
    """Each builds, asks, updates, saves, opens and releases; kernels are compiled on the way."""
    meshes = [
        procedural.icosphere(3),
        procedural.make("icosphere:4"),
        procedural.cube(),
        procedural.icosphere(2),
    ]
    layouts = ("compact", "hashed", "compact", "hashed")

    def live(number: int) -> list[Answers]:
        mesh, found = meshes[number], []
        path = tmp_path / str(number)
        for _ in range(ROUNDS):
            with build(mesh, layouts[number], 3, device=device) as grid:
                found.append(answers(grid))
                grid.update(mesh.vertices * np.float32(0.5))
                found.append(answers(grid))
                grid.save(path)
            with clgrid.open_grid(path, device) as opened:
                found.append(answers(opened))
        return found

    together = at_once(live)
    for number in range(THREADS):
        assert live(number) == together[number]


def test_first_use_by_four_threads(device: Device) -> None:
    """What is computed at first use, by whoever comes first."""
    for _ in range(ROUNDS):
        grid = build(procedural.icosphere(3), density=2, device=device)
        found = at_once(lambda number, grid=grid: (grid.open_edges, grid.stats, grid.mesh.bounds.tobytes()))
        assert all(each == found[0] for each in found)


def rays_to_middle() -> tuple[np.ndarray, np.ndarray]:
    origins = np.random.default_rng(3).normal(size=(20_000, 3))
    return origins, -origins


def cast_forever(grid: Grid, expected: np.ndarray, started: threading.Event) -> None:
    while True:
        np.testing.assert_array_equal(grid.cast(*rays_to_middle()).t_hit, expected)
        started.set()


def test_released_while_others_cast(device: Device) -> None:
    """Casts under way end with the right hits; later ones are told."""
    mesh = procedural.icosphere(4)
    for _ in range(ROUNDS):
        grid, started = build(mesh, device=device), threading.Event()
        expected = grid.cast(*rays_to_middle()).t_hit

        def live(
            number: int,
            grid: Grid = grid,
            expected: np.ndarray = expected,
            started: threading.Event = started,
        ) -> None:
            if number == 0:
                started.wait()
                grid.release()
                gc.collect()
                return
            with pytest.raises(clgrid.InputError, match="was released"):
                cast_forever(grid, expected, started)

        at_once(live)
