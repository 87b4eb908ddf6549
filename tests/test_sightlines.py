"""Random lines through a box, against lines that were cast."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import scene

from clgrid.device import Device
from clgrid.estimate import estimate, sample
from clgrid.grid import build
from clgrid.mesh import Mesh
from clgrid.procedural import icosphere, terrain
from clgrid.scene import load_scene


def random_lines(mesh: Mesh, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Lines between random points of the sphere around a mesh: as many in every direction at every place."""
    ends = np.random.default_rng(1).normal(size=(2, count, 3))
    ends /= np.linalg.norm(ends, axis=2, keepdims=True)
    low, high = mesh.bounds
    start, end = (low + high) / 2 + 0.501 * np.linalg.norm(high - low) * ends
    return start, end - start


def counted(mesh: Mesh, density: float, device: Device) -> tuple[float, float, float, float]:
    """Steps and tests of random lines that meet the grid, by mean; cast, and estimated."""
    grid = build(mesh, density=density, device=device)
    hits = grid.cast(*random_lines(mesh, 20000), fields=("steps", "tests"))
    entered = hits.steps > 0
    found = estimate(sample(mesh), grid.stats.resolution)
    return float(hits.steps[entered].mean()), float(hits.tests[entered].mean()), found.steps, found.tests


@pytest.mark.parametrize("density", [0.5, 4, 16])
@pytest.mark.parametrize("mesh", [icosphere(5), terrain(128)], ids=lambda mesh: mesh.source)
def test_random_lines_take_about_the_steps_and_tests_estimated(
    mesh: Mesh, density: float, device: Device
) -> None:
    steps, tests, estimated_steps, estimated_tests = counted(mesh, density, device)
    # Estimates are of all rays, of which some do not meet the box.
    assert 0.5 < estimated_steps / steps < 1.5
    assert 0.3 < estimated_tests / tests < 1.5


@pytest.mark.parametrize("name", ["scans/armadillo.obj", "scans/bunny_zipper.ply", "scans/flybrain_banc.ply"])
def test_random_lines_through_real_scans_too(name: str, device: Device) -> None:
    steps, tests, estimated_steps, estimated_tests = counted(load_scene(str(scene(name))).mesh, 4, device)
    assert 0.5 < estimated_steps / steps < 1.2
    assert 0.5 < estimated_tests / tests < 1.2


def test_what_is_in_the_way_closes_lines() -> None:
    ball = icosphere(4)
    alone = sample(ball).lines
    inner = [ball.vertices * np.float32(size) for size in (0.6, 0.7, 0.8, 0.9)]
    offsets = np.arange(5, dtype=np.uint32) * np.uint32(len(ball.vertices))
    nested = Mesh(np.concatenate([ball.vertices, *inner]), np.concatenate([ball.faces + k for k in offsets]))
    assert 0 < sample(nested).lines.open < alone.open < 1


def test_a_cluster_leaves_lines_open() -> None:
    """As much surface in a corner of the box hides less of it than all over the box."""
    ball = icosphere(3)
    rng = np.random.default_rng(2)
    spread = rng.uniform(-1, 1, (200, 1, 3)).astype(np.float32)
    far = np.array([[[1, 1, 1]], [[-1, -1, -1]]], np.float32)

    def balls(centres: np.ndarray) -> Mesh:
        points = (ball.vertices * np.float32(0.12) + np.concatenate([centres, far])).reshape(-1, 3)
        starts = np.arange(len(centres) + 2, dtype=np.uint32)[:, None, None] * np.uint32(len(ball.vertices))
        return Mesh(points.astype(np.float32), (ball.faces + starts).reshape(-1, 3))

    assert sample(balls(spread)).lines.open < 0.8 * sample(balls(spread * np.float32(0.2))).lines.open


def test_what_is_hidden_is_passed_less_often() -> None:
    shell, core = icosphere(4), icosphere(4)
    both = Mesh(
        np.concatenate([shell.vertices, core.vertices * np.float32(0.3)]),
        np.concatenate([shell.faces, core.faces + np.uint32(len(shell.vertices))]),
    )
    seen = sample(both, both.triangle_count)
    outside = np.arange(both.triangle_count) < shell.triangle_count
    shares = [seen.lines.passed(part.astype(np.float64)) for part in (outside, ~outside)]
    assert 0 < shares[1] < 0.95 * shares[0]
    assert shares[0] < 1


@pytest.mark.parametrize(
    "corners",
    [
        [[0, 0, 0], [0, 0, 0], [0, 0, 0]],
        [[0, 0, 0], [1, 0, 0], [2, 0, 0]],
        [[0, 0, 0], [1, 0, 0], [0, 1, 0]],
    ],
)
def test_flat_and_degenerate_meshes_have_lines(corners: list[list[float]]) -> None:
    lines = sample(Mesh(np.array(corners, np.float32), np.array([[0, 1, 2]], np.uint32))).lines
    assert 0 < lines.open <= 1
    assert 0 < lines.passed(np.ones(1)) <= 1
    assert lines.passed(np.zeros(1)) == 1
