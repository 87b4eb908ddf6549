"""The compact grid: what each cell holds, its bytes, for any number of threads and any device, its limits."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from cell_lists import lists_of
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from meshes import soup
from oracle import U, exact_lists, local_mesh, touched_lists
from rays import lattice_meshes
from scenes import scene

import clgrid
from clgrid import memory, procedural
from clgrid.device import Device
from clgrid.errors import BufferTooLargeError, GridTooLargeError, InputError
from clgrid.grid import Grid, build
from clgrid.layouts.planes import plane_params
from clgrid.memory import Allocator
from clgrid.mesh import Mesh
from clgrid.resolution import MOST_CELLS

# Of cl/config.h and docs/numerics.md.
HIT_ERROR, BOX_PAD, CELL_RANGE_ROUNDING = 26 * U, 40 * U, 8 * U
CLIP_ROUNDING = 2.0**-40
CLIP_CELLS = 32
Resolution = tuple[int, int, int]


def large(params: np.void, mesh: Mesh, vertices: np.ndarray, pad: float) -> np.ndarray:
    """(F,) bool: whether a triangle's box is cut to the cells that it touches (CLIP_CELLS in cl/config.h)."""
    corners, cells = vertices[mesh.faces].astype(np.float64), params["resolution"].astype(np.int64)
    first = (corners.min(axis=1) - pad - params["lower"]) / params["cell_size"]
    last = (corners.max(axis=1) + pad - params["lower"]) / params["cell_size"]
    extent = np.minimum(last.astype(np.int64), cells - 1) - first.astype(np.int64) + 1
    return (extent.prod(axis=1) > CLIP_CELLS) & ((extent > 1).sum(axis=1) > 1)


def by_triangle(lists: list[list[int]], count: int) -> list[set[int]]:
    """The cells of each triangle."""
    cells: list[set[int]] = [set() for _ in range(count)]
    for cell, held in enumerate(lists):
        for triangle in held:
            cells[triangle].add(cell)
    return cells


Cells = tuple[set[int], set[int], set[int], set[int], set[int], bool, bool]
_EXPECTED: dict[tuple[int, Resolution], tuple[Mesh, list[Cells]]] = {}


def expected_cells(mesh: Mesh, resolution: Resolution) -> list[Cells]:
    """What is known of each triangle's cells, computed once a mesh.

    The cells of its box at both ends of the rounding, those within HIT_ERROR of it, those it touches at both
    ends of the rounding, and whether it is surely or possibly cut.
    """
    key = id(mesh), resolution
    if key not in _EXPECTED:
        frame, vertices = local_mesh(mesh)
        bounds = frame.to_local(mesh.bounds).astype(np.float64)
        params = plane_params(bounds, resolution, mesh.triangle_count)
        arguments = (vertices, mesh.faces, params, resolution)
        tight, wide = BOX_PAD - CELL_RANGE_ROUNDING, BOX_PAD + CELL_RANGE_ROUNDING
        lists = [
            exact_lists(*arguments, tight),
            exact_lists(*arguments, wide),
            touched_lists(*arguments, HIT_ERROR),
            touched_lists(*arguments, BOX_PAD - CLIP_ROUNDING),
            touched_lists(*arguments, BOX_PAD + CLIP_ROUNDING),
        ]
        cut = large(params, mesh, vertices, tight), large(params, mesh, vertices, wide)
        cells = zip(*(by_triangle(each, mesh.triangle_count) for each in lists), *cut, strict=True)
        _EXPECTED[key] = mesh, list(cells)
    return _EXPECTED[key][1]


def assert_cells_hold_what_they_must(mesh: Mesh, resolution: Resolution, device: Device) -> None:
    """Every list holds all that a hit may need, and nothing beyond the pad and its rounding."""
    grid = build(mesh, resolution=resolution, device=device)
    entered = by_triangle(lists_of(grid), mesh.triangle_count)
    for found, (box, wide_box, must, touched, wide_touched, surely_cut, maybe_cut) in zip(
        entered, expected_cells(mesh, resolution), strict=True
    ):
        assert must <= found
        assert touched & box <= found <= wide_box
        if surely_cut:
            assert found <= wide_touched
        if not maybe_cut:
            assert box <= found


