"""Grids that rays without order have rebuilt: when that is, and that nothing but speed tells."""

from __future__ import annotations

import copy
import gc
import pickle
import threading
import weakref
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from same import answers, some_rays

import clgrid
from clgrid import adapted, calibrate, cost, finer, memory, procedural, target
from clgrid.adapted import Adaptation, go_alone
from clgrid.device import Device
from clgrid.finer import MOST_BYTES, Plan
from clgrid.grid import Grid, build
from clgrid.mesh import Mesh
from clgrid.rays import Rays
from clgrid.recipe import Recipe
from clgrid.scene import default_camera

BALL = procedural.icosphere(3)
FINER = Recipe("hashed", 4.0, None, "robust", None, True)
OPEN = {"layout": "auto", "skipping": "auto"}


def as_rays(origins: np.ndarray, directions: np.ndarray) -> Rays:
    origins, directions = np.broadcast_arrays(origins, directions)
    return Rays(origins, directions, np.array([[0.0, np.inf]]))


def random_rays(count: int) -> Rays:
    return as_rays(*some_rays(count=count))


CAMERA = as_rays(*default_camera(BALL).rays(200, 200))


@pytest.fixture
def paid(monkeypatch: pytest.MonkeyPatch) -> None:
    """Any ray that goes alone pays for a grid, of layout and density that none of the tests starts with."""
    monkeypatch.setattr(adapted, "FEWEST", 0)
    monkeypatch.setattr(
        adapted, "plan", lambda mesh, device, standing, nbytes: Plan(of_rung(standing), 1e-3, 1.0)
    )


def of_rung(standing: Recipe) -> Recipe:
    return replace(FINER, accuracy=standing.accuracy, max_memory=standing.max_memory)


def an_open_grid(device: Device, **options: object) -> Grid:
    return build(BALL, device=device, **{**OPEN, **options})  # type: ignore[arg-type]


# Which rays go alone.


def from_one_point(count: int) -> Rays:
    return as_rays(np.array([0.1, 0.2, 0.3]), some_rays(count=count)[1])


def to_a_light(count: int) -> Rays:
    """Shadow rays: from all over a surface to one point."""
    points = some_rays(count=count)[1]
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    return as_rays(points, np.array([3.0, 4.0, 5.0]) - points)


@pytest.mark.parametrize(
    ("rays", "expected"),
    [
        (random_rays(100_000), True),
        (random_rays(1), True),
        (random_rays(0), True),
        (CAMERA, False),
        (as_rays(CAMERA.origins.reshape(-1, 3)[::-1], CAMERA.directions.reshape(-1, 3)[::-1]), False),
        (from_one_point(200_000), False),
        (to_a_light(400_000), False),
        (to_a_light(1000), True),
        (as_rays(np.full((5000, 3), np.nan), np.zeros((5000, 3))), False),
    ],
    ids=["random", "one", "none", "camera", "reversed", "point", "light", "few to a light", "invalid"],
)
def test_which_rays_go_alone(rays: Rays, expected: bool) -> None:
    assert go_alone(rays, BALL) is expected


def test_it_does_not_depend_on_where_the_mesh_is_and_how_large() -> None:
    far = Mesh(BALL.vertices.astype(np.float64) * 1e-6 + 1e3, BALL.faces)
    for rays in (random_rays(50_000), CAMERA):
        moved = as_rays(rays.origins * 1e-6 + 1e3, rays.directions * 1e-6)
        assert go_alone(moved, far) is go_alone(rays, BALL)


# The rule.


class Told:
    """What an ``Adaptation`` is told, and when it builds."""

    def __init__(self, found: Plan | None) -> None:
        self.found, self.asked, self.built = found, 0, 0
        self.one = Adaptation(BALL, self.plan)

    def plan(self, nbytes: int) -> Plan | None:
        self.asked += 1
        return self.found

    def build(self, recipe: Recipe) -> None:
        self.built += 1

    def note(self, rays: Rays) -> int:
        self.one.note(rays, 0, self.build)
        return self.built


def test_it_is_built_as_soon_as_what_was_lost_is_what_it_takes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(adapted, "FEWEST", 0)
    told = Told(Plan(FINER, build_s=1.0, saved_s=1 / 1024))
    assert [told.note(random_rays(256)) for _ in range(6)] == [0, 0, 0, 1, 1, 1]
    assert told.asked == 1


