"""The cost model: its counts against counted grids, the choice, and its regret in counted work."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from meshes import MESHES
from scenes import scene

import clgrid
from clgrid import calibrate, cost
from clgrid.device import Device
from clgrid.errors import GridTooLargeError, InputError
from clgrid.estimate import Work, estimate, estimate_nbytes, sample
from clgrid.grid import build, predict
from clgrid.hits import COUNTERS as FIELDS
from clgrid.mesh import Mesh
from clgrid.procedural import demo, icosphere, terrain
from clgrid.program import source_folder
from clgrid.recipe import Options
from clgrid.scene import default_camera, load_scene

KIND = ("compact", False)
# Seconds of no device: what the tests of the choice weigh by.
FIXED = {
    (layout, skip): calibrate.typical((layout, skip))
    for layout in ("compact", "hashed")
    for skip in (False, True)
}
ASKED = cost.Question(
    kinds=(KIND,),
    densities=cost.LADDER,
    resolution=None,
    rays=2**20,
    max_memory=None,
    device_memory=2**40,
)

# Of a ball's grid.
ONE = Work(
    triangles=1e5, cells=1e6, references=3e5, full_cells=1e5, steps=40.0, tests=10.0, batches=5.0, across=100
)  # fmt: skip

ROOMY, TALL = (np.array(size, np.float32) for size in ((1, 1, 4), (1, 1, 40)))


def sheets(stretch: np.ndarray, name: str) -> Mesh:
    """A terrain stretched along z."""
    hills = terrain(96)
    return Mesh(hills.vertices * stretch, hills.faces, source=name)


def splinters() -> Mesh:
    """Long thin triangles all over the unit cube: many references for each."""
    i = np.arange(1 << 14)
    start = np.stack([i / len(i), i * 0.618033988749895 % 1, i * 0.754877666246693 % 1], -1)
    corners = start[:, None] + np.array([[0, 0, 0], [0.004, 0, 0], [0, 0.004, 0.2]])
    faces = np.arange(3 * len(i), dtype=np.uint32).reshape(-1, 3)
    return Mesh(corners.reshape(-1, 3).astype(np.float32), faces, source="splinters")


SCENES = {
    "scans/armadillo.obj": lambda: icosphere(6),
    "scans/bunny_zipper.ply": lambda: icosphere(5),
    "scans/dragon_vrip_res2.ply.gz": demo,
    "scans/terrain_st_helens.ply": lambda: terrain(256),
    "arch/sponza_dabrovic.glb": lambda: sheets(TALL, "tall"),
    "arch/white_room.glb.gz": lambda: sheets(ROOMY, "roomy"),
}


def mesh_of(name: str) -> Mesh:
    """The shared scene, or the procedural one that stands in for it."""
    try:
        path = scene(name)
    except pytest.skip.Exception:
        return SCENES[name]()
    return load_scene(str(path)).mesh


@pytest.mark.thorough
@pytest.mark.parametrize("density", [0.5, 4, 16])
@pytest.mark.parametrize(
    "mesh", [icosphere(5), terrain(128), sheets(TALL, "tall"), splinters()], ids=lambda m: m.source
)
def test_counts_are_estimated_before_the_build(mesh: Mesh, density: float, device: Device) -> None:
    stats = build(mesh, density=density, device=device).stats
    found = estimate(sample(mesh), stats.resolution)
    assert found.cells == stats.cells
    assert found.references == pytest.approx(stats.references, rel=0.05)
    if mesh.source not in ("tall", "splinters"):
        assert found.full_cells == pytest.approx(stats.cells * (1 - stats.empty_share), rel=0.25)
    hashed = sum(predict(mesh, "hashed", density, device=device).values())
    assert estimate_nbytes(found, "hashed", stats.resolution, False) == pytest.approx(hashed, rel=0.35)


@pytest.mark.parametrize("name", ["scans/armadillo.obj", "arch/sponza_dabrovic.glb", "cad/gears.stl"])
def test_counts_of_real_scenes_are_estimated_too(name: str, device: Device) -> None:
    mesh = load_scene(str(scene(name))).mesh
    for density in (0.5, 4, 16):
        stats = build(mesh, density=density, device=device).stats
        # Of a sample as large as this: that of `auto` is off by up to a tenth.
        found = estimate(sample(mesh, 1 << 13), stats.resolution)
        assert found.references == pytest.approx(stats.references, rel=0.05)
        assert found.full_cells == pytest.approx(stats.cells * (1 - stats.empty_share), rel=0.4)
        rough = estimate(sample(mesh), stats.resolution)
        assert rough.references == pytest.approx(stats.references, rel=0.1)


@pytest.mark.parametrize("name", sorted(MESHES))
def test_small_and_degenerate_meshes_have_estimates(name: str) -> None:
    mesh = MESHES[name]
    for density in cost.LADDER:
        found = cost.candidates(sample(mesh), replace(ASKED, densities=(density,)), FIXED)[0]
        work = found.work
        assert 1 <= work.full_cells <= min(work.cells, work.references)
        assert all(
            np.isfinite(value) and value >= 0
            for value in (work.steps, work.tests, work.batches, found.total_s)
        )


@pytest.mark.thorough
@pytest.mark.parametrize("layout", ["compact", "hashed", "linked-list", "dynamic-array"])
@pytest.mark.parametrize("skipping", [False, True])
def test_bytes_are_estimated(layout: str, skipping: bool, device: Device) -> None:
    mesh = icosphere(5)
    for density in (0.5, 4, 16):
        exact = sum(predict(mesh, layout, density, skipping=skipping, device=device).values())
        grid = build(mesh, layout, density, skipping=skipping, device=device)
        work = estimate(sample(mesh), grid.stats.resolution)
        found = estimate_nbytes(work, layout, grid.stats.resolution, skipping)
        assert grid.nbytes == exact
        assert found == pytest.approx(exact, rel=0.2 if layout == "dynamic-array" else 0.05)


def test_a_sample_reads_few_triangles_and_is_always_the_same() -> None:
    mesh = terrain(256)
    whole, some, again = sample(mesh, 2**18), sample(mesh, 2000), sample(mesh, 2000)
    assert len(whole.low[0]) == mesh.triangle_count
    assert len(some.low[0]) == 2000
    np.testing.assert_array_equal(some.low, again.low)
    assert some.lines.open == pytest.approx(whole.lines.open, rel=0.1)
    for resolution in ((20, 20, 5), (200, 200, 30)):
        counted = [estimate(seen, resolution).references for seen in (whole, some)]
        assert counted[1] == pytest.approx(counted[0], rel=0.03)


def test_few_rays_get_a_coarse_grid_and_many_a_finer_one() -> None:
    seen = sample(icosphere(6))
    densities = [
        cost.ranked(cost.candidates(seen, replace(ASKED, rays=rays), FIXED))[0].density
        for rays in (0, 2**12, 2**16, 2**20, 2**30)
    ]
    assert densities == sorted(densities)
    assert densities[0] == cost.LADDER[0] < densities[-1]


def test_a_cheaper_layout_is_taken() -> None:
    seen, both = sample(icosphere(5)), replace(ASKED, kinds=(("compact", False), ("hashed", False)))
    dear = replace(FIXED["hashed", False], cast=(1.0, 1.0, 1.0))
    slow = cost.candidates(seen, both, {**FIXED, ("hashed", False): dear})
    assert cost.ranked(slow)[0].layout == "compact"
    dear = replace(FIXED["compact", False], build=(1.0, 1.0, 1.0, 1.0))
    slow = cost.candidates(seen, both, {**FIXED, ("compact", False): dear})
    assert cost.ranked(slow)[0].layout == "hashed"


def test_of_grids_as_fast_the_smallest_is_taken() -> None:
    both = replace(ASKED, kinds=(("compact", False), ("hashed", False)))
    alike = dict.fromkeys(both.kinds, FIXED["compact", False])
    best = cost.ranked(cost.candidates(sample(icosphere(6)), both, alike))[0]
    assert best.layout == "hashed"


def test_skipping_is_taken_where_steps_are_dear() -> None:
    seen = sample(icosphere(6))
    both = replace(ASKED, kinds=(("compact", False), ("compact", True)), densities=(16.0,), rays=2**24)
    dear = {kind: replace(FIXED[kind], cast=(1e-7, 1e-6, 1e-9)) for kind in both.kinds}
    assert cost.ranked(cost.candidates(seen, both, dear))[0].skipping


def test_what_would_not_fit_is_dropped() -> None:
    seen = sample(icosphere(6))
    found = cost.candidates(seen, ASKED, FIXED)
    best = cost.ranked(found)[0]
    tight = cost.candidates(seen, replace(ASKED, max_memory=best.nbytes - 1), FIXED)
    assert all(one.nbytes < best.nbytes for one in cost.ranked(tight))
    assert {one.nbytes for one in cost.ranked(tight)} == {
        one.nbytes for one in found if one.nbytes < best.nbytes
    }
    nothing = cost.candidates(seen, replace(ASKED, max_memory=1), FIXED)
    assert cost.ranked(nothing) == [min(nothing, key=lambda one: one.nbytes)]
    device = cost.candidates(seen, replace(ASKED, device_memory=1), FIXED)
    assert not any(one.fits for one in device)


def test_after_a_refusal_smaller_grids_are_tried_and_the_smallest_has_the_last_word() -> None:
    found = cost.candidates(sample(icosphere(6)), ASKED, FIXED)
    tried: list[int] = []

    def refuse(most: int) -> object:
        def attempt(one: cost.Candidate) -> cost.Candidate:
            tried.append(one.nbytes)
            if one.nbytes > most:
                raise GridTooLargeError(f"{one.nbytes}")
            return one

        return attempt

    smallest = min(one.nbytes for one in found)
    best, made = cost.first_that_fits(found, refuse(smallest))
    assert best is made
    assert tried == sorted(tried, reverse=True)
    assert tried[-1] == smallest
    with pytest.raises(GridTooLargeError, match=str(smallest)):
        cost.first_that_fits(found, refuse(0))


def test_cells_that_cannot_be_numbered_are_no_candidates() -> None:
    seen = replace(sample(icosphere(5)), triangles=3 * 2**30)
    found = cost.candidates(seen, ASKED, FIXED)
    assert {one.density for one in found} == {0.25, 0.5, 1.0}
    with pytest.raises(GridTooLargeError, match="cells"):
        cost.candidates(seen, replace(ASKED, densities=(8.0, 16.0)), FIXED)
    with pytest.raises(InputError, match="density is -1"):
        cost.candidates(seen, replace(ASKED, densities=(-1.0,)), FIXED)


def test_build_keeps_its_choice_and_what_it_was_among(device: Device) -> None:
    mesh = icosphere(5)
    grid = build(mesh, "auto", device=device, skipping="auto", rays=10**7)
    choice = grid.choice
    assert choice is not None
    assert (grid.layout, grid.skipping) == (choice.chosen.layout, choice.chosen.skipping)
    assert grid.stats.resolution == choice.chosen.resolution
    assert grid.recipe.density == choice.chosen.density
    assert choice.rays == 10**7
    assert len(choice.candidates) == 4 * len(cost.LADDER)
    assert set(choice.constants) == set(FIXED)
    grid.update(mesh.vertices * np.float32(1.5))
    assert grid.recipe.density == choice.chosen.density


def test_nothing_is_weighed_where_nothing_is_left_to_choose(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    def forbidden(*_: object) -> None:
        raise AssertionError("no constants are needed")

    monkeypatch.setattr(calibrate, "constants", forbidden)
    ball = icosphere(2)
    assert build(ball, density=4, device=device).choice is None
    assert build(ball, resolution=(3, 4, 5), device=device).choice is None
    empty = Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint32))
    assert build(empty, "auto", skipping="auto", device=device).choice is None
    with pytest.raises(AssertionError, match="no constants"):
        build(ball, device=device)


def test_the_layout_is_chosen_also_for_a_given_resolution(device: Device) -> None:
    grid = build(icosphere(3), "auto", resolution=(6, 7, 8), device=device)
    assert grid.stats.resolution == (6, 7, 8)
    assert grid.choice is not None
    assert {one.resolution for one in grid.choice.candidates} == {(6, 7, 8)}


def test_memory_is_a_bound_of_the_choice(device: Device) -> None:
    mesh = icosphere(5)
    least = min(
        sum(predict(mesh, layout, cost.LADDER[0], device=device).values()) for layout in ("compact", "hashed")
    )
    dense = {"layout": "auto", "rays": 10**9, "device": device}
    free = build(mesh, **dense)
    assert free.nbytes > least
    for limit in (free.nbytes - 1, least + 1000, least):
        bound = build(mesh, max_memory=limit, **dense)
        assert bound.nbytes <= limit
        assert sum(predict(mesh, max_memory=limit, **dense).values()) == bound.nbytes
    with pytest.raises(GridTooLargeError, match=r"needs [\d,]+ bytes, more than .*max_memory"):
        build(mesh, max_memory=least - 1, **dense)
    with pytest.raises(GridTooLargeError, match=f"needs {least:,} bytes"):
        predict(mesh, max_memory=least - 1, **dense)


@pytest.mark.host
def test_a_refusal_says_what_is_left_to_do(device: Device) -> None:
    """Who left the density open cannot lower it: a lower one is to be named, and is then taken."""
    mesh = icosphere(4)
    limit = sum(predict(mesh, density=cost.LADDER[0], device=device).values()) - 1
    tight = {"device": device, "max_memory": limit}
    ways = (
        "; name a density below 0.25, the least that 'auto' tries, or layout='hashed', or raise max_memory$"
    )
    with pytest.raises(GridTooLargeError, match=rf"needs [\d,]+ bytes, .*{ways}") as refused:
        build(mesh, **tight)
    assert "lower the density" not in str(refused.value)
    assert build(mesh, density=0.01, **tight).nbytes <= limit
    with pytest.raises(GridTooLargeError, match=r"; lower the density or the resolution$"):
        build(mesh, density=4, **tight)
    with pytest.raises(GridTooLargeError, match=r"; lower the density or the resolution$"):
        build(mesh, density=4, skipping="auto", **tight)


def test_no_choice_changes_an_answer(device: Device) -> None:
    mesh = icosphere(4)
    origins, directions = default_camera(mesh, 1.0).rays(64, 64)
    truth = clgrid.brute_force(mesh, origins, directions, device=device)
    for rays in (1, 10**9):
        for skipping in (False, "auto"):
            hits = build(mesh, "auto", device=device, skipping=skipping, rays=rays).cast(origins, directions)
            np.testing.assert_array_equal(hits.t_hit, truth.t_hit)
            np.testing.assert_array_equal(hits.primitive_ids, truth.primitive_ids)
            np.testing.assert_array_equal(hits.primitive_uvs, truth.primitive_uvs)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({"layout": "octree"}, "layout is 'octree'"),
        ({"skipping": "maybe"}, "skipping is 'maybe'"),
        ({"density": "high"}, "density is 'high'"),
        ({"rays": -1}, "rays is -1"),
        ({"layout": "auto", "density": -2.0}, "density is -2"),
    ],
)
def test_unknown_options_are_named(words: dict[str, object], message: str, device: Device) -> None:
    with pytest.raises(InputError, match=message):
        build(icosphere(2), device=device, **words)


def test_tests_are_the_lengths_of_the_lists_that_a_ray_meets(device: Device) -> None:
    mesh = icosphere(3)
    origins, directions = default_camera(mesh, 1.0).rays(32, 32)
    for layout in ("compact", "hashed", "linked-list", "dynamic-array"):
        one = build(mesh, layout, resolution=(1, 1, 1), device=device)
        hits = one.cast(origins, directions, fields=("tests",))
        entered = hits.steps == 1
        assert entered.any()
        assert not entered.all()
        np.testing.assert_array_equal(hits.tests, np.where(entered, mesh.triangle_count, 0))
        np.testing.assert_array_equal(hits.batches, np.where(entered, mesh.triangle_count / 8, 0))
        fine = build(mesh, layout, density=8, device=device).cast(origins, directions, fields=("tests",))
        assert 0 < fine.tests.sum() < hits.tests.sum() / 20
        assert (fine.batches <= np.minimum(fine.steps, fine.tests)).all()
        assert (8 * fine.batches >= fine.tests).all()


def test_tiles_pass_more_than_a_ray_does_just_where_they_are_wide() -> None:
    few, many = (calibrate.typical(KIND).cast_s(ONE, rays) for rays in (2**16, 2**40))
    assert cost.passed_by_tiles(2.0**40, 10, 20, 1e-6)[1:] == pytest.approx(
        (2**34 * 10, 2**34 * 20), rel=1e-5
    )
    assert cost.passed_by_tiles(64, 10, 20, 1.0) == (64, 20, 80)
    assert cost.passed_by_tiles(64, 10, 20, 1e3) == cost.passed_by_tiles(64, 10, 20, 1e6)
    # A ray of few is dearer, as its tile is wider; none is for free.
    assert 0 < many / 2**40 < few / 2**16
    assert calibrate.typical(KIND).cast_s(ONE, 0) == 0


def test_a_block_passes_its_cells_once() -> None:
    rays, cells, references = cost.passed_by_blocks(256, 10, 20, 1.0)
    assert (rays, cells) == (256, 10 * 3)  # a block of 16 x 16 that is two cells wide
    assert 20 * 3**2 < references < 4 * 20 * 3**2
    # Too wide a block goes by tiles.
    assert cost.passed_by_blocks(256, 10, 20, 8.0) == cost.passed_by_tiles(256, 10, 20, 8.0)


def test_tiles_of_a_few_cells_are_cast_together() -> None:
    """As the kernel decides it (``keeps_together`` in cl/way.h)."""
    widest = re.search(r"#define WIDEST_SLICE (\d+)", (source_folder() / "way.h").read_text())
    assert widest is not None
    rays, _, most = cost.passed_by_tiles(64, 1, 1, 1e9)
    assert rays == 64
    assert most == pytest.approx(int(widest[1]), rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(SCENES))
def test_regret_in_counted_work(name: str, device: Device) -> None:
    """By fixed constants and counted work, the choice costs at most a quarter more than the best."""
    mesh = mesh_of(name)
    rays = default_camera(mesh, 1.0).rays(128, 128)
    counted = {}
    for layout, skipping in FIXED:
        for density in cost.LADDER:
            grid = build(mesh, layout, density, skipping=skipping, device=device)
            hits = grid.cast(*rays, fields=FIELDS)
            stats = grid.stats
            full = stats.cells * (1 - stats.empty_share)
            means = [float(hits[field].mean()) for field in FIELDS]
            counted[layout, skipping, density] = Work(
                stats.triangles, stats.cells, stats.references, full,
                *means, max(stats.resolution),
            )  # fmt: skip
    for count in (2**12, 2**16, 2**18, 2**20, 2**22, 2**24):
        for kinds in (tuple(FIXED), (KIND,), (KIND, ("hashed", False))):
            asked = replace(ASKED, kinds=kinds, rays=count)
            best = cost.ranked(cost.candidates(sample(mesh), asked, FIXED))[0]
            seconds = {
                (layout, skipping, density): FIXED[layout, skipping].build_s(work)
                + FIXED[layout, skipping].cast_s(work, count)
                for (layout, skipping, density), work in counted.items()
                if (layout, skipping) in kinds
            }
            regret = seconds[best.layout, best.skipping, best.density] / min(seconds.values())
            assert regret <= 1.25, f"{count} rays among {kinds}: {regret:.2f}"


def test_options_list_the_candidates(device: Device) -> None:
    found = Options("auto", 4.0, None, "robust", None, False, 1).candidates(icosphere(3), device)
    assert [(one.layout, one.density) for one in found] == [("compact", 4.0), ("hashed", 4.0)]
