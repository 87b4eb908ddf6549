"""clgrid tradeoff, run for real on a small scene: what it records, and that clgrid verify counts the same."""

from __future__ import annotations

import json
import shlex
from dataclasses import replace
from typing import Any

import pytest

from clgrid import procedural
from clgrid.cli import main
from clgrid.device import Device
from clgrid.errors import InputError
from clgrid.mesh import Mesh
from clgrid.record import decode, encode
from clgrid.scene import Scene
from clgrid.tradeoff import Plan, Wish, contest, reference, tradeoff
from clgrid.tradeoff.survey import Easel
from clgrid.tradeoff_record import RayErrors, TradeoffRecord
from clgrid.verify import Plan as VerifyPlan
from clgrid.verify import verify
from clgrid.verify_record import VerifyRecord

pytestmark = pytest.mark.thorough

NAME = "terrain:24"
HILLS = Scene("hills", procedural.terrain(24))
ASKED = Plan(
    ("fast", "robust", "exact"), ("compact",), (1.0, 4.0),
    width=48, height=48, rays=600, exact=600, seed=3, budget_s=60.0,
)  # fmt: skip


@pytest.fixture(autouse=True)
def _few_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(contest, "FEWEST_LAST_TURNS", 4)
    monkeypatch.setattr(contest, "LEAST_TURNS", 3)
    monkeypatch.setattr(contest, "MOST_TURNS", 5)


@pytest.fixture(scope="module")
def found(device: Device) -> TradeoffRecord:
    return tradeoff(HILLS, ASKED, device, source=NAME)


def structured(errors: list[RayErrors], against: str) -> RayErrors:
    [one] = (each for each in errors if (each.kind, each.reference) == ("structured", against))
    return one


def test_all_points_are_measured_and_recorded(found: TradeoffRecord) -> None:
    assert [(row.accuracy, row.density) for row in found.rows] == [
        (accuracy, density) for accuracy in ASKED.accuracies for density in ASKED.densities
    ]
    for row in found.rows:
        turns = len(row.turns)
        assert turns >= 1
        assert [len(row.build_s), len(row.render_s), len(row.time_to_image_s)] == [turns] * 3
        assert 0 < row.cost_s.low <= row.cost_s.median <= row.cost_s.high
        assert row.picture.pixels == 48 * 48
        assert {(each.kind, each.reference, each.rays) for each in row.errors} == {
            (kind, against, 600)
            for kind in ("camera", "structured")
            for against in ("exact rung", "rational")
        }
        assert row.verify.startswith(f"clgrid verify {NAME} --accuracy {row.accuracy} --layout compact")
    assert max(turn for row in found.rows for turn in row.turns) < len(found.slowness)
    assert (found.reference.rays, found.reference.wrong, found.reference.late) == (1200, 0, 0)
    assert found.broken == found.left_out == []
    assert found.seeds == {"rays": 3, "turns": 3, "samples": 0}
    assert set(found.spent_s) == {"rays", "reference", "rational", "survey", "turns"}
    assert decode(encode(found), TradeoffRecord) == found


def test_exact_is_exact_and_the_others_are_not(found: TradeoffRecord) -> None:
    fast, robust, exact = (found.rows[k] for k in (0, 2, 4))
    of_exact = structured(exact.errors, "rational")
    assert (of_exact.missed, of_exact.false_hits, of_exact.wrong_triangles) == (0, 0, 0)
    assert (exact.picture.other_triangles, exact.picture.psnr) == (0, None)
    assert of_exact.wrong_triangles_most == pytest.approx(1 - 0.05 ** (1 / 600))
    errors = {row.accuracy: structured(row.errors, "rational") for row in (fast, robust, exact)}
    wrong = {name: e.missed + e.false_hits + e.wrong_triangles for name, e in errors.items()}
    assert wrong["fast"] > 0
    assert wrong["robust"] > 0
    distances = [each.distance for each in errors.values()]
    assert all(each is not None and 0 < each.median <= each.p999 <= each.worst for each in distances)
    of_fast, of_robust, of_exact_rung = (each.median for each in distances if each is not None)
    assert of_exact_rung < 1e-6 * min(of_fast, of_robust)


def test_verify_counts_the_same_wrong_answers(found: TradeoffRecord, device: Device) -> None:
    for density in ASKED.densities:
        asked = VerifyPlan(
            ASKED.accuracies, ASKED.rays, check=0, exact=600, seed=3, density=density, aim=found.aim
        )
        counted = {row.accuracy: row for row in verify(HILLS, asked, device).rows}
        for row in (row for row in found.rows if row.density == density):
            for against in ("rational", "exact rung"):
                mine, theirs = structured(row.errors, against), counted[row.accuracy]
                assert theirs.exact_checked == mine.rays
                assert theirs.wrong_hits == mine.missed + mine.false_hits
                assert theirs.wrong_ids == mine.wrong_triangles


def test_the_command_of_a_row_counts_them_anew(
    found: TradeoffRecord, capsys: pytest.CaptureFixture[str]
) -> None:
    row = found.rows[1]
    with pytest.raises(SystemExit) as exit_:
        main([*shlex.split(row.verify)[1:], "--json"])
    assert not exit_.value.code
    [theirs] = decode(capsys.readouterr().out, VerifyRecord).rows
    mine = structured(row.errors, "rational")
    assert (theirs.wrong_hits, theirs.wrong_ids) == (mine.missed + mine.false_hits, mine.wrong_triangles)


