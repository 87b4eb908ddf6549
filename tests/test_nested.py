"""Nested grids change no answer, on scenes that are crowded here and empty there, whatever is asked."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from agreement import KINDS, RUNGS, assert_lossless, part, query
from bundles import around_hits, assert_brute, shaped, tile, tiles_as_given, view
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from meshes import soup
from rays import Rays, lattice_meshes, lattice_rays, surroundings
from shapes import joined
from test_tile_pictures import NAMES, assert_picture, draw, expected_picture
from uneven import HALL, MESHES, WITHOUT_AREA, Resolution, aimed, default_top, placed, teapot, tiles_at

from clgrid import procedural
from clgrid.camera import Camera
from clgrid.device import Device
from clgrid.grid import build
from clgrid.layouts import ALL_LAYOUTS
from clgrid.layouts.lists import NESTED
from clgrid.mesh import Mesh
from clgrid.rational import Triangles, inside

F64 = npt.NDArray[np.float64]
LAYOUTS = tuple(NESTED)
COMPILED = {"robust": LAYOUTS, "precise": ("nested",), "exact": ("nested-hashed",)}
"""Layouts by rung: kernels of all would take minutes to compile."""
RESOLUTIONS: tuple[Resolution, ...] = ((1, 1, 1), (7, 4, 3), (4096, 1, 1))


def grids(accuracy: str) -> list[dict[str, Any]]:
    """Of the layouts in turn, of several densities and top grids; fewer on the slower rungs."""
    own: list[dict[str, Any]] = [{"density": density} for density in (0.5, 2, 0.1, 30)]
    own[1:1] = [{"resolution": resolution} for resolution in RESOLUTIONS]
    layouts = COMPILED[accuracy]
    each = [{"layout": layouts[number % len(layouts)], **options} for number, options in enumerate(own)]
    return each if accuracy == "robust" else each[:3:2]


@pytest.mark.thorough
@pytest.mark.parametrize("accuracy", RUNGS)
@pytest.mark.parametrize("name", MESHES)
def test_nested_grids_change_no_answer(name: str, accuracy: str, device: Device) -> None:
    mesh = MESHES[name]
    rays = query(*aimed(mesh, default_top(mesh), 1300, 1))
    answers = assert_lossless(mesh, device, accuracy, rays, grids(accuracy))
    assert answers.hits.mask.any() or name in WITHOUT_AREA


@pytest.mark.thorough
@pytest.mark.parametrize("accuracy", RUNGS)
@pytest.mark.parametrize("name", ["teapot", "box_in_planes", "thick_clusters", "huge_and_tiny"])
def test_intervals_that_end_or_begin_at_hits(name: str, accuracy: str, device: Device) -> None:
    mesh = MESHES[name]
    o, d = aimed(mesh, (7, 4, 3), 900, 2)
    every = build(mesh, resolution=(1, 1, 1), accuracy=accuracy, device=device).cast_all(
        o, d, -np.inf, np.inf
    )
    middle, met = np.ones(len(o)), every.counts > 0
    middle[met] = every.t_hit[(every.ray_splits[:-1] + every.counts // 2)[met]]
    after, before = np.nextafter(middle, np.inf), np.nextafter(middle, -np.inf)
    options = [{"layout": layout, "resolution": (7, 4, 3)} for layout in COMPILED[accuracy]]
    for low, high in ((middle, np.inf), (after, np.inf), (-np.inf, middle), (0.0, before)):
        rays = part(query(o, d, low, high), slice(None, None, 2))
        assert_lossless(mesh, device, accuracy, rays, options)


@pytest.mark.thorough
@pytest.mark.parametrize("accuracy", RUNGS)
@pytest.mark.parametrize("name", MESHES)
def test_tiles_of_a_nested_grid_change_no_answer(name: str, accuracy: str, device: Device) -> None:
    """Tiles of all kinds, and the same with intervals that begin or end at their hits."""
    mesh, rng = MESHES[name], np.random.default_rng(72)
    layouts = COMPILED[accuracy]
    for layout, resolution in zip((layouts[0], layouts[-1]), ((7, 4, 3), default_top(mesh)), strict=True):
        rays = tiles_at(mesh, resolution, 24, 3)
        grid = build(mesh, layout, resolution=resolution, accuracy=accuracy, device=device)
        with pytest.MonkeyPatch.context() as patch, tiles_as_given(patch):
            hits = assert_brute(mesh, device, accuracy, rays, [grid])
            assert_brute(mesh, device, accuracy, around_hits(rays, hits.t_hit, rng), [grid])
        assert hits.mask.any() or name in WITHOUT_AREA


@pytest.mark.thorough
@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_hit_where_the_interval_ends_is_found_by_a_tile(layout: str, device: Device) -> None:
    """What waits to be tested when nothing behind matters any more still matters."""
    mesh = MESHES["teapot"]
    o, d, _, _ = view((0.3, -0.2, 0.9), 16, 16, 0.3, (0.3, -0.2, 0.1))
    grid = build(mesh, layout, device=device)
    hits = grid.cast(o, d)
    assert hits.mask.mean() > 0.3
    high = np.where(hits.mask, hits.t_hit, 0.0)
    rays = o, d, np.zeros_like(high), high
    assert_brute(mesh, device, "robust", rays, [grid])
    assert (grid.cast(*rays).mask == hits.mask).all()


@pytest.mark.thorough
@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("seed", [32, 58, 279])
def test_a_tile_that_leaves_a_subgrid_for_one_nearer_loses_no_hit(
    seed: int, layout: str, device: Device
) -> None:
    """Subgrids of a slice are passed one by one: a group that is done in one is not in the next."""
    rng = np.random.default_rng(seed)
    corners = np.round(rng.uniform(-1, 1, (int(rng.integers(8, 40)), 3, 3)) * 8) / 8
    mesh = soup(corners)
    rays = shaped(*tile(surroundings(mesh, (2, 2, 2)), rng))
    with pytest.MonkeyPatch.context() as patch, tiles_as_given(patch):
        options = {"layout": layout, "resolution": (2, 2, 2), "density": 8.0}
        assert_brute(mesh, device, "robust", rays, [options])


@pytest.mark.thorough
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    mesh=lattice_meshes(),
    rays=lattice_rays(),
    resolution=st.tuples(*[st.integers(1, 9)] * 3),
    density=st.sampled_from([0.5, 4.0, 60.0]),
    layout=st.sampled_from(LAYOUTS),
    copies=st.sampled_from([1, 8]),
)
def test_lattice_coincidences_change_no_answer(
    mesh: Mesh, rays: Rays, resolution: Resolution, density: float, layout: str, copies: int, device: Device
) -> None:
    """Copies of a mesh are what it takes for cells of so few triangles to get subgrids."""
    crowd = Mesh(mesh.vertices, np.tile(mesh.faces, (copies, 1)))
    options = {"layout": layout, "resolution": resolution, "density": density}
    assert_lossless(crowd, device, "robust", query(*rays), [options])


@pytest.mark.thorough
def test_teapots_in_all_places_of_a_cell(device: Device) -> None:
    """Also in the planes of cells, of all sizes, and in their corners."""
    for number, at in enumerate(np.linspace(-0.75, 0.75, 13)):
        place = np.array([at, 0.25 - at, at / 3])
        mesh = teapot(place, 2 + number % 3, 0.5 ** (2 + number))
        rays = query(*aimed(mesh, (4, 4, 4), 650, number))
        options = {"layout": LAYOUTS[number % 2], "resolution": (4, 4, 4)}
        assert assert_lossless(mesh, device, "robust", rays, [options]).hits.mask.any()


@pytest.mark.parametrize("layout", LAYOUTS)
def test_contains_is_exact_in_a_nested_grid(layout: str, device: Device) -> None:
    mesh, rng = teapot((0.3, -0.2, 0.1), 3, 1 / 50), np.random.default_rng(73)
    near = np.array([0.3, -0.2, 0.1]) + rng.uniform(-1, 1, (400, 3)) / 45
    on = mesh.vertices[mesh.faces[rng.integers(mesh.triangle_count, size=200), 0]].astype(np.float64)
    points = np.concatenate([near, on, rng.uniform(-1.1, 1.1, (200, 3))])
    grid = build(mesh, layout, accuracy="exact", device=device)
    found = grid.contains(points)
    one_cell = build(mesh, resolution=(1, 1, 1), accuracy="exact", device=device)
    np.testing.assert_array_equal(found, one_cell.contains(points))
    prepared = Triangles.of_mesh(mesh)
    some = slice(None, None, 16)
    np.testing.assert_array_equal(
        found[some], [inside(prepared, point, (-0.25, 1.0, 0.5)) for point in points[some]]
    )
    assert 0.2 < found[:400].mean() < 0.8


@pytest.mark.parametrize("layout", LAYOUTS)
def test_pictures_of_a_crowd(layout: str, device: Device) -> None:
    """From afar, where it is less than a pixel; near by; from within."""
    mesh = joined(HALL, placed(procedural.icosphere(4), 0.01, (0.5, 0.25, -0.125)))
    grid = build(mesh, layout, device=device)
    for eye, fov in (((-0.9, 0.8, 0.7), 70.0), ((0.5, 0.26, 0.1), 8.0), ((0.5, 0.25, -0.125), 90.0)):
        camera = Camera.look_at(eye, (0.5, 0.25, -0.125 - 1e-4), (0.1, 0.9, 0.2), fov)
        expected = expected_picture(mesh, camera, 61, 47, device, "robust")
        assert set(expected) == set(NAMES)
        assert_picture(draw(mesh, camera, (61, 47), grid=grid), expected)


def test_every_layout_is_tried() -> None:
    assert {layout for layout, _ in KINDS} | {"nested-hashed"} == set(ALL_LAYOUTS)
    assert not {layout for layout, skipping in KINDS if skipping} & set(LAYOUTS)
