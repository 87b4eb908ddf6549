"""clgrid/tuning.py and scripts/tune: numbers that change speed alone."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

import clgrid
from clgrid import tuning
from clgrid.device import Device
from clgrid.scene import load_scene
from clgrid.wavefront import random_rays

SCRIPT = Path(__file__).resolve().parent.parent / "scripts" / "tune"
OTHERS = (
    tuning.Tuning(widest_slice=1, fewest_together=64, remembered=8, herd=3, fewest_in_turns=1),
    tuning.Tuning(widest_slice=100_000, fewest_together=1, remembered=1024, fewest_in_turns=1 << 40),
)


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize("other", OTHERS)
def test_no_number_changes_a_bit(device: Device, other: tuning.Tuning) -> None:
    scene = load_scene("terrain:40")
    grid = clgrid.build(scene.mesh, density=4.0, device=device)
    rays = random_rays(scene.mesh, 2_000, seed=3)

    def everything() -> list[np.ndarray]:
        hits = grid.cast(rays.origins, rays.directions)
        image = clgrid.render(scene, width=50, height=40, aovs=("id", "depth"), grid=grid)
        assert image.primitive_id is not None
        assert image.depth is not None
        return [
            hits.t_hit,
            hits.primitive_ids,
            hits.primitive_uvs,
            grid.occluded(rays.origins, rays.directions),
            grid.count(rays.origins, rays.directions),
            image.rgba,
            image.primitive_id,
            image.depth,
        ]

    before = everything()
    with tuning.tried(other):
        after = everything()
    for a, b in zip(before, after, strict=True):
        np.testing.assert_array_equal(a, b)


def test_numbers_tried_hold_within_alone(device: Device) -> None:
    used = tuning.tuning_of(device)
    with tuning.tried(OTHERS[0]):
        assert tuning.tuning_of(device) == OTHERS[0]
    assert tuning.tuning_of(device) == used


def test_turns_are_for_large_meshes() -> None:
    numbers = tuning.Tuning(fewest_in_turns=100, herd=5)
    assert numbers.turns(100) == {"IN_TURNS": 5}
    assert numbers.turns(99) == {}


def test_only_what_differs_is_an_option() -> None:
    assert tuning.Tuning().defines == {}
    assert tuning.Tuning(remembered=64).defines == {"REMEMBERED": "64u"}


def run(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, SCRIPT, *words], capture_output=True, text=True, timeout=600)


@pytest.mark.slow
@pytest.mark.thorough
def test_the_script_names_the_best_of_each_number(device: Device) -> None:
    done = run(
        *("cube", "--size", "16x16", "--reps", "1", "--numbers", "remembered,herd", "--device", device.label)
    )
    assert done.returncode == 0, done.stderr
    best = done.stdout.splitlines()[-1]
    assert best.startswith("best: remembered=")
    assert ", herd=" in best


def test_the_script_refuses_what_it_does_not_know() -> None:
    done = run("--numbers", "speed")
    assert done.returncode == 1
    assert "widest_slice" in done.stderr
    assert len(done.stderr.splitlines()) <= 3
    names = {field.name for field in fields(replace(OTHERS[0]))}
    assert all(name in SCRIPT.read_text() for name in names)