def test_one_batch_that_is_large_enough_builds_at_once() -> None:
    assert Told(Plan(FINER, 1.0, 1e-4)).note(random_rays(20_000)) == 1


def test_rays_that_keep_together_do_not_pay() -> None:
    told = Told(Plan(FINER, 1.0, 1e-4))
    assert [told.note(CAMERA) for _ in range(5)] == [0] * 5
    assert told.asked == 0


def test_few_rays_are_not_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(adapted, "go_alone", lambda rays, mesh: pytest.fail("looked at"))
    told = Told(Plan(FINER, 0.0, 1.0))
    for _ in range(adapted.FEWEST // 1024 - 1):
        told.note(random_rays(1024))


def test_what_is_not_worth_it_is_asked_once() -> None:
    told = Told(None)
    assert [told.note(random_rays(20_000)) for _ in range(3)] == [0] * 3
    assert told.asked == 1
    assert told.one.settled


def test_all_together_takes_at_most_twice_the_best(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever the batches: lost before the build, and the build, against the less of either for all rays."""
    monkeypatch.setattr(adapted, "FEWEST", 0)
    rng = np.random.default_rng(1)
    for _ in range(40):
        sizes = rng.integers(1, 400, rng.integers(1, 12)).tolist()
        build_s = float(rng.integers(1, 2000))
        told = Told(Plan(FINER, build_s, 1.0))
        lost = sum(size for size in sizes if not told.note(random_rays(size)))
        assert lost + told.built * build_s <= 2 * min(build_s, sum(sizes))


# The plan.


def candidate(density: float, nbytes: int, batches: float, fits: bool = True) -> cost.Candidate:
    work = replace(WORK, batches=batches)
    return cost.Candidate("compact", density, True, (9, 9, 9), work, nbytes, 0.01 * density, 0.0, fits)


WORK = cost.Work(1e3, 1e3, 2e3, 5e2, steps=10.0, tests=50.0, batches=8.0, across=9.0)
STANDING = Recipe("compact", 0.5, None, "exact", 1 << 20, True, adapts=True)


def test_the_fastest_that_fits_is_planned() -> None:
    before = finer.ray_s(WORK, "compact", True, 1.0)
    found = [candidate(2.0, 10, 3.0), candidate(4.0, 20, 2.0), candidate(8.0, 40, 1.0, fits=False)]
    planned = finer.best(found, STANDING, before, 1.0)
    assert planned is not None
    assert planned.recipe == replace(STANDING, density=4.0, adapts=False)
    assert planned.build_s == pytest.approx(0.04)
    assert planned.saved_s == pytest.approx(before - finer.ray_s(found[1].work, "compact", True, 1.0))


def test_a_small_gain_is_none() -> None:
    before = finer.ray_s(WORK, "compact", True, 1.0)
    assert finer.best([candidate(1.0, 10, 7.0)], STANDING, before, 1.0) is None
    assert finer.best([candidate(1.0, 10, 1.0, fits=False)], STANDING, before, 1.0) is None


def test_a_slower_device_saves_as_many_times_more() -> None:
    found = [candidate(4.0, 20, 2.0)]
    one, two = (finer.best(found, STANDING, finer.ray_s(WORK, "compact", True, s), s) for s in (1.0, 3.0))
    assert one is not None
    assert two is not None
    assert two.saved_s == pytest.approx(3 * one.saved_s)


@pytest.mark.host
def test_a_plan_keeps_to_the_bytes(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """A quarter of a hierarchy's, and what is left of ``max_memory`` beside the grid that stands."""
    typical = {kind: calibrate.typical(kind) for kind in calibrate._TYPICAL_CAST}
    monkeypatch.setattr(calibrate, "constants", lambda device, kinds: typical)
    mesh = procedural.icosphere(6)
    planned = finer.plan(mesh, device, replace(STANDING, max_memory=None), 500_000)
    assert planned is not None
    recipe = planned.recipe
    assert recipe.density > STANDING.density
    sizes = clgrid.predict(mesh, recipe.layout, recipe.density, skipping=recipe.skipping, device=device)
    assert sum(sizes.values()) < 1.05 * MOST_BYTES * mesh.triangle_count
    assert finer.plan(mesh, device, replace(STANDING, max_memory=700_000), 500_000) is None


# Grids.


@pytest.mark.thorough
@pytest.mark.parametrize("accuracy", ["robust", "precise", "exact"])
def test_answers_are_the_same_before_and_after(accuracy: str, device: Device, paid: None) -> None:
    grid = an_open_grid(device, accuracy=accuracy)
    fixed = an_open_grid(device, accuracy=accuracy, adapt=False)
    expected, layout = answers(fixed), fixed.layout
    assert answers(grid) == expected  # built in the course of it
    assert (grid.adapted, grid.layout) == (True, "hashed")
    assert answers(grid) == expected
    assert (fixed.adapted, fixed.layout) == (False, layout)


@pytest.mark.thorough
def test_of_several_parts(device: Device, paid: None, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        for module in (memory, target):
            patch.setattr(module, "largest_buffer", lambda device: 10_000)
        grid, fixed = an_open_grid(device), an_open_grid(device, adapt=False)
    assert grid.stats.parts > 1
    assert answers(grid) == answers(fixed)
    assert grid.adapted
    assert grid.stats.parts == fixed.stats.parts


def test_every_byte_is_told(device: Device, paid: None) -> None:
    grid = an_open_grid(device)
    before, stats = grid.nbytes, grid.stats
    grid.cast(*some_rays())
    hashed = build(BALL, "hashed", 4.0, skipping=True, device=device)
    assert grid.stats.nbytes == hashed.stats.nbytes
    assert grid.nbytes == hashed.nbytes == sum(grid.stats.nbytes.values())
    assert grid.stats.references == hashed.stats.references != stats.references
    # Both stood while the second was built, and the first is given back.
    assert grid.peak_nbytes == grid.stats.peak_nbytes >= before + hashed.nbytes
    assert grid._allocator.in_use == sum(buffer.size for buffer in grid.parts[0].lists.buffers)
    assert "hashed" in repr(grid)
    assert "rays without order" in grid._repr_html_()


@pytest.mark.host
def test_memory_that_is_not_allowed_is_not_taken(device: Device, paid: None) -> None:
    small = an_open_grid(device, adapt=False).nbytes
    grid = an_open_grid(device, max_memory=small + 1000)
    held = grid._allocator.in_use, grid.nbytes, grid.parts
    hits = grid.cast(*some_rays())
    assert not grid.adapted
    assert (grid._allocator.in_use, grid.nbytes, grid.parts) == held
    assert hits.t_hit.tobytes() == answers(grid)["cast t_hit"]
    grid.update(BALL.vertices * np.float32(2))
    grid.release()


def test_an_update_builds_what_was_chosen(device: Device, paid: None) -> None:
    grid, moved = an_open_grid(device), BALL.vertices * np.float32(1.5)
    grid.cast(*some_rays())
    assert grid.adapted
    grid.update(moved)
    assert not grid.adapted
    chosen = {"density": grid.recipe.density, "skipping": grid.recipe.skipping, "device": device}
    anew = build(Mesh(moved, BALL.faces), grid.recipe.layout, **chosen)  # type: ignore[arg-type]
    assert grid.stats.nbytes == anew.stats.nbytes
    hits = grid.cast(*some_rays())  # and is rebuilt again, out of recycled buffers
    assert grid.adapted
    expected = clgrid.brute_force(grid.mesh, *some_rays(), device=device)
    assert hits.t_hit.tobytes() == expected.t_hit.tobytes()
    held = {id(buffer): buffer.size for buffer in (*grid.parts[0].lists.buffers, *grid._allocator._spare)}
    assert grid._allocator.in_use == sum(held.values())


@pytest.mark.host
@pytest.mark.parametrize(
    "options",
    [
        {"adapt": False},
        {"layout": "compact"},
        {"density": 1.0},
        {"resolution": (5, 6, 7)},
        {"skipping": False},
        {"skipping": True},
        {"accuracy": "fast"},
    ],
    ids=str,
)
def test_what_is_fixed_stays(options: dict[str, object], device: Device, paid: None) -> None:
    grid = an_open_grid(device, **options)
    parts = grid.parts
    grid.cast(*some_rays())
    assert grid.parts is parts
    assert not grid.adapted


@pytest.mark.host
def test_by_default_nothing_adapts(device: Device, paid: None) -> None:
    assert not build(BALL, device=device).recipe.adapts
    assert an_open_grid(device).recipe.adapts


@pytest.mark.host
def test_steps_are_told_of_the_grid_that_stands(device: Device, paid: None) -> None:
    grid = an_open_grid(device)
    steps = [grid.cast(*some_rays(), fields=("steps",)).steps for _ in range(2)]
    assert not grid.adapted
    np.testing.assert_array_equal(*steps)


@pytest.mark.host
def test_a_mesh_without_triangles(device: Device, paid: None, tmp_path: Path) -> None:
    nothing = Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint32))
    grid = build(nothing, device=device, **OPEN)  # type: ignore[arg-type]
    assert not grid.cast(*some_rays()).mask.any()
    assert not grid.adapted
    grid.save(tmp_path / "grid")


@pytest.mark.host
def test_copies_and_pickles_start_as_chosen_and_files_hold_what_stands(
    device: Device, paid: None, tmp_path: Path
) -> None:
    grid = an_open_grid(device)
    rays, layout = some_rays(), grid.layout
    expected = grid.cast(*rays)
    assert grid.layout != layout
    for other in (copy.copy(grid), pickle.loads(pickle.dumps(grid))):
        assert (other.layout, other.adapted, other.recipe) == (layout, False, grid.recipe)
        assert other.cast(*rays).t_hit.tobytes() == expected.t_hit.tobytes()
    grid.save(tmp_path / "grid")
    opened = clgrid.open_grid(tmp_path / "grid", device)
    assert (opened.layout, opened.skipping) == ("hashed", True)
    assert opened.stats.nbytes == grid.stats.nbytes
    assert opened.cast(*rays).t_hit.tobytes() == expected.t_hit.tobytes()
    opened.update(BALL.vertices)
    assert opened.stats.nbytes == grid.stats.nbytes


@pytest.mark.host
def test_a_released_grid_tells_of_the_last_that_stood(device: Device, paid: None) -> None:
    grid = an_open_grid(device)
    grid.cast(*some_rays())
    nbytes = grid.stats.nbytes
    grid.release()
    assert grid.stats.nbytes == nbytes
    with pytest.raises(clgrid.InputError, match="released"):
        grid.cast(*some_rays())


@pytest.mark.host
def test_a_grid_that_nobody_refers_to_goes_at_once(device: Device, paid: None) -> None:
    gc.disable()
    try:
        grid = an_open_grid(device)
        grid.cast(*some_rays())
        gone = weakref.ref(grid)
        del grid
        assert gone() is None
    finally:
        gc.enable()


# Threads.


@pytest.mark.thorough
def test_threads_ask_while_it_is_rebuilt(device: Device, paid: None) -> None:
    expected = [answers(an_open_grid(device, adapt=False), seed, draw=False) for seed in range(4)]
    grid, start = an_open_grid(device), threading.Barrier(4)

    def ask(seed: int) -> list[dict[str, bytes]]:
        start.wait()
        return [answers(grid, seed, draw=False) for _ in range(4)]

    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(ask, range(4)))
    assert grid.adapted
    assert all(each == alone for own, alone in zip(found, expected, strict=True) for each in own)


