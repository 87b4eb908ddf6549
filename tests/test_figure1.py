"""scripts/figure1: rows end to end, resumption, failures, the scenes it makes, the paper's numbers."""

from __future__ import annotations

import csv
import importlib
import json
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import clgrid
from clgrid import procedural
from clgrid.device import Device

SCRIPTS = Path(__file__).resolve().parent.parent / "scripts"

# Stands in for the folder's own script: splits nothing, writes one triangle, or fails if the input says so.
SUBDIVIDE = """
import sys
source, levels, out = sys.argv[1:4]
text = open(source).read()
if text == "broken":
    sys.exit("cannot be split")
open(out, "w").write(text)
"""
TRIANGLE = """ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
0 1 0
3 0 1 2
"""


@pytest.fixture
def module(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Import a module of scripts/, as the script itself does."""
    monkeypatch.syspath_prepend(str(SCRIPTS))

    def load(name: str) -> ModuleType:
        return importlib.import_module(name)

    return load


def figure1(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run the script with everything that it writes below ``folder``."""
    command = [sys.executable, str(SCRIPTS / "figure1"), "--out", str(folder / "out"), "--reps", "1"]
    command += ["--cache", str(folder / "cache"), "--scenes", str(folder / "scenes"), "--rounds", "1"]
    return subprocess.run([*command, "--size", "32x32", *arguments], capture_output=True, text=True)


def records(folder: Path) -> dict[str, int]:
    """Names and times of what was measured."""
    return {path.name: path.stat().st_mtime_ns for path in (folder / "out" / "records").iterdir()}


def scenes_folder(folder: Path, armadillo: str) -> None:
    """Make a folder of scenes that has the Armadillo and nothing else."""
    (folder / "scenes" / "scans").mkdir(parents=True)
    (folder / "scenes" / "subdivide.py").write_text(SUBDIVIDE)
    (folder / "scenes" / "scans" / "armadillo.obj").write_text(armadillo)


@pytest.mark.slow
def test_a_row_without_scenes_is_measured_once(tmp_path: Path, device: Device) -> None:
    (tmp_path / "scenes").mkdir()
    asked = ("--rows", "armadillo", "--layouts", "compact", "--no-threads", "--device", device.label)
    first = figure1(tmp_path, *asked)
    assert first.returncode == 0, first.stderr
    assert "1 measured, 0 kept, 0 failed" in first.stderr
    measured = records(tmp_path)
    assert len(measured) == 1

    second = figure1(tmp_path, *asked)
    assert second.returncode == 0, second.stderr
    assert "0 measured, 1 kept, 0 failed" in second.stderr
    assert records(tmp_path) == measured
    assert second.stdout == first.stdout == (tmp_path / "out" / "figure1.md").read_text()

    document = json.loads((tmp_path / "out" / "figure1.json").read_text())
    row = document["rows"][0]
    assert (row["row"], row["layout"], row["triangles"]) == ("Armadillo", "compact", 327_680)
    assert row["mesh_bytes"] == 12 * (327_680 + 163_842)
    assert row["time_to_image_s"] > 0
    assert row["paper_triangles"] == 345e3
    with open(tmp_path / "out" / "figure1.csv", newline="") as file:
        assert [line["grid_bytes"] for line in csv.DictReader(file)] == [str(row["grid_bytes"])]

    other = figure1(tmp_path, *asked, "--density", "2")
    assert "1 measured, 0 kept" in other.stderr
    assert "1 measured, 0 kept" in figure1(tmp_path, *asked, "--fresh").stderr


@pytest.mark.slow
def test_a_row_that_fails_stops_no_other(tmp_path: Path, device: Device) -> None:
    scenes_folder(tmp_path, TRIANGLE)
    asked = ("--rows", "Armadillo,Dragon,Buddha", "--layouts", "compact", "--no-threads")
    done = figure1(tmp_path, *asked, "--device", device.label)
    assert done.returncode == 1
    assert "1 measured, 0 kept, 2 failed" in done.stderr
    assert "Dragon (compact on" in done.stdout
    assert "scans/bunny_zipper.ply is not in the scenes folder" in done.stdout
    rows = json.loads((tmp_path / "out" / "figure1.json").read_text())["rows"]
    assert [row["failure"] is None for row in rows] == [True, False, False]
    assert rows[0]["triangles"] == 1


@pytest.mark.parametrize(
    ("armadillo", "reason", "options"),
    [
        ("broken", "subdivide.py: cannot be split", ()),
        (TRIANGLE.replace("3 0 1 2", "3 0 1 9"), "armadillo-1-", ()),
        (TRIANGLE, "not done after 0.001 s", ("--timeout", "0.001")),
    ],
)
def test_a_failure_says_why_in_one_line(
    tmp_path: Path, device: Device, armadillo: str, reason: str, options: tuple[str, ...]
) -> None:
    scenes_folder(tmp_path, armadillo)
    asked = ("--rows", "armadillo", "--layouts", "compact", "--no-threads")
    done = figure1(tmp_path, *asked, "--device", device.label, *options)
    assert done.returncode == 1
    failed = [line for line in done.stdout.splitlines() if line.startswith("- Armadillo")]
    assert len(failed) == 1, done.stderr
    assert reason in failed[0]
    assert str(tmp_path) not in done.stdout
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--rows", "Armadilo"], "there is no 'armadilo'"),
        (["--layouts", "compact,tree"], "there is no 'tree'"),
        (["--reps", "0"], "'0' is not a number of at least 1"),
        (["--max-triangles", "1000"], "no row has at most 1,000 triangles"),
        (["--device", "nosuch"], "nosuch"),
    ],
)
def test_wrong_usage_is_one_line(tmp_path: Path, arguments: list[str], said: str) -> None:
    (tmp_path / "scenes").mkdir()
    done = figure1(tmp_path, *arguments)
    assert done.returncode == 1
    assert done.stdout == ""
    assert len(done.stderr.strip().splitlines()) == 1
    assert said in done.stderr