def test_what_is_recommended_meets_the_need(found: TradeoffRecord) -> None:
    chosen = found.recommendation
    assert chosen is not None
    row = found.rows[chosen.row]
    assert (row.refused, row.error) == ([], 0.0)
    assert row.accuracy in chosen.sentence
    assert 0.3 < chosen.support <= 1
    assert found.front
    assert [found.rows[k].on_front for k in found.front] == [True] * len(found.front)
    for k, each in enumerate(found.rows):
        assert each.on_front == (k in found.front)
        assert ("error" in each.refused) == (each.error is not None and each.error > 0)


def once(device: Device, **options: Any) -> TradeoffRecord:
    few = {"accuracies": ("robust",), "rays": 50, "exact": 20, "budget_s": 1.0}
    plan = replace(ASKED, **{**few, **options})
    return tradeoff(HILLS, plan, device)


def test_needs_are_kept_or_said_to_be_out_of_reach(device: Device) -> None:
    small = once(device, densities=(1.0, 64.0), wish=Wish(max_memory=60_000))
    assert [row.density for row in small.rows] == [1.0]
    assert [each.density for each in small.left_out] == [64.0]
    assert "60,000" in small.left_out[0].reason or "60.0 kB" in small.left_out[0].reason
    hopeless = once(device, wish=Wish(max_time_s=1e-6))
    assert hopeless.recommendation is None
    assert hopeless.nearest.startswith("no point keeps to 0.001 ms; within the error the fastest is robust")
    assert all(row.refused == ["time"] for row in hopeless.rows)
    many = once(device, wish=Wish(frames=1000))
    for row in many.rows:
        assert row.cost_s.median < max(row.time_to_image_s)
    assert many.recommendation is not None
    assert "a picture of 1,000" in many.recommendation.sentence


def test_shaded_pictures_differ_by_their_samples(device: Device) -> None:
    wish = Wish(measure="rms", max_time_s=9.0)
    result = once(device, accuracies=("exact",), densities=(1.0,), samples=(1, 2), wish=wish)
    few, more = result.rows
    assert (few.samples, more.samples) == (1, 2)
    # The reference has as many samples as the second.
    assert few.picture.rms > more.picture.rms == 0.0
    assert result.recommendation is not None
    assert result.rows[result.recommendation.row].samples == 2


def command(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as exit_:
        main(words)
    streams = capsys.readouterr()
    return exit_.value.code or 0, streams.out, streams.err  # type: ignore[return-value]


SHORT = (
    "tradeoff", NAME, "--accuracy", "robust", "--layout", "compact", "--density", "1,4", "--size", "48x48",
    "--rays", "50", "--exact", "20", "--budget", "1",
)  # fmt: skip


def test_the_command_line(capsys: pytest.CaptureFixture[str], device: Device) -> None:
    code, out, err = command(capsys, *SHORT, "--device", device.label)
    assert (code, err) == (0, "")
    assert "robust, compact, density 1" in out
    assert "recommended: robust, compact, density " in out
    code, out, err = command(capsys, *SHORT, "--device", device.label, "--json", "--max-error", "rays=0.9")
    assert (code, err) == (0, "")
    assert json.loads(out)["schema"] == "clgrid.tradeoff/1"
    result = decode(out, TradeoffRecord)
    assert (result.need.measure, result.need.max_error, result.need.stated) == ("rays", 0.9, True)
    assert command(capsys, *SHORT, "--device", device.label, "--quiet") == (0, "", "")


def test_broken_promises_are_exit_code_2(
    capsys: pytest.CaptureFixture[str], device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reference, "crossings", lambda *args: [])
    draw, drawn = Easel.draw, []

    def spoilt(*args: Any) -> Any:
        drawn.append(draw(*args))
        drawn[-1][0, 0] += len(drawn)
        return drawn[-1]

    monkeypatch.setattr(Easel, "draw", spoilt)
    code, _, err = command(capsys, *SHORT, "--device", device.label)
    assert code == 2
    lines = err.splitlines()
    assert len(lines) == 2
    assert "robust, compact, density 4 shows another picture" in lines[0]
    assert "rays hit another triangle on exact" in lines[1]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--accuracy", "blurry"), "blurry"),
        (("--layout", "octree"), "octree"),
        (("--density", "1,much"), "--density"),
        (("--samples", "1.5"), "--samples"),
        (("--samples", "1,4"), "--max-error rms"),
        (("--sky", "1"), "--samples"),
        (("--max-error", "few"), "--max-error"),
        (("--max-error", "smell=1"), "smell"),
        (("--max-time", "soon"), "--max-time"),
        (("--max-memory", "big"), "--max-memory"),
        (("--max-memory", "10"), "10"),
        (("--budget", "0"), "budget"),
        (("--clock", "sun"), "clock"),
        (("--camera", "nobody"), "nobody"),
    ],
)
def test_mistakes_are_one_line(
    words: tuple[str, ...], said: str, capsys: pytest.CaptureFixture[str], device: Device
) -> None:
    code, out, err = command(capsys, "tradeoff", "cube", "--size", "16x16", "--device", device.label, *words)
    assert (code, out) == (1, "")
    [line] = err.splitlines()
    assert said in line


def test_a_mesh_without_triangles_is_an_error(device: Device) -> None:
    nothing = Mesh(HILLS.mesh.vertices[:0], HILLS.mesh.faces[:0])
    with pytest.raises(InputError, match="no triangles"):
        tradeoff(Scene("nothing", nothing), ASKED, device)
