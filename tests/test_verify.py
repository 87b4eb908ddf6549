"""clgrid verify: what it casts, what it finds, and what it says of it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from meshes import MESHES, moved, scaled, soup
from scenes import scene as shared_scene

import clgrid
from clgrid import procedural, verify
from clgrid.brute import brute_force
from clgrid.cli import main
from clgrid.device import Device
from clgrid.errors import InputError
from clgrid.grid import Grid
from clgrid.hits import Hits
from clgrid.mesh import Mesh
from clgrid.record import decode, encode
from clgrid.scene import Scene
from clgrid.structured import INSIDE, KINDS, Aim, inside_points, structured
from clgrid.verify import Plan, broken_promises
from clgrid.verify_record import VerifyRecord

BALL = procedural.icosphere(2)
CHECKS = ("escapes", "odd_lines", "even_inside", "bits", "counts", "wrong_hits", "wrong_ids", "wrong_counts")


def plan(accuracy: str, rays: int = 2400, **options: Any) -> Plan:
    return Plan((accuracy,), rays, **{"exact": 60, "density": 4.0, **options})


def run(mesh: Mesh, device: Device, asked: Plan) -> VerifyRecord:
    return verify.verify(Scene("ball", mesh), asked, device)


@pytest.mark.parametrize("name", ["ball", "needle_fan", "far_float64", "times_1e-30", "stacks"])
def test_rays_are_of_all_kinds_and_the_same_for_a_seed(name: str) -> None:
    aim = Aim.at(MESHES[name], (5, 4, 6))
    inside = aim.low + 0.5 * (aim.high - aim.low)
    batch, again, other = (structured(aim, 1300, inside[None], (seed,)) for seed in (3, 3, 4))
    assert len(batch) == 1300
    np.testing.assert_array_equal(batch.origins, again.origins)
    np.testing.assert_array_equal(batch.directions, again.directions)
    assert (batch.origins != other.origins).any()
    assert np.isfinite(batch.origins).all()
    assert np.isfinite(batch.directions).all()
    assert (batch.directions != 0).any(axis=1).all()
    counts = np.bincount(batch.kinds, minlength=len(KINDS))
    assert counts.min() >= 75
    assert counts[KINDS.index(INSIDE)] == 325
    assert (batch.origins[batch.inside] == inside).all()
    assert not structured(aim, 100, np.zeros((0, 3)), (3,)).inside.any()


def test_most_rays_aimed_at_vertices_go_exactly_there() -> None:
    aim = Aim.at(BALL, (5, 4, 6))
    batch = structured(aim, 4000, np.zeros((0, 3)), (1,))
    rows = batch.kinds == KINDS.index("at vertices")
    known = {tuple(vertex) for vertex in BALL.vertices.astype(np.float64).tolist()}
    ends = (batch.origins + batch.directions)[rows].tolist()
    assert np.mean([tuple(end) in known for end in ends]) > 0.9


@pytest.mark.parametrize("shape", ["ball", "far", "tiny", "shell"])
def test_points_inside_are_inside_and_off_the_surface(shape: str) -> None:
    radius = np.float64(1e-20 if shape == "tiny" else 1.0)
    shift = 2.0**30 if shape == "far" else 0.0
    aim = Aim.at(Mesh(BALL.vertices.astype(np.float64) * radius + shift, BALL.faces), (4, 4, 4))
    thick = 0.001 if shape == "shell" else 1.0

    def contains(points: Any) -> Any:
        distance = np.linalg.norm((points - shift) / radius, axis=1)
        return (distance < 0.9) & (distance > 0.9 - thick)

    def distances(origins: Any, directions: Any) -> Any:
        near = np.linalg.norm(directions, axis=1) / (aim.size * np.sqrt(3))
        return np.where((origins - shift)[:, 0] > 0, 2.0**-16, near)

    points = inside_points(aim, contains, distances, (0,), 100)
    assert 0 < len(points) <= 100
    assert contains(points).all()
    # Where the surface is near on one side, there are none.
    assert ((points - shift)[:, 0] <= 0).all()
    assert len(inside_points(aim, lambda p: np.zeros(len(p), bool), distances, (0,))) == 0


@pytest.mark.parametrize(
    "accuracy",
    ["robust", *(pytest.param(rung, marks=pytest.mark.slow) for rung in ("precise", "exact"))],
)
def test_a_rung_keeps_its_promises_on_a_ball(accuracy: str, device: Device) -> None:
    result = run(BALL, device, plan(accuracy))
    [row] = result.rows
    assert broken_promises(result) == []
    assert row.broken == ()
    assert (row.accuracy, row.rays, row.inside, row.checked, row.exact_checked) == (
        accuracy, 2400, 600, 2400, 60,
    )  # fmt: skip
    assert (row.escapes, row.bits, row.counts, row.late) == (0, 0, 0, 0)
    assert 600 < row.hits < 2400
    assert 0 < row.exact_hits <= 60
    assert row.worst_share is not None
    assert 0 < row.worst_share < 1
    assert row.median_share is not None
    assert row.median_share <= row.worst_share
    assert row.worst_ulps is not None
    assert 0 < row.worst_ulps < 1000
    if accuracy == "exact":
        assert all(getattr(row, check) == 0 for check in CHECKS)
    else:
        # Not promised, and so not kept: rays through edges count twice.
        assert row.odd_lines
        assert {first.check for first in row.first} >= {"odd_lines", "even_inside"}
    assert sum(result.kinds.values()) == 2400
    assert (result.open_edges, result.triangles, result.seeds) == (0, 320, {"rays": 0})
    assert decode(encode(result), VerifyRecord) == result


@pytest.mark.parametrize(
    "accuracy",
    ["robust", *(pytest.param(rung, marks=pytest.mark.slow) for rung in ("precise", "exact"))],
)
def test_directions_with_a_subnormal_component_change_no_answer(accuracy: str, device: Device) -> None:
    """Found by ``clgrid verify``: 1 / 1e-310 is no double, and the walk lost its way."""
    ball = procedural.icosphere(3)
    origin = np.array([-0.5683148801326752, -0.3863614797592163, -0.16610819101333618])
    tiny = np.array([1e-310, -1e-310, 5e-309, -5e-309, 1e-308, -1e-308, 3e-308, -3e-308, 5e-324, -5e-324])
    ways = np.stack([np.full(10, -1.0), tiny, np.ones(10)], axis=1)
    ways = np.concatenate([np.roll(ways, turn, axis=1) for turn in range(3)])
    hits = clgrid.build(ball, accuracy=accuracy, resolution=(7, 7, 7), device=device).cast(origin, ways)
    expected = brute_force(ball, origin, ways, accuracy=accuracy, device=device)
    assert expected.mask.all()
    np.testing.assert_array_equal(hits.primitive_ids, expected.primitive_ids)
    np.testing.assert_array_equal(hits.t_hit, expected.t_hit)


def test_the_same_seed_finds_the_same(device: Device) -> None:
    first, second = (run(BALL, device, plan("robust", 600, exact=10, seed=5)) for _ in range(2))
    assert first.rows == second.rows
    assert first.kinds == second.kinds


Spoil = Callable[[Hits], None]


def _miss(hits: Hits) -> None:
    hits.primitive_ids[:] = -1
    hits.t_hit[:] = np.inf


def _late(hits: Hits) -> None:
    hits.t_hit[hits.mask] *= 1.001


def _unbounded(hits: Hits) -> None:
    hits.t_err[hits.mask] = np.inf


def _one_bit(hits: Hits) -> None:
    hits.primitive_uvs[hits.mask, 0] = np.nextafter(hits.primitive_uvs[hits.mask, 0], 2)


@pytest.mark.parametrize(
    ("spoil", "broken"),
    [
        (_miss, {"escapes", "bits"}),
        (_late, {"bits", "late"}),
        (_unbounded, {"bits", "late"}),
        (_one_bit, {"bits"}),
    ],
)
def test_what_is_broken_is_found_and_said(
    spoil: Spoil, broken: set[str], device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    cast = Grid.cast

    def spoilt(grid: Grid, *rays: Any, **options: Any) -> Hits:
        hits = cast(grid, *rays, **options)
        if options.get("fields") == ("primitive_uvs", "t_err"):
            spoil(hits)
        return hits

    monkeypatch.setattr(Grid, "cast", spoilt)
    result = run(BALL, device, plan("robust", 600, exact=30))
    assert set(result.rows[0].broken) == broken
    lines = broken_promises(result)
    assert len(lines) == len(broken)
    for check in broken:
        [line] = (line for line in lines if f"fail {check!r}" in line)
        assert line.startswith("ball: robust: ")
        assert "seed 0" in line
        assert "\n" not in line


def test_the_first_failing_ray_can_be_cast_again(device: Device) -> None:
    result = run(BALL, device, plan("robust", 600, exact=60))
    [first] = (first for first in result.rows[0].first if first.check == "odd_lines")
    grid = clgrid.build(BALL, density=4.0, device=device)
    assert str(grid.count(first.origin, first.direction, t_min=-np.inf)) == first.found
    assert int(first.found) % 2 == 1


@pytest.mark.slow
def test_wrong_parity_breaks_the_promise_of_exact_alone(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    count = Grid.count
    monkeypatch.setattr(Grid, "count", lambda *args, **kw: count(*args, **kw) + np.uint32(1))
    for accuracy, broken in (
        ("robust", {"counts"}),
        ("exact", {"counts", "odd_lines", "even_inside", "wrong_counts"}),
    ):
        row = run(BALL, device, plan(accuracy, 600, exact=30)).rows[0]
        assert set(row.broken) >= broken
        assert set(row.broken) - broken <= {"escapes", "bits", "wrong_hits"}
        assert row.odd_lines


def test_of_an_open_mesh_no_parity_is_asked(device: Device) -> None:
    result = run(procedural.terrain(6), device, plan("robust", 600, exact=10))
    [row] = result.rows
    assert result.open_edges == 24
    assert (row.inside, row.escapes, row.odd_lines, row.even_inside) == (0, None, None, None)
    assert result.kinds[INSIDE] == 0


def test_samples_are_bounded(device: Device) -> None:
    row = run(BALL, device, plan("robust", 600, check=100, exact=0)).rows[0]
    assert (row.checked, row.exact_checked, row.worst_share, row.worst_ulps) == (100, 0, None, None)
    assert Plan(rays=10**6).sample(4_000_000) == (500, 2000)
    assert Plan(rays=100).sample(10) == (100, 100)


@pytest.mark.parametrize(
    "wrong",
    [
        {"accuracies": ()},
        {"accuracies": ("blurry",)},
        {"rays": 0},
        {"check": -1},
        {"exact": -1},
        {"seed": -1},
    ],
)
def test_plans_that_make_no_sense_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="verify: "):
        Plan(**wrong)


def test_nothing_to_verify_is_an_error(device: Device) -> None:
    with pytest.raises(InputError, match="no triangles"):
        run(Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint32)), device, plan("robust"))


@pytest.mark.slow
@pytest.mark.parametrize(
    "mesh",
    [
        moved(BALL, 1e9, np.float64),
        scaled(BALL, 1e-20),
        scaled(BALL, 1e20),
        MESHES["needle_fan"],
        MESHES["lattice_box"],
        MESHES["stacks"],
        soup(np.eye(3)[None]),
    ],
    ids=["far", "tiny", "huge", "needles", "lattice", "stacks", "one"],
)
def test_robust_keeps_its_promises_on_meshes_that_strain(mesh: Mesh, device: Device) -> None:
    for options in ({}, {"layout": "hashed", "skipping": True}):
        assert broken_promises(run(mesh, device, plan("robust", 4000, exact=200, **options))) == []


@pytest.mark.slow
def test_exact_keeps_its_promises_on_a_scan(device: Device) -> None:
    loaded = clgrid.load_scene(str(shared_scene("scans/horse.ply")))
    assert broken_promises(verify.verify(loaded, plan("exact", 20_000, check=500, exact=500), device)) == []


def command(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as exit_:
        main(words)
    streams = capsys.readouterr()
    assert isinstance(exit_.value.code, int)
    return exit_.value.code, streams.out, streams.err


def test_the_command_line(capsys: pytest.CaptureFixture[str], device: Device) -> None:
    words = (
        "verify", "icosphere:2", "--accuracy", "robust", "--rays", "600", "--exact", "20", "--density", "4",
        "--device", device.label,
    )  # fmt: skip
    code, out, err = command(capsys, *words)
    assert (code, err) == (0, "")
    for text in ("robust", "escapes from inside", "0 of 150", "kept"):
        assert text in out
    code, out, err = command(capsys, *words, "--json")
    assert (code, err) == (0, "")
    result = decode(out, VerifyRecord)
    assert json.loads(out)["schema"] == "clgrid.verify/1"
    assert [row.accuracy for row in result.rows] == ["robust"]
    assert result.rows[0].rays == 600
    assert command(capsys, *words, "--quiet") == (0, "", "")
    code, out, err = command(capsys, "verify", "terrain:4", *words[2:])
    assert code == 0
    assert "16 edges have an odd number of triangles" in out


def test_a_broken_promise_is_exit_code_2(
    capsys: pytest.CaptureFixture[str], device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    count = Grid.count
    monkeypatch.setattr(Grid, "count", lambda *args, **kw: count(*args, **kw) + np.uint32(2))
    words = ("verify", "cube", "--accuracy", "robust", "--rays", "300", "--exact", "0", "--density", "4")
    code, out, err = command(capsys, *words, "--device", device.label)
    assert code == 2
    assert "broken" in out
    [line] = err.splitlines()
    assert line.startswith("clgrid: error: cube: robust: 300 rays fail 'counts'; the first, ")
    origin = json.loads(line.split("origin ")[1].split(", direction")[0])
    assert len(origin) == 3


@pytest.mark.parametrize("words", [("--accuracy", "blurry"), ("--rays", "0"), ("--density", "much")])
def test_mistakes_are_one_line(
    words: tuple[str, ...], capsys: pytest.CaptureFixture[str], device: Device, tmp_path: Path
) -> None:
    code, out, err = command(capsys, "verify", "cube", *words, "--device", device.label)
    assert (code, out) == (1, "")
    assert len(err.splitlines()) == 1


def test_fast_is_reported_and_promises_nothing(device: Device) -> None:
    (row,) = run(procedural.icosphere(2), device, plan("fast")).rows
    assert row.broken == ()
    assert row.late is None
    assert row.worst_share is None
    assert row.exact_hits > 0
    assert row.worst_ulps is not None
