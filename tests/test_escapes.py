"""scripts/escapes: one run end to end, its resumption, its fans, its mistakes."""

from __future__ import annotations

import importlib.machinery
import importlib.util
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from meshes import MESHES, soup

from clgrid import procedural
from clgrid.closed import open_edges
from clgrid.device import Device
from clgrid.mesh import Mesh

SCRIPT = Path(__file__).resolve().parent.parent / "scripts" / "escapes"


@pytest.fixture
def module(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The script as a module."""
    monkeypatch.syspath_prepend(str(SCRIPT.parent))
    loader = importlib.machinery.SourceFileLoader("escapes", str(SCRIPT))
    spec = importlib.util.spec_from_loader("escapes", loader)
    assert spec is not None
    made = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "escapes", made)
    loader.exec_module(made)
    return made


def escapes(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, str(SCRIPT), *arguments], capture_output=True, text=True)


@pytest.mark.slow
def test_a_longer_run_goes_on_where_a_shorter_one_ended(tmp_path: Path, device: Device) -> None:
    words = (
        "--meshes", "icosphere:2,terrain:6", "--offsets", "0,1e9", "--scales", "1,1e-20", "--accuracy",
        "robust", "--device", device.label, "--out", str(tmp_path),
    )  # fmt: skip
    first = escapes("--rays", "1600", *words)
    assert first.returncode == 0, first.stderr
    assert "terrain:6: 24 open edges, closed by 24 triangles" in first.stderr
    log = tmp_path / "escapes.jsonl"
    lines = [json.loads(line) for line in log.read_text().splitlines()]
    assert len(lines) == 8
    assert {(line["rays"], line["inside"], line["batch"]) for line in lines} == {(200, 50, 0)}
    assert all(line["rungs"]["robust"]["escapes"] == 0 for line in lines)
    assert "| icosphere:2 | robust | 800 | 200 | 0 |" in first.stdout
    assert first.stdout == (tmp_path / "escapes.md").read_text()

    again = escapes("--rays", "1600", *words)
    assert (again.stdout, again.stderr) == (first.stdout, "")
    # A run that was killed leaves half a line.
    log.write_text(log.read_text() + '{"half')
    longer = escapes("--rays", "2400", *words)
    assert longer.returncode == 0, longer.stderr
    assert "cut short" in longer.stderr
    assert "| icosphere:2 | robust | 1,200 | 300 | 0 |" in longer.stdout
    assert len(log.read_text().splitlines()) == 17
    other = escapes("--rays", "800", *words, "--seed", "1")
    assert "| icosphere:2 | robust | 400 | 100 | 0 |" in other.stdout


@pytest.mark.parametrize("name", ["ball", "terrain", "stacks", "soup", "flat", "line", "one"])
def test_fans_close_any_mesh(name: str, module: Any) -> None:
    mesh = MESHES[name]
    closed = module.closed_by_fans(mesh)
    assert open_edges(closed) == 0
    assert closed.triangle_count == mesh.triangle_count + open_edges(mesh)
    np.testing.assert_array_equal(closed.faces[: len(mesh.faces)], mesh.faces)
    np.testing.assert_array_equal(closed.vertices[: len(mesh.vertices)], mesh.vertices)


def test_each_hole_has_a_fan_of_its_own(module: Any) -> None:
    ball = procedural.icosphere(2)
    holed = Mesh(ball.vertices, np.delete(ball.faces, [3, 200], axis=0))
    closed = module.closed_by_fans(soup(holed.vertices[holed.faces]))
    assert closed.triangle_count == holed.triangle_count + 6
    middles = closed.vertices[-2:].tolist()
    expected = ball.vertices[ball.faces[[3, 200]]].mean(axis=1)
    assert sorted(middles) == pytest.approx(np.array(sorted(expected.tolist())), abs=1e-6)


def test_promised_escapes_are_said_with_their_ray(module: Any, tmp_path: Path) -> None:
    case = module.Case("ball", 0.0, 1.0)
    result = {
        "escapes": 2, "even_inside": 5, "odd_lines": 7,
        "first": {"escapes": {"origin": [0, 0, 0], "direction": [1, 0, 0]}},
    }  # fmt: skip
    log = module.Log(tmp_path / "log.jsonl", {"seed": 0})
    log.append(
        {"setting": {"seed": 0}, "mesh": "ball", "offset": 0.0, "scale": 1.0, "rungs": {"robust": result}}
    )
    [line] = module.broken(log, [case])
    assert line.startswith("ball, offset 0 diagonals, scale 1: robust: 2 escapes; the first: ")
    assert json.loads(line.split("first: ")[1])["direction"] == [1, 0, 0]
    assert module.Log(tmp_path / "log.jsonl", {"seed": 1}).lines == []


@pytest.mark.parametrize(
    "words", [("--rays", "0"), ("--accuracy", "blurry"), ("--offsets", "far"), ("--meshes", "nowhere.ply")]
)
def test_mistakes_are_one_line(words: tuple[str, ...], tmp_path: Path) -> None:
    done = escapes(*words, "--out", str(tmp_path))
    assert done.returncode == 1
    assert done.stdout == ""
    assert len(done.stderr.splitlines()) == 1
    assert done.stderr.startswith("escapes: ")