def near_planes(resolution: Resolution) -> Mesh:
    """Tiny triangles around every plane crossing of the diagonal, at distances around the pad."""
    anchors = np.array([[[-0.99, -0.98, -0.97]] * 3, [[0.99, 0.93, 0.96]] * 3])
    params = plane_params(anchors[:, 0].astype(np.float32).astype(np.float64), resolution, 1)
    offsets = np.arange(-56, 57, 4) * U
    corners = []
    for axis in range(3):
        for k in range(1, resolution[axis]):
            point = np.zeros((len(offsets), 3))
            point[:, axis] = params["lower"][axis] + k * params["cell_size"][axis] + offsets
            corners.append(np.repeat(point[:, None], 3, axis=1))
    return soup(np.concatenate([anchors, *corners]))


def walls() -> np.ndarray:
    """Triangles across many cells: in planes of the axes, on the diagonals, needles, and in between."""
    rng = np.random.default_rng(8)
    flat = rng.uniform(-1, 1, (9, 3, 3))
    for axis in range(3):
        flat[3 * axis : 3 * axis + 3, :, axis] = flat[3 * axis : 3 * axis + 3, :1, axis]
    corners = np.array([[[-1, -1, -1], [1, 1, 1], [-1, 1, 1]], [[1, -1, -1], [-1, 1, 1], [-1, 1, 0.99]]])
    needles = rng.uniform(-1, 1, (6, 1, 3)) + np.array([0, 1e-6, 1])[:, None] * rng.uniform(-1, 1, (6, 1, 3))
    return np.concatenate([flat, corners, needles, rng.uniform(-1, 1, (10, 3, 3))])


def meshes() -> dict[str, Mesh]:
    rng = np.random.default_rng(3)
    ball = procedural.icosphere(2)
    along = rng.uniform(-1, 1, (20, 1, 1)) + np.array([0, 0.3, 0.5])[None, :, None]
    return {
        "ball": ball,
        "soup": soup(rng.uniform(-1, 1, (40, 1, 3)) + 0.3 * rng.normal(size=(40, 3, 3))),
        "cube": procedural.cube(),
        "lattice": Mesh((np.rint(ball.vertices * 4) / 4).astype(np.float32), ball.faces),
        "flat": soup(rng.uniform(-1, 1, (30, 3, 3)) * (1, 1, 0)),
        "flat_off_origin": soup(rng.uniform(-1, 1, (30, 3, 3)) * (1, 0, 1) + (0, 7, 0)),
        "collinear": soup(along * (1.0, 0.5, -0.25)),
        "collinear_on_axis": soup(along * (0.0, 1.0, 0.0)),
        "point": soup(np.full((3, 3, 3), 0.25)),
        "origin": soup(np.zeros((2, 3, 3))),
        "one": soup(np.eye(3)[None]),
        "near_planes": near_planes((7, 4, 3)),
        "walls": soup(walls()),
        "far": Mesh((ball.vertices + np.float32(3e6)).astype(np.float32), ball.faces),
        "tiny": Mesh((ball.vertices * np.float32(1e-30)).astype(np.float32), ball.faces),
        "huge": Mesh((ball.vertices * np.float32(1e30)).astype(np.float32), ball.faces),
    }


MESHES = meshes()


@pytest.mark.thorough
@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("resolution", [(1, 1, 1), (7, 4, 3), (2, 13, 5), (9, 8, 10)])
def test_cells_hold_what_they_must(name: str, resolution: Resolution, device: Device) -> None:
    assert_cells_hold_what_they_must(MESHES[name], resolution, device)


