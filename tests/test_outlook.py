"""What a camera is estimated to see, against rays that were cast; and the choice of a grid by it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import scene
from test_cost import ASKED, FIXED
from uneven import teapot

from clgrid import cost
from clgrid.camera import Camera
from clgrid.device import Device
from clgrid.estimate import estimate, estimate_nested, sample
from clgrid.frame import LocalFrame
from clgrid.grid import build
from clgrid.layouts.nested import top_resolution
from clgrid.mesh import Mesh
from clgrid.outlook import Pictured
from clgrid.procedural import icosphere, terrain
from clgrid.renderer import render
from clgrid.resolution import by_density
from clgrid.scene import default_camera, load_scene

AT = (0.3, -0.2, 0.1)
CROWDED = teapot(AT, level=6)
BESIDE = Camera.look_at((0.3, -0.2, 0.106), AT)
FAR = Camera.look_at((-0.9, 0.8, 0.9), AT, fov=60)
ANY = replace(ASKED, nested=True)
# What the choice of a grid needs to know: in crowds, tests differ by thousands.
LEAST, MOST = 0.3, 4.0
VIEWS = {
    "ball": (icosphere(5), default_camera(icosphere(5), 1.0)),
    "within a ball": (icosphere(5), Camera.look_at((0.2, 0.1, -0.3), (1, 0.4, 0.2), fov=70)),
    "terrain": (terrain(128), default_camera(terrain(128), 1.0)),
    "over a terrain": (terrain(128), Camera.look_at((0, 0.2, 0.9), (0.1, 0, -1), fov=60)),
    "beside a crowd": (CROWDED, BESIDE),
}


def counted(mesh: Mesh, view: Camera, device: Device, **options: object) -> tuple[float, float]:
    """Steps and tests of a ray of a picture, by mean."""
    grid = build(mesh, device=device, **options)  # type: ignore[arg-type]
    hits = grid.cast(*view.rays(96, 96), fields=("steps", "tests"))
    return float(hits.steps.mean()), float(hits.tests.mean())


@pytest.mark.thorough
@pytest.mark.parametrize("density", [0.5, 4.0])
@pytest.mark.parametrize("name", VIEWS)
def test_rays_of_a_camera_take_about_the_steps_and_tests_estimated(
    name: str, density: float, device: Device
) -> None:
    mesh, view = VIEWS[name]
    steps, tests = counted(mesh, view, device, density=density)
    seen = sample(mesh, view=view)
    found = estimate(seen, by_density(seen.bounds[1] - seen.bounds[0], mesh.triangle_count, density))
    assert LEAST < found.steps / steps < MOST
    assert LEAST < found.tests / tests < MOST


@pytest.mark.parametrize("name", ["arch/sponza_dabrovic.glb", "scans/armadillo.obj"])
def test_in_real_scenes_too(name: str, device: Device) -> None:
    loaded = load_scene(str(scene(name)))
    low, high = loaded.mesh.bounds
    # From within, where there is a hall.
    view = default_camera(loaded, 1.0)
    if "arch" in name:
        view = Camera.look_at((low + high) / 2, high - 0.3 * (high - low), fov=60)
    steps, tests = counted(loaded.mesh, view, device, density=2.0)
    seen = sample(loaded.mesh, view=view)
    found = estimate(seen, by_density(seen.bounds[1] - seen.bounds[0], loaded.mesh.triangle_count, 2.0))
    assert LEAST < found.steps / steps < MOST
    assert LEAST < found.tests / tests < MOST


def test_rays_beside_a_crowd_take_about_the_steps_and_tests_estimated_of_a_nested_grid(
    device: Device,
) -> None:
    steps, tests = counted(CROWDED, BESIDE, device, layout="nested")
    seen = sample(CROWDED, view=BESIDE)
    extents = seen.bounds[1] - seen.bounds[0]
    even = by_density(extents, CROWDED.triangle_count, 1.0)
    found = estimate_nested(seen, top_resolution(extents, CROWDED.triangle_count), even)
    assert 0.2 < found.steps / steps < 5
    assert 0.2 < found.tests / tests < 5


def test_blocks_pass_what_their_rays_test_and_each_cell_once_at_least() -> None:
    seen = Pictured(once=100.0, wide=3.0, area=0.5, side=0.7)
    # As many blocks as pixels: each passes what its ray tests, and a little more.
    assert seen.passed(1e12) / 1e12 == pytest.approx(seen.tests(), rel=1e-3)
    assert 100 < seen.passed(1) < seen.passed(4) < 4 * seen.passed(1)


def test_what_is_behind_a_wall_is_seen_less() -> None:
    wall = np.array([[-2, -2, 0], [2, -2, 0], [2, 2, 0], [-2, 2, 0]], np.float32)
    both = Mesh(
        np.concatenate([wall, wall + np.float32([0, 0, 1])]),
        np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]], np.uint32),
    )
    outlook = sample(both, view=Camera.look_at((0, 0, 4), (0, 0, 0))).outlook
    assert outlook is not None
    scale = 2.0 ** -LocalFrame.of_bounds(both.bounds).exponent
    near, far = (np.isclose(outlook.distances, scale * z, rtol=1e-3) for z in (3, 4))
    assert near.sum() > 10
    assert far.sum() > 10
    assert outlook.visible[far].mean() < 0.7 * outlook.visible[near].mean()
    assert 3 <= outlook.end / scale <= 4


@pytest.mark.parametrize(
    "view",
    [
        Camera.look_at((0, 0, 5), (0, 0, 9)),
        Camera.look_at((1e300, 0, 0), (0, 0, 0)),
        Camera.look_at((0, 0, 0), (1, 0, 0), fov=179.999),
        Camera.look_at((0, 0, 5), (0, 0, 0), fov=1e-9),
        Camera.look_at((1 / 3, 1 / 3, 0), (2, 1, 0)),
        Camera.look_at((1 / 3, 1 / 3, -1e-200), (1 / 3, 1 / 3, 1)),
    ],
    ids=["away", "far", "wide", "narrow", "within the surface", "as good as on it"],
)
@pytest.mark.parametrize("name", ["ball", "flat", "point"])
def test_every_camera_gets_a_grid(name: str, view: Camera) -> None:
    corners = {"flat": [[0, 0, 0], [1, 0, 0], [0, 1, 0]], "point": [[0, 0, 0]] * 3}
    mesh = icosphere(2)
    if name in corners:
        mesh = Mesh(np.array(corners[name], np.float32), np.array([[0, 1, 2]], np.uint32))
    found = cost.candidates(sample(mesh, view=view), ANY, FIXED)
    assert all(np.isfinite([one.build_s, one.cast_s]).all() and one.cast_s > 0 for one in found)


def test_a_nested_grid_is_chosen_for_who_stands_beside_the_crowd() -> None:
    chosen = {
        name: cost.ranked(cost.candidates(sample(CROWDED, view=view), ANY, FIXED))[0].layout
        for name, view in {"beside": BESIDE, "far": FAR}.items()
    }
    assert chosen == {"beside": "nested", "far": "compact"}


def test_a_picture_is_drawn_with_the_grid_for_its_camera(device: Device) -> None:
    layouts = set()
    for view in (BESIDE, FAR):
        grid = build(CROWDED, layout="auto", device=device, rays=256 * 256, view=view)
        drawn = render(CROWDED, view, 256, 256, layout="auto", device=device)
        assert drawn.metadata["clgrid:layout"] == grid.layout
        assert drawn.metadata["clgrid:grid_bytes"] == grid.nbytes
        # Whether hashed or not is a matter of the device's constants.
        layouts.add(grid.layout.startswith("nested"))
    assert layouts == {True, False}
