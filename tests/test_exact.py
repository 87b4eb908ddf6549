"""The rung ``exact`` equals rational arithmetic; strict rungs have the same bits however they are asked."""

from __future__ import annotations

import functools
import hashlib
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from adversarial import CLOSED, FanScene, cases, fan_scene, inside_rays, structured
from agreement import (
    ALL,
    RUNGS,
    Answers,
    Errors,
    Query,
    Truth,
    ask,
    assert_exact,
    assert_lossless,
    assert_same,
    bits,
    fields_of,
    part,
    query,
    truth_of,
)  # fmt: skip
from hypothesis import HealthCheck, given, settings
from meshes import MESHES, soup

from clgrid import procedural
from clgrid.brute import brute_force, brute_force_count
from clgrid.device import Device
from clgrid.errors import InputError
from clgrid.grid import build
from clgrid.layouts import ALL_LAYOUTS
from clgrid.mesh import Mesh
from clgrid.rational import Triangles, crossings, inside, plane_t

F64 = npt.NDArray[np.float64]
Record = Callable[[str, object], None]

GRIDS: list[dict[str, Any]] = [
    {"density": 4},
    {"layout": "hashed", "skipping": True, "density": 30},
]


@functools.lru_cache(maxsize=16)
def fan_case(dtype: type, exponent: int, count: int, rays: int, seed: int) -> tuple[FanScene, Query, Truth]:
    """Fans, their rays and the truth, once for all devices."""
    fans = fan_scene(count, seed, rays, dtype, exponent)
    rows = query(fans.origins, fans.directions, 0.0, fans.t_max)
    return fans, rows, truth_of(Triangles.of_mesh(fans.mesh), rows)


def assert_fans_exact(
    dtype: type, exponent: int, count: int, rays: int, device: Device, record_property: Record
) -> Answers:
    fans, rows, truth = fan_case(dtype, exponent, count, rays, 11)
    grid = build(fans.mesh, density=4, accuracy="exact", device=device)
    answers = ask(grid, rows)
    errors = assert_exact(answers, truth, fans.mesh, rows)
    record_property("errors", errors.summary())
    assert_meaningful(errors)
    hits = answers.hits
    # Most rays are aimed at edges and vertices, and many of those hit.
    assert 0.3 < hits.mask.mean() < 0.8
    assert 0.1 < hits.certain[hits.mask].mean() < 0.9
    assert hits.invalid_rays == 0
    return answers


def assert_meaningful(errors: Errors, median: float = 3e-15, worst: float = 2e-9) -> None:
    """No error is so large that it says nothing: neither in the middle nor at the worst."""
    assert np.median(errors.relative) <= median, errors.summary()
    # A t that the filter knows worse than 2^-30 of the mesh is computed in integers.
    assert max(errors.relative) <= worst, errors.summary()


@pytest.mark.parametrize("dtype", [np.float32, pytest.param(np.float64, marks=pytest.mark.slow)])
def test_fans_equal_rational_arithmetic(dtype: type, device: Device, record_property: Record) -> None:
    assert_fans_exact(dtype, 0, 100, 12, device, record_property)


@pytest.mark.thorough
@pytest.mark.slow
@pytest.mark.parametrize(
    ("dtype", "exponent"),
    [
        (np.float32, 0), (np.float32, -110), (np.float32, 100),
        (np.float64, 0), (np.float64, -60), (np.float64, 200), (np.float64, -400), (np.float64, 700),
    ],
)  # fmt: skip
def test_100_000_fans_equal_rational_arithmetic(
    dtype: type, exponent: int, device: Device, record_property: Record
) -> None:
    answers = assert_fans_exact(dtype, exponent, 700, 19, device, record_property)
    fans, rows, _ = fan_case(dtype, exponent, 700, 19, 11)
    some = part(rows, slice(None, None, 8))
    found = brute_force(fans.mesh, *some, device=device, accuracy="exact", fields=fields_of("exact"))
    np.testing.assert_array_equal(bits(found.t_hit), bits(answers.hits.t_hit[::8]))
    np.testing.assert_array_equal(found.primitive_ids, answers.hits.primitive_ids[::8])
    counts = brute_force_count(fans.mesh, *some, device=device, accuracy="exact")
    np.testing.assert_array_equal(counts, answers.counts[::8])


Case = tuple[npt.NDArray[np.floating], F64, F64]