@pytest.mark.parametrize(
    "resolution", [(3000, 1, 1), (1, 3000, 1), (1, 1, 1100), (2500, 2, 1), (2, 2, 1030), (2047, 2, 2)]
)
def test_triangles_longer_than_a_packed_range(resolution: Resolution, device: Device) -> None:
    corners = np.array([[[-1, -1, -1], [1, 1, 1], [-1, 1, 1]], [[-1, -1, -1], [-0.9, -1, 1], [-0.95, 1, 0]]])
    assert_cells_hold_what_they_must(soup(corners), resolution, device)


@pytest.mark.parametrize("extent", [2046, 2047, 2048, 2049])
def test_ranges_at_the_limit_of_their_bits(extent: int, device: Device) -> None:
    mesh = soup(np.array([[[-1, -1, -1], [1, 1, 1], [-1, 1, 1]]]))
    for resolution in ((extent, 1, 1), (1, extent, 1), (1, 1, extent // 2)):
        grid = build(mesh, resolution=resolution, device=device)
        assert all(cell == [0] for cell in lists_of(grid))
    assert_cells_hold_what_they_must(mesh, (extent, 2, 1), device)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(mesh=lattice_meshes(), resolution=st.tuples(*[st.integers(1, 9)] * 3))
def test_lattice_meshes_in_any_resolution(mesh: Mesh, resolution: Resolution, device: Device) -> None:
    assert_cells_hold_what_they_must(mesh, resolution, device)


def test_the_pad_is_needed_and_no_wider_than_said(device: Device) -> None:
    """The mesh of the test above has triangles on both sides of both tolerances."""
    mesh, resolution = MESHES["near_planes"], (7, 4, 3)
    frame, vertices = local_mesh(mesh)
    params = plane_params(frame.to_local(mesh.bounds).astype(np.float64), resolution, mesh.triangle_count)
    found = build(mesh, resolution=resolution, device=device).stats.references
    counts = [
        sum(map(len, exact_lists(vertices, mesh.faces, params, resolution, pad)))
        for pad in (0.0, HIT_ERROR, BOX_PAD - CELL_RANGE_ROUNDING, BOX_PAD + CELL_RANGE_ROUNDING, 60 * U)
    ]
    assert counts[0] < counts[1] < counts[2] < found < counts[3] < counts[4]


@pytest.mark.parametrize("name", ["ball", "flat", "collinear", "one", "point"])
@pytest.mark.parametrize("density", [0.5, 4, 30])
def test_bytes_are_one_index_a_cell_and_one_a_reference(name: str, density: float, device: Device) -> None:
    grid = build(MESHES[name], density=density, device=device)
    stats, buffers = grid.stats, grid.parts[0].lists.buffers
    assert stats.nbytes == {"cells": 4 * (stats.cells + 1), "references": 4 * stats.references}
    assert [buffer.size for buffer in buffers] == list(stats.nbytes.values())
    assert grid.nbytes == sum(stats.nbytes.values()) == sum(a.nbytes for a in grid.arrays().values())
    assert stats.cells == np.prod(stats.resolution)
    assert stats.density == stats.cells / stats.triangles
    assert grid.peak_nbytes == stats.peak_nbytes >= grid.nbytes
    assert stats.empty_share == sum(not cell for cell in lists_of(grid)) / stats.cells
    assert set(stats.build_s) == {"count", "scan", "bin", "insert"}
    assert all(seconds >= 0 for seconds in stats.build_s.values())


def test_density_and_resolution_are_obeyed(device: Device) -> None:
    ball = procedural.icosphere(4)
    assert build(ball, resolution=(3, 5, 7), device=device).stats.resolution == (3, 5, 7)
    for density in (0.5, 4, 30):
        assert build(ball, density=density, device=device).stats.density == pytest.approx(density, rel=0.1)
    flat = build(MESHES["flat"], density=30, device=device).stats
    assert flat.resolution[2] == 1
    assert flat.density == pytest.approx(30, rel=0.1)
    line = build(MESHES["collinear_on_axis"], density=30, device=device).stats
    assert line.resolution == (1, 30 * line.triangles, 1)


def test_an_empty_mesh_has_an_empty_grid(device: Device) -> None:
    grid = build(Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint32)), device=device)
    assert grid.empty
    assert (grid.nbytes, grid.peak_nbytes, grid.stats.cells, grid.stats.references) == (0, 0, 0, 0)
    hits = grid.cast(np.zeros((4, 3)), [(0, 0, 1), (0, 0, 0), (np.nan, 0, 1), (0, 1, 0)])
    assert not hits.mask.any()
    assert hits.invalid_rays == 2
    with pytest.raises(InputError, match="no triangles"):
        grid.arrays()


