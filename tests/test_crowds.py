"""The automatic choice of a nested grid: where triangles crowd, and nowhere else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import scene
from test_cost import ASKED, FIXED
from uneven import teapot

from clgrid import cost
from clgrid.device import Device
from clgrid.estimate import sample
from clgrid.grid import build, predict
from clgrid.mesh import Mesh
from clgrid.procedural import icosphere, terrain
from clgrid.resolution import by_density
from clgrid.scene import load_scene

CROWDED = teapot((0.3, -0.2, 0.1), level=6)
ANY = replace(ASKED, nested=True)
EVEN = {"ball": icosphere(6), "terrain": terrain(160)}


def pairs_in_a_cell(mesh: Mesh, density: float) -> float:
    """How many triangles share a cell with a triangle by their middles, by mean, itself not counted."""
    low, high = mesh.vertices[mesh.faces].min(axis=1), mesh.vertices[mesh.faces].max(axis=1)
    middles = 0.5 * (low.astype(np.float64) + high)
    bounds = mesh.bounds.astype(np.float64)
    cells = by_density(bounds[1] - bounds[0], mesh.triangle_count, density)
    at = np.minimum((middles - bounds[0]) / (bounds[1] - bounds[0]) * cells, np.array(cells) - 1).astype(int)
    counts = np.bincount((at[:, 2] * cells[1] + at[:, 1]) * cells[0] + at[:, 0])
    return float((counts * (counts - 1.0)).sum()) / mesh.triangle_count


@pytest.mark.parametrize("density", [0.5, 4.0])
@pytest.mark.parametrize("name", [*EVEN, "crowd"])
def test_a_sample_tells_how_many_share_a_cell(name: str, density: float) -> None:
    mesh = {**EVEN, "crowd": CROWDED}[name]
    seen = sample(mesh, 1 << 11)
    found = seen.crowd(by_density(seen.bounds[1] - seen.bounds[0], mesh.triangle_count, density))
    # A hundred pairs of the sample or more share a cell: four times what their number varies by, at most.
    assert found == pytest.approx(pairs_in_a_cell(mesh, density), rel=0.4, abs=5)


def test_a_nested_grid_is_in_question_where_triangles_crowd() -> None:
    found = cost.candidates(sample(CROWDED), ANY, FIXED)
    nested = [one for one in found if one.layout == "nested"]
    assert len(nested) == 1
    assert cost.ranked(found)[0] is nested[0]
    assert cost.candidates(sample(CROWDED), ASKED, FIXED) == [one for one in found if one is not nested[0]]


@pytest.mark.parametrize("name", EVEN)
def test_even_meshes_pay_nothing_for_it(name: str) -> None:
    seen = sample(EVEN[name])
    assert cost.candidates(seen, ANY, FIXED) == cost.candidates(seen, ASKED, FIXED)


def test_few_rays_are_not_worth_a_nested_grid() -> None:
    chosen = cost.ranked(cost.candidates(sample(CROWDED), replace(ANY, rays=16), FIXED))[0]
    assert chosen.layout == "compact"


def test_auto_builds_a_nested_grid_where_triangles_crowd(device: Device) -> None:
    grid = build(CROWDED, layout="auto", device=device)
    assert grid.layout.startswith("nested")
    assert grid.choice is not None
    assert grid.choice.chosen.layout == grid.layout
    assert predict(CROWDED, layout="auto", device=device) == grid.stats.nbytes
    assert build(CROWDED, layout="auto", density=1.0, device=device).layout in cost.LAYOUTS
    assert build(EVEN["ball"], layout="auto", device=device).layout in cost.LAYOUTS


@pytest.mark.parametrize(
    ("name", "is_crowded"),
    [
        ("arch/bunny_in_stadium.ply", True),
        ("arch/luxcore_kitchen.glb", True),
        ("arch/sponza_dabrovic.glb", False),
        ("scans/armadillo.obj", False),
    ],
)
def test_real_scenes_that_crowd(name: str, is_crowded: bool) -> None:
    found = cost.candidates(sample(load_scene(scene(name)).mesh), ANY, FIXED)
    assert (cost.ranked(found)[0].layout == "nested") == is_crowded