def beyond(corners: npt.NDArray[np.floating], direction: F64) -> bool:
    """Whether a coordinate of the mesh or t is beyond what is promised: 2^-1022 of the mesh, 2^960."""
    sizes = np.abs(corners[corners != 0].astype(np.float64))
    smallest, largest = (sizes.min(), sizes.max()) if len(sizes) else (1.0, 1.0)
    exponent = np.frexp(largest)[1]
    unit = int(exponent - np.frexp(np.abs(direction).max())[1])
    return abs(exponent) > 890 or np.frexp(smallest)[1] - exponent < -960 or abs(unit) > 900


@pytest.mark.slow
@pytest.mark.thorough
@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(case=cases())
def test_any_case_equals_rational_arithmetic(case: Case, device: Device) -> None:
    corners, origin, direction = case
    dtype = np.float32 if corners.dtype == np.float32 else np.float64
    if beyond(corners, direction):
        return
    mesh = soup(corners, dtype)
    rows = query([origin, origin], direction, [-np.inf, 0.0], np.inf)
    answers = assert_lossless(mesh, device, "exact", rows, [{"resolution": (3, 4, 2)}])
    assert_exact(answers, truth_of(Triangles.of_mesh(mesh), rows), mesh, rows)


def transformed(mesh: Mesh, points: F64, offset: float, scale: float) -> tuple[Mesh, F64]:
    """In float64, scaled, then moved."""
    way = offset * np.array([1, -0.75, 0.5])
    return Mesh(mesh.vertices.astype(np.float64) * scale + way, mesh.faces), points * scale + way


PLACES = [(0.0, 1.0), (1e3, 1.0), (1e5, 1.0), (1e9, 1.0), (0.0, 1e-20), (0.0, 1e20)]
CONVEX = ("tetrahedron", "cube", "icosphere")


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize(("offset", "scale"), PLACES)
@pytest.mark.parametrize("name", CLOSED)
def test_closed_meshes_have_no_escapes_and_no_wrong_parity(
    name: str, offset: float, scale: float, device: Device
) -> None:
    own, points = CLOSED[name]
    # The last point of a convex mesh is near its surface: far away, it may be rounded onto it.
    mesh, starts = transformed(own, np.array(points[:1]), offset, scale)
    grid = build(mesh, density=4, accuracy="exact", device=device)
    rays = query(*inside_rays(mesh, starts, 3000, 21))
    answers = ask(grid, rays)
    assert answers.hits.mask.all()
    assert (answers.counts % 2 == 1).all()
    if name in CONVEX:
        assert (answers.counts == 1).all()
    line = query(*structured(mesh, 1300, 22), -np.inf)
    assert (ask(grid, line).counts % 2 == 0).all()
    some = part(line, slice(0, 150))
    assert_exact(ask(grid, some), truth_of(Triangles.of_mesh(mesh), some), mesh, some)


def test_rays_out_of_a_closed_mesh_are_odd(device: Device) -> None:
    mesh, points = CLOSED["cubes touching"]
    grid = build(mesh, density=4, accuracy="exact", device=device)
    counts = grid.count(*query(*inside_rays(mesh, points, 3000, 23)))
    assert (counts % 2 == 1).all()
    assert grid.count(*query(*structured(mesh, 2000, 24), -np.inf)).max() >= 2


def surface_points(mesh: Mesh, count: int, seed: int) -> F64:
    """Vertices, points of edges and faces, these nudged to the next doubles, and points around."""
    rng = np.random.default_rng(seed)
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    a, b, c = np.moveaxis(corners[rng.integers(len(corners), size=count)], 1, 0)
    low, high = mesh.bounds
    around = low + rng.uniform(-0.2, 1.2, (count, 3)) * (high - low)
    choices = [a, a / 2 + b / 2, a / 4 + 0.75 * b, a / 2 + b / 4 + c / 4, around]
    points = np.choose(rng.integers(len(choices), size=(count, 1)), choices)
    nudged = np.nextafter(points, rng.choice((-np.inf, np.inf), size=points.shape))
    return np.where(rng.random(points.shape) < 0.15, nudged, points)


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize("name", CLOSED)
def test_contains_equals_rational_arithmetic(name: str, device: Device) -> None:
    """The truth counts along another direction: for a closed mesh all give the same answer."""
    mesh, starts = CLOSED[name]
    points = np.concatenate([surface_points(mesh, 900, 31), starts])
    prepared = Triangles.of_mesh(mesh)
    expected = [inside(prepared, point, (-0.25, 1.0, 0.5)) for point in points]
    grid = build(mesh, density=4, accuracy="exact", device=device)
    np.testing.assert_array_equal(grid.contains(points), expected)
    assert grid.contains(np.array(starts)).all()
    assert 50 < np.sum(expected) < len(points) - 50
    shaped = grid.contains(points[:12].reshape(3, 4, 3))
    np.testing.assert_array_equal(shaped, np.reshape(expected[:12], (3, 4)))


