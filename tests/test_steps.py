"""scripts/steps: one run end to end, its record, its picture, its mistakes."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import clgrid
from clgrid.device import Device
from clgrid.procedural import icosphere
from clgrid.wavefront import random_rays

SCRIPT = Path(__file__).resolve().parent.parent / "scripts" / "steps"


def steps(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, str(SCRIPT), *arguments], capture_output=True, text=True)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("steps")


@pytest.fixture(scope="module")
def done(folder: Path, device: Device) -> subprocess.CompletedProcess[str]:
    return steps(
        "icosphere:3", "--rays", "600", "--seed", "7", "--reps", "2", "--size", "48x40", "--density", "30",
        "--layouts", "hashed,compact", "--device", device.label, "--out", str(folder),
    )  # fmt: skip


def test_rows_are_what_the_casts_count(
    done: subprocess.CompletedProcess[str], folder: Path, device: Device
) -> None:
    assert done.returncode == 0, done.stderr
    record = json.loads((folder / "steps.json").read_text())
    assert (record["scene"], record["triangles"], record["seeds"]) == ("icosphere:3", 1280, {"rays": 7})
    assert [row["layout"] for row in record["rows"]] == ["hashed", "compact"]
    mesh = icosphere(3)
    rays = random_rays(mesh, 600, 7)
    for row in record["rows"]:
        grids = [clgrid.build(mesh, row["layout"], 30.0, device=device, skipping=s) for s in (False, True)]
        hits = [grid.cast(rays.origins, rays.directions, fields=("steps",)) for grid in grids]
        means = [float(np.mean(found["steps"])) for found in hits]
        assert row["steps_per_ray"] == pytest.approx(means)
        assert row["fewer"] == pytest.approx(means[0] / means[1])
        assert row["fewer"] > 1
        assert row["distance_bytes"] == grids[1].nbytes - grids[0].nbytes > 0
        assert (row["rays"], row["hits"], row["differing"]) == (600, int(hits[0].mask.sum()), 0)
        assert [len(taken) for taken in row["cast_s"]] == [2, 2]
        assert f"| {row['layout']} | {means[0]:.1f} | {means[1]:.1f} | {row['fewer']:.2f}x |" in done.stdout
    assert done.stdout == (folder / "steps.md").read_text()


def test_the_picture_has_both_halves_in_one_scale(
    done: subprocess.CompletedProcess[str], folder: Path
) -> None:
    if importlib.util.find_spec("matplotlib") is None:
        assert "no picture: matplotlib is missing" in done.stderr
        pytest.skip("matplotlib is not installed")
    from matplotlib import image

    picture = image.imread(folder / "steps.png")[..., :3].sum(axis=-1)
    half = picture.shape[1] // 2
    middle = slice(picture.shape[0] // 4, 3 * picture.shape[0] // 4)
    # Brighter colours are more steps: the left half has them, in the rays that go by the ball.
    left, right = picture[middle, half // 4 : 3 * half // 4], picture[middle, half + half // 4 : -half // 2]
    assert left.mean() > right.mean() + 0.1


@pytest.mark.parametrize(
    "words",
    [
        ["nosuch.ply"],
        ["cube", "--layouts", "octree"],
        ["cube", "--rays", "0"],
        ["cube", "--size", "12"],
        ["cube", "--device", "nosuch device"],
        ["--unknown"],
    ],
)
def test_mistakes_end_in_one_line(words: list[str], tmp_path: Path) -> None:
    failed = steps(*words, "--out", str(tmp_path))
    assert failed.returncode in (1, 3)
    assert failed.stderr.startswith("steps: ")
    assert len(failed.stderr.splitlines()) == 1
    assert not any(tmp_path.iterdir())
