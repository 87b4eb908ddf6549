"""What the cells of nested grids hold, and their bytes: exact, and the same everywhere."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest
from agreement import ask, assert_same, query
from cell_lists import lists_of, params_of
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from nests import Nest, assert_lists_hold_what_they_must, nest_of, subgrids_of
from oracle import U
from rays import lattice_meshes, mixed
from test_layouts import limit
from uneven import MESHES, Resolution, aimed, default_top, teapot

import clgrid
from clgrid import procedural
from clgrid.device import Device
from clgrid.errors import GridTooLargeError, InputError
from clgrid.grid import Grid, build, predict
from clgrid.layouts import binning
from clgrid.layouts.lists import NESTED
from clgrid.mesh import Mesh

LAYOUTS = tuple(NESTED)
OPTIONS: tuple[dict[str, object], ...] = (
    {"density": 0.5},
    {"density": 2},
    {"resolution": (1, 1, 1)},
    {"resolution": (7, 4, 3), "density": 0.1},
    {"resolution": (200, 1, 1)},
)
# Of cl/config.h and docs/numerics.md: what a hit needs, and more than any pad and rounding.
HIT_ERROR, WIDEST = 26 * U, 60 * U


def assert_sound(mesh: Mesh, layout: str, device: Device, **options: object) -> Nest:
    grid = build(mesh, layout, device=device, **options)  # type: ignore[arg-type]
    return assert_lists_hold_what_they_must(mesh, grid, HIT_ERROR, WIDEST)


@pytest.mark.thorough
@pytest.mark.parametrize("name", MESHES)
def test_cells_of_subgrids_hold_what_they_must(name: str, device: Device) -> None:
    for number, options in enumerate(OPTIONS):
        assert_sound(MESHES[name], LAYOUTS[number % 2], device, **options)


@pytest.mark.parametrize("resolution", [(4096, 1, 1), (1, 4096, 1), (1, 1, 4096)])
def test_cells_of_the_longest_top_grids(resolution: Resolution, device: Device) -> None:
    assert_sound(MESHES["box_in_planes"], "nested", device, resolution=resolution)


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    mesh=lattice_meshes(),
    resolution=st.tuples(*[st.integers(1, 9)] * 3),
    density=st.sampled_from([0.5, 4.0]),
    copies=st.sampled_from([1, 8]),
)
def test_lattice_meshes_in_nested_grids(
    mesh: Mesh, resolution: Resolution, density: float, copies: int, device: Device
) -> None:
    crowd = Mesh(mesh.vertices, np.tile(mesh.faces, (copies, 1)))
    assert_sound(crowd, "nested", device, resolution=resolution, density=density)


def test_both_layouts_hold_the_same_lists(device: Device) -> None:
    for name, mesh in MESHES.items():
        one, other = (build(mesh, layout, density=2, device=device) for layout in LAYOUTS)
        assert lists_of(one) == lists_of(other), name
        np.testing.assert_array_equal(subgrids_of(one), subgrids_of(other))


def test_cells_are_small_where_triangles_are(device: Device) -> None:
    """In subgrids of subgrids; and there are no subgrids where triangles are few."""
    nest = nest_of(build(MESHES["teapot"], "nested", device=device))
    assert nest.levels.max() == 2
    assert nest.size[nest.levels == 2].max() < nest.size[nest.levels == 0].min() / 32
    alone = nest_of(build(MESHES["one"], "nested", device=device))
    assert (alone.child < 0).all()


def test_a_finer_density_gives_more_cells(device: Device) -> None:
    cells = [
        build(MESHES["teapot"], "nested", density, device=device).stats.cells for density in (0.1, 0.5, 2, 30)
    ]
    assert cells == sorted(set(cells))


@pytest.mark.thorough
@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("density", [0.1, 0.5, 30])
@pytest.mark.parametrize("name", ["teapot", "huge_and_tiny", "flat", "one"])
def test_bytes_are_those_of_the_arrays_and_of_the_prediction(
    name: str, density: float, layout: str, device: Device
) -> None:
    mesh = MESHES[name]
    grid = build(mesh, layout, density, device=device)
    lists, nbytes = grid.parts[0].lists, grid.stats.nbytes
    assert predict(mesh, layout, density, device=device) == nbytes
    assert [buffer.size for buffer in lists.buffers] == list(nbytes.values())
    assert grid.nbytes == sum(nbytes.values()) <= grid.peak_nbytes
    assert nbytes["references"] == 4 * grid.stats.references
    if layout == "nested":
        assert nbytes["cells"] == 4 * (grid.stats.cells + 1)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_memory_of_nested_grids_is_refused_with_the_number(layout: str, device: Device) -> None:
    mesh = MESHES["thick_clusters"]
    needed = build(mesh, layout, device=device).nbytes
    assert build(mesh, layout, device=device, max_memory=needed).nbytes == needed
    for ask_for in (build, predict):
        with pytest.raises(GridTooLargeError, match=f"needs {needed:,} bytes, more than .* {needed - 1:,}"):
            ask_for(mesh, layout, device=device, max_memory=needed - 1)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_nested_grids_refuse_skipping(layout: str, device: Device) -> None:
    for ask_for in (build, predict):
        with pytest.raises(InputError, match=f"skipping .*{layout}") as caught:
            ask_for(MESHES["one"], layout, skipping=True, device=device)
        assert "\n" not in str(caught.value)
    assert not build(MESHES["one"], layout, skipping="auto", device=device).skipping


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_mesh_without_triangles_has_an_empty_nested_grid(layout: str, device: Device) -> None:
    nothing = Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint32))
    grid = build(nothing, layout, device=device)
    assert (grid.nbytes, predict(nothing, layout, device=device)) == (0, {})
    assert not grid.cast((0, 0, 0), (0, 0, 1)).mask


def digest(grid: Grid) -> str:
    """Of all arrays of all parts."""
    whole = hashlib.sha256()
    for number in range(len(grid.parts)):
        for array in (*grid.arrays(number).values(), subgrids_of(grid, number)):
            whole.update(array.tobytes())
    return whole.hexdigest()


@pytest.mark.parametrize("layout", LAYOUTS)
def test_updates_of_nested_grids_give_what_builds_give(layout: str, device: Device) -> None:
    """The crowd moves, grows and falls apart; the number of subgrids with it."""
    mesh = teapot((0.3, -0.2, 0.1), 3)
    grid, seen = build(mesh, layout, device=device), set()
    for frame in range(4):
        vertices = mesh.vertices.copy()
        vertices[8:] = 0.1 * frame + (vertices[8:] - 0.3) * np.float32(20.0 ** (frame - 1))
        grid.update(vertices)
        built = build(Mesh(vertices, mesh.faces), layout, device=device)
        assert digest(grid) == digest(built)
        assert grid.stats.nbytes == built.stats.nbytes
        rays = query(*mixed(grid.mesh, (5, 4, 6), 260, frame))
        assert_same(grid.cast(*rays), built.cast(*rays))
        seen.add(len(subgrids_of(grid)))
    assert len(seen) > 1


@pytest.mark.thorough
@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("largest", [60_000, 25_000])
def test_nested_grids_in_parts_change_no_query(
    largest: int, layout: str, device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    mesh = teapot((0.3, -0.2, 0.1))
    # Copies: a hit in a later part that is as near loses.
    mesh = Mesh(mesh.vertices, np.concatenate([mesh.faces, mesh.faces[::3]]))
    rays = query(*aimed(mesh, (7, 7, 7), 1300, 5))
    whole = ask(build(mesh, resolution=(1, 1, 1), device=device), rays)
    with monkeypatch.context() as patch:
        limit(patch, largest)
        grid = build(mesh, layout, device=device)
    assert grid.stats.parts > 1
    assert all(size <= largest for part in grid.parts for size in part.lists.nbytes.values())
    split = ask(grid, rays)
    assert_same(split.hits, whole.hits)
    assert_same(split.every, whole.every)
    camera = clgrid.Camera.look_at((0.3, -0.2, 0.9), (0.3, -0.2, 0.1), fov=0.3)
    drawn, expected = (
        clgrid.render(mesh, camera, 40, 30, ("depth", "id"), grid=each)
        for each in (grid, build(mesh, density=4, device=device))
    )
    np.testing.assert_array_equal(drawn.depth, expected.depth)
    np.testing.assert_array_equal(drawn.primitive_id, expected.primitive_id)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_bytes_of_nested_grids_are_equal_on_every_device_and_in_every_run(
    layout: str, all_devices: list[Device]
) -> None:
    for name in ("teapot", "huge_and_tiny", "slivers"):
        digests = {
            digest(build(MESHES[name], layout, device=device)) for device in all_devices for _ in range(2)
        }
        assert len(digests) == 1, name


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("size", [1, 24, 1000])
def test_lists_of_nested_grids_do_not_depend_on_chunks(
    layout: str, size: int, device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    """But for where the numbers of subgrids begin."""
    mesh = MESHES["huge_and_tiny"]
    expected = build(mesh, layout, device=device)
    monkeypatch.setattr(binning, "_LARGEST_CHUNK", size)
    found = build(mesh, layout, device=device)
    shift = int(params_of(found)["first_subgrid"]) - int(params_of(expected)["first_subgrid"])
    moved = [
        [one + shift if one >= mesh.triangle_count else one for one in cell] for cell in lists_of(expected)
    ]
    assert lists_of(found) == moved
    np.testing.assert_array_equal(subgrids_of(found), subgrids_of(expected))


def test_top_resolutions_beyond_what_floats_can_number_are_cut(device: Device) -> None:
    mesh = procedural.icosphere(2)
    for asked, got in (((9000, 2, 1), (4096, 2, 1)), ((1, 1, 5000), (1, 1, 4096)), ((3, 4, 5), (3, 4, 5))):
        assert build(mesh, "nested", resolution=asked, device=device).stats.resolution == got
    assert build(mesh, "nested", device=device).stats.resolution == default_top(mesh)