def test_memory_is_predicted_and_refused_with_the_number(device: Device) -> None:
    ball = procedural.icosphere(4)
    needed = build(ball, density=4, device=device).nbytes
    assert build(ball, density=4, device=device, max_memory=needed).nbytes == needed
    with pytest.raises(GridTooLargeError, match=f"needs {needed:,} bytes, more than .* {needed - 1:,}"):
        build(ball, density=4, device=device, max_memory=needed - 1)
    # Cells alone are refused before anything is counted.
    with pytest.raises(GridTooLargeError, match="a grid of 500x500x500 cells needs 500,000,004 bytes"):
        build(ball, density=4, device=device, resolution=(500, 500, 500), max_memory=10**8)


def test_what_the_device_cannot_hold_is_refused(device: Device) -> None:
    layers = device.description.max_allocation // (4 << 20) + 1
    if layers << 20 > MOST_CELLS:
        pytest.skip("this device holds every grid that 32 bits can number")
    with pytest.raises(
        GridTooLargeError, match=r"bytes, more than the device's largest allocation of [\d,]+"
    ):
        build(procedural.cube(), device=device, resolution=(1024, 1024, layers))


def test_what_the_build_holds_for_a_while_is_counted() -> None:
    small = SimpleNamespace(cl_device=SimpleNamespace(global_mem_size=100, max_mem_alloc_size=60))
    allocator = Allocator(small)  # type: ignore[arg-type]
    allocator.check(70, "a grid", largest=60, transient=30)
    with pytest.raises(
        GridTooLargeError, match="a grid needs 101 bytes, more than the device's memory of 100"
    ):
        allocator.check(70, "a grid", largest=60, transient=31)
    with pytest.raises(GridTooLargeError, match="needs 61 bytes, more than the device's largest allocation"):
        allocator.check(70, "a grid", largest=61)


def test_a_buffer_that_the_driver_refuses_is_an_error_of_the_grid(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(BufferTooLargeError, match="an array of 1,152,921,504,606,846,976 bytes exceeds"):
        Allocator(device).buffer(1 << 60)
    monkeypatch.setattr(memory, "largest_buffer", lambda device: 1 << 62)
    with pytest.raises(GridTooLargeError, match="no room for 1,152,921,504,606,846,976 bytes"):
        Allocator(device).buffer(1 << 60)


def test_references_beyond_32_bits_are_refused(device: Device) -> None:
    """Many triangles across all cells of a line but the outermost: counted exactly and never written."""
    whole = np.array([[-1, -1, -1], [1, 1, 1], [-1, 1, 1]], np.float32)
    mesh = soup(np.repeat(whole[None], 20_000, axis=0))
    with pytest.raises(GridTooLargeError, match=r"19,999,920,000 references needs 79,999,680,000 bytes"):
        build(mesh, device=device, resolution=(1_000_000, 1, 1))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"layout": "octree"}, "layout is 'octree'; choose one of compact, hashed"),
        ({"accuracy": "sloppy"}, "accuracy is 'sloppy'"),
        ({"density": "high"}, "density is 'high'"),
        ({"density": 0}, "density is 0"),
        ({"density": float("nan")}, "density is nan"),
        ({"resolution": (0, 1, 1)}, "three whole numbers"),
        ({"resolution": (1, 2)}, "three whole numbers"),
    ],
)
def test_bad_options_are_refused(options: dict[str, object], message: str, device: Device) -> None:
    with pytest.raises(InputError, match=message):
        build(procedural.cube(), device=device, **options)  # type: ignore[arg-type]