@pytest.mark.parametrize("name", ["icosphere:3", "terrain:7"])
def test_built_in_scenes_are_counted_without_making_them(module: Any, name: str) -> None:
    ready = module("figure1_scenes").BuiltIn(name).make(None, Path())
    mesh = procedural.make(name)
    assert ready.triangles == mesh.triangle_count
    assert ready.mesh_bytes == mesh.vertices.nbytes + mesh.faces.nbytes


def test_every_row_has_a_scene_of_about_the_papers_size(module: Any) -> None:
    rows, paper = module("figure1_scenes").ROWS, module("figure1_paper").PAPER
    assert list(rows) == list(paper)
    for name, stand_ins in rows.items():
        for stand_in in stand_ins:
            assert 0.59 < stand_in.triangles / paper[name].triangles < 1.21, (name, stand_in)


def test_the_uneven_scene_stands_on_its_terrain(module: Any, tmp_path: Path) -> None:
    copy, side = procedural.icosphere(2), 32
    ground = procedural.terrain(side)
    path = tmp_path / "nature.ply"
    module("figure1_nature").write_scattered(
        path, (copy.vertices, copy.faces), (ground.vertices, ground.faces), side=side, triangles=20_000
    )
    mesh = clgrid.load(path)
    assert abs(mesh.triangle_count - 20_000) <= copy.triangle_count // 2
    assert np.array_equal(mesh.vertices[: len(ground.vertices)], ground.vertices)
    assert np.array_equal(mesh.faces[: len(ground.faces)], ground.faces)
    spheres = mesh.vertices[len(ground.vertices) :].reshape(-1, len(copy.vertices), 3).astype(np.float64)
    sizes = np.ptp(spheres[..., 2], axis=1)
    extent = float(np.ptp(ground.vertices[:, 0]))
    assert 0.015 * extent < sizes.min() < sizes.max() < 0.201 * extent
    # A round copy stays round, and its foot is a vertex of the terrain, a little below.
    assert np.allclose(np.linalg.norm(np.ptp(spheres, axis=1), axis=1) / sizes, np.sqrt(3), rtol=0.05)
    foot = (spheres.min(axis=1) + spheres.max(axis=1)) / 2
    nearest = np.abs(foot[:, None, :2] - ground.vertices[None, :, :2]).sum(axis=2).argmin(axis=1)
    below = ground.vertices[nearest, 2] - spheres[..., 2].min(axis=1)
    assert np.allclose(below, 0.05 * sizes, atol=1e-4)
    assert np.array_equal(clgrid.load(path).faces[-1], mesh.faces[-1])


def test_derived_numbers_of_the_paper_agree_with_what_it_says(module: Any) -> None:
    paper = module("figure1_paper").PAPER
    assert paper["Dragon"].bytes_per_triangle("compact") * 871_414 / 2**20 == pytest.approx(21.9, rel=0.003)
    david = paper["David"]
    assert david.time_to_image_s("hashed") / david.time_to_image_s("compact") == pytest.approx(1.35, abs=0.01)
    assert paper["Dragon"].render_s("hashed") is None
    assert paper["Dragon"].bytes_per_triangle("linked-list") is None


def test_numbers_are_written_without_exponents(module: Any) -> None:
    digits = module("figure1_tables")._digits
    assert [digits(x) for x in (12345.6, 99.96, 1.0, 0.04567, 0.0, None)] == [
        *("12,300", "100", "1.00", "0.0457", "0", "")
    ]


def test_names_of_rows_are_kept_apart_in_the_plot(module: Any) -> None:
    apart = module("figure1_plot")._apart
    assert apart([0.1, 0.5], 0.1) == [0.1, 0.5]
    assert apart([0.5, 0.5, 0.9], 0.1) == pytest.approx([0.45, 0.55, 0.9])


def test_answers_that_differ_between_layouts_are_said(module: Any) -> None:
    measure, report = module("figure1_measure"), module("figure1_report")
    answers = {"hits": 5, "rays": 9, "triangles": 7, "resolution": [1, 1, 1], "references": 8}
    one = measure.Measured("Dragon", "compact", 2, None, [answers])
    same = measure.Measured("Dragon", "hashed", 2, None, [answers])
    other = measure.Measured("Dragon", "linked-list", 2, None, [{**answers, "hits": 4}])
    assert report.disagreements([one, same]) == []
    assert report.disagreements([one, same, other]) == ["Dragon: hits differ between measurements: 4, 5"]