@pytest.mark.slow
@pytest.mark.thorough
def test_a_point_of_a_closed_surface_belongs_to_one_side(device: Device) -> None:
    """Cubes that fill space: each point of it, also of faces, edges and corners, is in just one of them."""
    rng = np.random.default_rng(32)
    points = rng.integers(0, 9, (2000, 3)) / 4.0
    total = np.zeros(len(points), int)
    for corner in np.ndindex(3, 3, 3):
        cube = Mesh(procedural.cube().vertices / 2 + np.float32(0.5) + np.array(corner, np.float32),
                    procedural.cube().faces)  # fmt: skip
        total += build(cube, density=4, accuracy="exact", device=device).contains(points)
    assert (total == 1).all()


def test_what_contains_refuses(device: Device) -> None:
    ball = procedural.icosphere(1)
    holed = Mesh(ball.vertices, ball.faces[1:])
    grid = build(holed, density=4, accuracy="exact", device=device)
    with pytest.raises(InputError, match="not closed, 3 edges"):
        grid.contains([(0.0, 0, 0)])
    assert grid.contains([(5.0, 0, 0), (np.nan, 0, 0)], require_closed=False).tolist() == [False, False]
    assert grid.contains((0.0, 0, 0), require_closed=False).shape == ()
    with pytest.raises(InputError, match=r"\(2,\)"):
        grid.contains([0.0, 0], require_closed=False)


def test_certain_is_who_decided(device: Device) -> None:
    """Not the filter at vertices and edges; the filter nearly always elsewhere."""
    ball = procedural.icosphere(2)
    grid = build(ball, density=4, accuracy="exact", device=device)
    corners = ball.vertices[ball.faces].astype(np.float64)
    # Doubles hold twice what a float32 is, and sums of two.
    for targets in (ball.vertices.astype(np.float64), corners[:, 0] + corners[:, 1]):
        hits = grid.cast(*query(np.zeros(3), targets), fields=fields_of("exact"))
        assert hits.mask.all()
        assert not hits.certain.any()
    rng = np.random.default_rng(33)
    anywhere = query(rng.uniform(-2, 2, (20_000, 3)), rng.normal(size=(20_000, 3)))
    hits = grid.cast(*anywhere, fields=fields_of("exact"))
    assert hits.mask.sum() > 1000
    assert hits.certain[~hits.mask].all(), "a miss is certain"
    assert hits.certain.mean() > 0.999


BIT_MESHES = ("torus", "stacks", "edge_on_slivers", "soup", "far_float64", "lattice_box")
EVERY_GRID: list[dict[str, Any]] = [
    *({"layout": layout, "density": 4} for layout in ALL_LAYOUTS),
    {"skipping": True, "density": 0.5},
    {"skipping": True, "density": 60, "layout": "hashed"},
    {"resolution": (1, 200, 2)},
]


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize("accuracy", RUNGS)
@pytest.mark.parametrize("name", BIT_MESHES)
def test_no_grid_changes_a_bit(name: str, accuracy: str, device: Device) -> None:
    mesh = MESHES[name]
    for low in (-np.inf, 0.0):
        rays = query(*structured(mesh, 400, 41), low)
        assert_lossless(mesh, device, accuracy, rays, EVERY_GRID)


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize("accuracy", RUNGS)
@pytest.mark.parametrize("name", BIT_MESHES)
def test_no_device_changes_a_bit(name: str, accuracy: str, all_devices: list[Device]) -> None:
    mesh = MESHES[name]
    rays = query(*structured(mesh, 1500, 42), -np.inf)
    first, *others = (ask(build(mesh, density=4, accuracy=accuracy, device=d), rays) for d in all_devices)
    for other in others:
        assert_same(other.hits, first.hits)
        assert_same(other.every, first.every)


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize("accuracy", RUNGS)
@pytest.mark.parametrize("name", BIT_MESHES)
def test_the_order_of_triangles_changes_ids_alone(name: str, accuracy: str, device: Device) -> None:
    """And, where several are as near, which of them is named."""
    mesh = MESHES[name]
    order = np.random.default_rng(43).permutation(mesh.triangle_count)
    mixed = Mesh(mesh.vertices, np.ascontiguousarray(mesh.faces[order]))
    rays = query(*structured(mesh, 1000, 43))
    plain, other = (ask(build(m, density=4, accuracy=accuracy, device=device), rays) for m in (mesh, mixed))
    np.testing.assert_array_equal(other.counts, plain.counts)
    mask, ids = plain.hits.mask, plain.hits.primitive_ids
    back = np.where(mask, order[other.hits.primitive_ids], -1)
    same = back == ids
    for name_ in ("t_hit", *fields_of(accuracy)):
        np.testing.assert_array_equal(bits(other.hits[name_][same]), bits(plain.hits[name_][same]))
    assert same.mean() > 0.5
    o, d, *_ = rays
    for ray in np.flatnonzero(~same):
        if accuracy == "exact":
            one, two = (plane_t(mesh.vertices[mesh.faces[i]], o[ray], d[ray]) for i in (ids[ray], back[ray]))
            assert one == two
        else:
            assert other.hits.t_hit[ray] == plain.hits.t_hit[ray]
    met = [
        np.lexsort([ids_, found.every.ray_ids])
        for found, ids_ in ((plain, plain.every.primitive_ids), (other, order[other.every.primitive_ids]))
    ]
    np.testing.assert_array_equal(plain.every.primitive_ids[met[0]], order[other.every.primitive_ids][met[1]])