@pytest.mark.thorough
def test_kernels_under_way_read_the_grid_that_stood(
    device: Device, paid: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a kernel left to itself reads is kept until it is done."""
    import pyopencl as cl
    import pyopencl.array

    grid = an_open_grid(device)
    queue = cl.CommandQueue(device.context)
    gate = cl.UserEvent(device.context)
    rays = [cl.array.to_device(queue, array) for array in some_rays()]
    cl.enqueue_barrier(queue, wait_for=[gate])
    found = grid.cast_on_device(queue, *rays)
    old = weakref.ref(grid.parts[0])
    expected = grid.cast(*some_rays())
    assert grid.adapted
    gc.collect()
    assert old() is not None
    gate.set_status(cl.command_execution_status.COMPLETE)
    assert found.get().t_hit.tobytes() == expected.t_hit.tobytes()
    grid.under_way.wait()
    del found
    gc.collect()
    assert old() is None


@pytest.mark.host
def test_a_release_meanwhile_is_not_undone(
    device: Device, paid: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    grid = an_open_grid(device)
    builds = grid._build_part

    def released_at_its_end(*arguments: object) -> object:
        part = builds(*arguments)  # type: ignore[arg-type]
        grid.release()
        return part

    monkeypatch.setattr(grid, "_build_part", released_at_its_end)
    with pytest.raises(clgrid.InputError, match="released"):
        grid.cast(*some_rays())
    assert grid.parts == []
    assert not grid.adapted