def digest(grid: Grid) -> str:
    return hashlib.sha256(b"".join(array.tobytes() for array in grid.arrays().values())).hexdigest()


# About 80,000 triangles in 20 chunks and 64 slabs, so that threads have something to disagree on.
MANY = "icosphere:6"


def test_bytes_are_equal_on_every_device(all_devices: list[Device]) -> None:
    mesh = procedural.make(MANY)
    digests = {digest(build(mesh, density=4, device=device)) for device in all_devices}
    assert len(digests) == 1


def test_bytes_are_equal_in_every_run(device: Device) -> None:
    mesh = procedural.make(MANY)
    assert len({digest(build(mesh, density=4, device=device)) for _ in range(3)}) == 1


CHILD = """
import os, sys
if sys.argv[1] == "1":
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
import clgrid, test_grid
from clgrid import memory, procedural
print(test_grid.digest(clgrid.build(procedural.make(test_grid.MANY), density=4)))
"""


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="threads are limited by affinity")
def test_bytes_are_equal_for_one_thread_and_two(device: Device) -> None:
    here = Path(__file__).parent
    digests = set()
    for threads in ("1", "2"):
        environment = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join([str(here), str(here.parent), *sys.path]),
            "CLGRID_DEVICE": device.label,
            "POCL_MAX_PTHREAD_COUNT": threads,
            "CL_CONFIG_CPU_TBB_NUM_WORKERS": threads,
        }
        child = subprocess.run(
            [sys.executable, "-c", CHILD, threads],
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        assert child.returncode == 0, child.stderr
        digests.add(child.stdout.strip())
    assert digests == {digest(build(procedural.make(MANY), density=4, device=device))}


def test_a_million_copies_of_one_triangle(device: Device) -> None:
    mesh = Mesh(np.eye(3, dtype=np.float32), np.tile(np.arange(3, dtype=np.uint32), (1_000_000, 1)))
    grid = build(mesh, resolution=(2, 2, 2), device=device)
    cells, references = grid.arrays().values()
    assert (np.diff(cells.astype(np.int64)) == 1_000_000).all()
    assert (references.reshape(8, -1) == np.arange(1_000_000)).all()
    hits = grid.cast([(1, 1, 1), (2, 2, 2)], [(-1, -1, -1), (1, 1, 1)])
    assert hits.primitive_ids.tolist() == [0, -1]


REAL = [
    "scans/bunny_zipper.ply",
    "cad/fandisk.off",
    "arch/sponza_dabrovic.glb",
    "scans/dragon_vrip_res3.ply.gz",
]


@pytest.mark.parametrize("name", REAL)
def test_peak_is_at_most_three_grids(name: str, device: Device) -> None:
    mesh = clgrid.load(scene(name))
    for density in (0.5, 4, 30):
        grid = build(mesh, density=density, device=device)
        assert grid.nbytes < grid.peak_nbytes <= 3 * grid.nbytes
        cells, references = grid.arrays().values()
        first = np.zeros(len(references), bool)
        first[cells[:-1][cells[:-1] < cells[1:]]] = True
        assert (first[1:] | (references[1:] > references[:-1])).all()


def test_the_dragon_has_the_published_size(device: Device) -> None:
    """Lagae and Dutré, Figure 1: 21.9 MB for 871,414 triangles at four cells a triangle, in binary units."""
    grid = build(clgrid.load(scene("scans/dragon_vrip.ply.gz")), density=4, device=device)
    assert grid.stats.triangles == 871_414
    assert grid.nbytes / 2**20 == pytest.approx(21.9, rel=0.05)
    assert grid.peak_nbytes <= 3 * grid.nbytes