def digest(device: Device | str) -> str:
    """Of all answers on all strict rungs."""
    whole = hashlib.sha256()
    for accuracy in RUNGS:
        mesh = MESHES["stacks"]
        rays = query(*structured(mesh, 1500, 44))
        answers = ask(build(mesh, density=4, accuracy=accuracy, device=device), rays)
        for found in (answers.hits, answers.every):
            for name in ("t_hit", "primitive_ids", *found.computed):
                whole.update(np.ascontiguousarray(found[name]).tobytes())
    return whole.hexdigest()


CHILD = """
import os, sys
if sys.argv[1] == "1":
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
import test_exact
print(test_exact.digest(sys.argv[2]))
"""


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="threads are limited by affinity")
def test_no_number_of_threads_changes_a_bit(device: Device) -> None:
    here = Path(__file__).parent
    digests = set()
    for threads in ("1", "2"):
        environment = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join([str(here), str(here.parent), *sys.path]),
            "POCL_MAX_PTHREAD_COUNT": threads,
            "CL_CONFIG_CPU_TBB_NUM_WORKERS": threads,
        }
        command = [sys.executable, "-c", CHILD, threads, device.label]
        child = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        assert child.returncode == 0, child.stderr
        digests.add(child.stdout.strip())
    assert digests == {digest(device)}


def test_exact_ties_go_to_the_lowest_id(device: Device) -> None:
    """Rays through the corner of a cube, along edges of stacked triangles, at coplanar overlaps."""
    rng = np.random.default_rng(45)
    flat = rng.integers(-4, 5, (120, 3, 3)).astype(float)
    flat[:, :, 2] = rng.integers(-1, 2, (120, 1))
    mesh = soup(flat)
    targets = rng.integers(-16, 17, (1500, 3)) / 8.0
    origins = rng.integers(-8, 9, (1500, 3)) * 1.0 + [0, 0, 20]
    rays = query(origins, targets - origins)
    answers = ask(build(mesh, density=4, accuracy="exact", device=device), rays)
    truth = truth_of(Triangles.of_mesh(mesh), rays)
    assert_exact(answers, truth, mesh, rays)
    ties = [len({crossing.t for crossing in row}) < len(row) for row in truth]
    assert np.mean(ties) > 0.3


def test_intervals_are_exact(device: Device) -> None:
    """Bounds exactly at a crossing, and the doubles on either side of it, t itself being none or any."""
    mesh = MESHES["stacks"]
    prepared, rng = Triangles.of_mesh(mesh), np.random.default_rng(46)
    o, d = rng.uniform(-2, 2, (150, 3)), rng.normal(size=(150, 3))
    o[::3, 2], d[::3] = 5.0, (0.0, 0.0, -1.0)
    rows, lows, highs = [], [], []
    for ray in range(len(o)):
        for crossing in crossings(prepared, o[ray], d[ray])[:3]:
            near = float(crossing.t)
            for bound in (np.nextafter(near, -np.inf), near, np.nextafter(near, np.inf)):
                rows += [ray, ray, ray]
                lows += [bound, -np.inf, bound]
                highs += [np.inf, bound, bound]
    rays = query(o[rows], d[rows], lows, highs)
    answers = ask(build(mesh, density=4, accuracy="exact", device=device), rays)
    truth = truth_of(prepared, rays)
    assert_exact(answers, truth, mesh, rays)
    assert any(row and len(row) == 1 and row[0].t == low == high
               for row, low, high in zip(truth, lows, highs, strict=True))  # fmt: skip
    # What is reported lies within the interval.
    every = answers.every
    low, high = rays[2][every.ray_ids], rays[3][every.ray_ids]
    assert ((every.t_hit >= low) & (every.t_hit <= high)).all()
    assert tuple(every.computed) == ALL
