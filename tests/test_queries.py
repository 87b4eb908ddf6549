"""Occlusion, counts and all hits: consistent with the closest hit, on every rung, for any number of hits."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from adversarial import structured
from agreement import (
    ALL,
    RUNGS,
    Query,
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
from meshes import MESHES, soup
from rays import mixed
from test_layouts import limit

from clgrid import cast_all, procedural
from clgrid.brute import brute_force, brute_force_count
from clgrid.device import Device
from clgrid.errors import InputError
from clgrid.grid import Grid, build
from clgrid.mesh import Mesh
from clgrid.rational import Triangles, plane_t

NOTHING = Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint32))
GRIDS: list[dict[str, Any]] = [{"density": 4}, {"layout": "hashed", "skipping": True, "density": 30}]


@pytest.mark.parametrize("accuracy", RUNGS)
def test_queries_agree(accuracy: str, device: Device) -> None:
    mesh = MESHES["torus"]
    rays = query(*mixed(mesh, (5, 4, 6), 1000, 1))
    counts = ask(build(mesh, density=4, accuracy=accuracy, device=device), rays).counts
    assert counts.max() >= 2
    np.testing.assert_array_equal(counts, brute_force_count(mesh, *rays, device=device, accuracy=accuracy))


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize("accuracy", RUNGS)
@pytest.mark.parametrize(
    "name", ["ball", "stacks", "torus", "edge_on_slivers", "soup", "flat", "one", "far_float64"]
)
def test_queries_agree_in_every_interval(name: str, accuracy: str, device: Device) -> None:
    """Bounds at hits and one double on either side: scalar and by ray, alone and together."""
    mesh = MESHES[name]
    o, d, *_ = query(*structured(mesh, 520, 2))
    grid = build(mesh, density=4, accuracy=accuracy, device=device)
    every = grid.cast_all(o, d, -np.inf, np.inf)
    middle = np.ones(len(o))
    first = every.ray_splits[:-1] + every.counts // 2
    middle[every.counts > 0] = every.t_hit[first[every.counts > 0]]
    after, before = np.nextafter(middle, np.inf), np.nextafter(middle, -np.inf)
    for low, high in (
        (middle, np.inf),
        (after, np.inf),
        (-np.inf, middle),
        (-np.inf, before),
        (middle, middle),
        (after, before),
    ):
        rays = part(query(o, d, low, high), slice(None, None, 2))
        found = assert_lossless(mesh, device, accuracy, rays, GRIDS).every
        lows, highs = rays[2][found.ray_ids], rays[3][found.ray_ids]
        assert ((found.t_hit >= lows) & (found.t_hit <= highs)).all()
    if name not in ("line", "flat"):
        assert every.counts.max() > 1 or name == "one"


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize("accuracy", RUNGS)
def test_a_scalar_interval_is_that_of_each_ray(accuracy: str, device: Device) -> None:
    mesh = MESHES["soup"]
    o, d, *_ = query(*mixed(mesh, (5, 4, 6), 1300, 3))
    grid = build(mesh, density=4, accuracy=accuracy, device=device)
    for low, high in ((0.0, np.inf), (0.25, 1.5), (-np.inf, 0.0), (2.0, 1.0)):
        rows = ask(grid, query(o, d, low, high))
        assert_same(grid.cast(o, d, low, high, fields=fields_of(accuracy)), rows.hits)
        np.testing.assert_array_equal(grid.count(o, d, low, high), rows.counts)
        np.testing.assert_array_equal(grid.occluded(o, d, low, high), rows.counts > 0)
        assert_same(grid.cast_all(o, d, low, high, fields=ALL), rows.every)


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize("accuracy", RUNGS)
def test_float32_rays_are_the_same_rays(accuracy: str, device: Device) -> None:
    mesh = MESHES["soup"]
    with np.errstate(under="ignore"):
        narrow = [side.astype(np.float32) for side in mixed(mesh, (5, 4, 6), 2600, 4)]
    grid = build(mesh, density=4, accuracy=accuracy, device=device)
    wide = ask(grid, query(*(side.astype(np.float64) for side in narrow)))
    found = ask(grid, query(*narrow))
    assert_same(found.hits, wide.hits)
    assert_same(found.every, wide.every)
    assert wide.counts.max() > 2


def stack(count: int, copies: bool = False) -> Mesh:
    """Triangles one above the other in z, or all in one place; ids are no order of height."""
    corners = np.tile(np.array([[-1.0, -1, 0], [3, -1, 0], [-1, 3, 0]]), (count, 1, 1))
    if not copies:
        corners[:, :, 2] = np.random.default_rng(5).permutation(count)[:, None] / 1024.0
    return soup(corners)


@pytest.mark.host
def test_where_all_hits_are(device: Device) -> None:
    mesh = Mesh(
        np.concatenate([MESHES["torus"].vertices, MESHES["torus"].vertices + np.float32(0.25)]),
        np.concatenate([MESHES["torus"].faces, MESHES["torus"].faces + len(MESHES["torus"].vertices)]),
        geometry_starts=np.array([0, MESHES["torus"].triangle_count, 2 * MESHES["torus"].triangle_count]),
        geometry_names=("one", "other"),
    )
    grid = build(mesh, density=4, device=device)
    o, d = mixed(mesh, (5, 4, 6), 600, 1)[:2]
    o, d = (np.asarray(each, np.float32).reshape(-1, 3)[:600].reshape(20, 30, 3) for each in (o, d))
    every, nearest = grid.cast_all(o, d), grid.cast(o, d)
    first = every.ray_splits[:-1][every.counts > 0]
    assert 0 < len(first) < len(every.t_hit)
    for name in ("geometry_ids", "primitive_normals", "points"):
        np.testing.assert_array_equal(every[name][first], nearest[name][nearest.mask])
    assert every.points.dtype == np.float64
    assert set(every.geometry_ids.tolist()) == {0, 1}
    along = every.points - o.reshape(-1, 3)[every.ray_ids]
    assert np.allclose(along, every.t_hit[:, None] * d.reshape(-1, 3)[every.ray_ids], atol=1e-6)
    nothing = build(NOTHING, device=device).cast_all(o, d)
    assert (nothing.points.shape, nothing.geometry_ids.shape) == ((0, 3), (0,))


@pytest.mark.host
def test_an_order_of_rays_changes_no_list(device: Device) -> None:
    """Rays are cast in tiles of neighbours, and hits of some want more room than there is at first."""
    mesh = stack(40)
    rng = np.random.default_rng(3)
    o, d = rng.uniform(-0.2, 0.2, (1000, 3)), rng.normal(size=(1000, 3))
    o[:, 2], d[:, 2] = -1, 8
    grid = build(mesh, resolution=(2, 2, 8), device=device)
    high = rng.uniform(0, 0.2, 1000)
    every = grid.cast_all(o, d, 0.0, high)
    assert every.counts.min() == 0
    assert (every.counts > cast_all._ROOM).any()
    shuffled = rng.permutation(1000)
    other = grid.cast_all(o[shuffled], d[shuffled], 0.0, high[shuffled])
    np.testing.assert_array_equal(other.counts, every.counts[shuffled])
    rows = np.concatenate([np.arange(every.ray_splits[i], every.ray_splits[i + 1]) for i in shuffled])
    for name in ("t_hit", "primitive_ids", "primitive_uvs"):
        assert other[name].tobytes() == every[name][rows].tobytes()


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize("accuracy", RUNGS)
@pytest.mark.parametrize("copies", [False, True])
def test_ten_thousand_hits_a_ray(copies: bool, accuracy: str, device: Device) -> None:
    """More than the room that each ray has at first; rays between them have none or few."""
    count = 10_000
    mesh = stack(count, copies)
    grid = build(mesh, resolution=(2, 2, 40), accuracy=accuracy, device=device)
    o = np.zeros((200, 3))
    o[:, 2] = -1
    o[::2, 0] = 100  # misses
    o[1::20, :2] = 0.1, 0.2
    ways = np.zeros((200, 3))
    ways[:, 2] = 1
    high = np.where(np.arange(200) % 20 == 1, np.inf, 0.5)
    high[3::40] = 1 + 100.5 / 1024
    answers = ask(grid, query(o, ways, 0.0, high))
    every = answers.every
    heights = mesh.vertices[::3, 2]
    full = np.argsort(heights, kind="stable")
    for ray in range(200):
        hits = slice(every.ray_splits[ray], every.ray_splits[ray + 1])
        expected = full if ray % 2 else full[:0]
        expected = expected[1 + heights[expected] <= high[ray]]
        np.testing.assert_array_equal(every.primitive_ids[hits], expected)
        np.testing.assert_allclose(every.t_hit[hits], 1.0 + heights[expected], rtol=0, atol=2e-6)
    assert answers.counts.max() == count


@pytest.mark.slow
@pytest.mark.thorough
def test_hits_beyond_the_largest_buffer_are_refused(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    grid = build(stack(2000, copies=True), resolution=(1, 1, 1), device=device)
    rays = query(np.tile([0.0, 0, -1], (64, 1)), (0, 0, 1))
    assert grid.cast_all(*rays).counts.tolist() == [2000] * 64
    monkeypatch.setattr(cast_all, "largest_buffer", lambda device: 100_000)
    with pytest.raises(InputError, match=r"128,000 hits at once exceed .*cast fewer rays"):
        grid.cast_all(*rays)
    assert grid.cast_all(*part(rays, slice(0, 2))).counts.tolist() == [2000] * 2


@pytest.mark.parametrize("accuracy", RUNGS)
def test_no_rays_and_no_triangles(accuracy: str, device: Device) -> None:
    grids = [build(mesh, accuracy=accuracy, device=device) for mesh in (NOTHING, procedural.cube())]
    for grid in grids:
        for shape in ((0, 3), (4, 0, 3)):
            none = np.zeros(shape)
            assert grid.count(none, none).shape == grid.occluded(none, none).shape == shape[:-1]
            every = grid.cast_all(none, none)
            assert every.ray_splits.tolist() == [0]
            assert every.t_hit.shape == every.primitive_ids.shape == (0,)
            assert every.primitive_uvs.shape == (0, 2)
        assert grid.count(none, none).dtype == np.uint32
        assert grid.occluded(none, none).dtype == np.bool_
    rays = np.zeros((3, 2, 3)), np.ones((3, 2, 3))
    rays[0][0, 0, 0] = np.nan
    empty = grids[0]
    assert not empty.occluded(*rays).any()
    assert empty.count(*rays).tolist() == [[0, 0]] * 3
    every = empty.cast_all(*rays, fields=ALL)
    assert every.ray_splits.tolist() == [0] * 7
    assert every.invalid_rays == 1
    assert not empty.contains(rays[0]).any()
    assert brute_force_count(NOTHING, *rays, device=device, accuracy=accuracy).tolist() == [[0, 0]] * 3


@pytest.mark.parametrize("accuracy", RUNGS)
def test_shapes_of_all_queries(accuracy: str, device: Device) -> None:
    grid = build(procedural.cube(), accuracy=accuracy, device=device)
    starts, ways = np.zeros((4, 1, 3)) + np.array([0.25, 0.5, 0.125]), np.eye(3)
    assert grid.count(starts, ways).tolist() == [[1] * 3] * 4
    assert grid.occluded(starts, ways).tolist() == [[True] * 3] * 4
    every = grid.cast_all(starts, ways)
    assert every.ray_splits.tolist() == list(range(13))
    assert every.ray_ids.tolist() == list(range(12))
    assert every["t_hit"].reshape(4, 3)[0].tolist() == [0.75, 0.5, 0.875]
    joined = np.concatenate(np.broadcast_arrays(starts, ways), axis=-1)
    assert grid.count(joined).shape == grid.occluded(joined).shape == (4, 3)
    assert_same(grid.cast_all(joined), every)
    assert grid.count((0.25, 0.5, 9), (0, 0, -1)).shape == ()
    assert grid.count((0.25, 0.5, 9), (0, 0, -1)) == 2
    assert bool(grid.occluded((0.25, 0.5, 9), (0, 0, -1), 0.0, 8.0))
    assert not grid.occluded((0.25, 0.5, 9), (0, 0, -1), 0.0, 7.0)
    assert grid.cast_all((0.25, 0.5, 9), (0, 0, -1)).t_hit.tolist() == [8, 10]
    low, high = [[0], [9]], [7.0, 8.0, 10.0]
    limits = grid.count(np.tile([0.25, 0.5, 9], (2, 3, 1)), (0, 0, -1), low, high)
    assert limits.tolist() == [[0, 1, 2], [0, 0, 1]]
    with pytest.raises(InputError, match=r"t_min \(2, 1\) and t_max \(3,\) do not broadcast to rays \(\)"):
        grid.count((0.25, 0.5, 9), (0, 0, -1), low, high)


BAD = [
    (lambda grid: grid.cast_all(np.zeros((4, 2)), np.zeros((4, 3))), r"origins have shape \(4, 2\)"),
    (lambda grid: grid.count(np.zeros((4, 3)), np.ones((5, 3))), "do not broadcast"),
    (lambda grid: grid.occluded(np.zeros((4, 3))), r"give \(..., 6\)"),
    (lambda grid: grid.count(np.zeros((4, 3)), np.ones((4, 3)), np.zeros(3)), r"t_min \(3,\)"),
    (lambda grid: grid.contains(np.zeros((4, 2))), r"\(4, 2\)"),
    (lambda grid: grid.cast_all((0, 0, 0), (0, 0, 1), fields=("certain",)), "certain"),
    (lambda grid: grid.cast_all((0, 0, 0), (0, 0, 1), fields=("steps",)), "unknown 'steps'"),
    (lambda grid: grid.cast((0, 0, 0), (0, 0, 1), fields=("uvs",)), "unknown 'uvs'; choose of t_hit"),
    (lambda grid: grid.cast((0, 0, 0), (0, 0, 1), fields="t_err"), r"give a sequence of names, \('t_err',\)"),
]  # fmt: skip


@pytest.mark.parametrize("number", range(len(BAD)))
def test_what_queries_refuse(number: int, device: Device) -> None:
    ask_for, message = BAD[number]
    for mesh in (procedural.cube(), NOTHING):
        with pytest.raises(InputError, match=message):
            ask_for(build(mesh, accuracy="exact", device=device))


def test_only_what_was_asked_for_is_computed(device: Device) -> None:
    mesh, ray = procedural.cube(), ((0.25, 0.5, 9), (0, 0, -1))
    grid = build(mesh, device=device)
    bare = grid.cast(*ray, fields=())
    assert set(bare.computed) == set()
    assert (bare.t_hit, bool(bare.mask), bare.geometry_ids) == (8, True, 0)
    for name in ("primitive_uvs", "t_err", "certain", "steps"):
        with pytest.raises(InputError, match=f"{name} was not computed"):
            bare[name]
    assert set(grid.cast(*ray).computed) == {"primitive_uvs"}
    assert set(grid.cast(*ray, fields=("t_err", "t_hit", "mask")).computed) == {"t_err"}
    assert set(grid.cast(*ray, fields=("tests",)).computed) == {"steps", "tests", "batches"}
    with pytest.raises(InputError, match="of the rung exact, not of robust"):
        grid.cast(*ray, fields=("certain",))
    exact = build(mesh, accuracy="exact", device=device)
    assert set(exact.cast_all(*ray, fields=()).computed) == set()
    with pytest.raises(InputError, match="t_err was not computed"):
        exact.cast_all(*ray, fields=()).t_err  # noqa: B018
    with pytest.raises(KeyError):
        exact.cast_all(*ray)["certain"]


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize("accuracy", RUNGS)
def test_what_else_is_asked_for_changes_no_bit(accuracy: str, device: Device) -> None:
    mesh = MESHES["stacks"]
    rays = query(*structured(mesh, 520, 6))
    grid = build(mesh, density=4, accuracy=accuracy, device=device)
    whole = ask(grid, rays)
    for fields in ((), ("t_err",), ("primitive_uvs",), ("steps",), fields_of(accuracy)[-1:]):
        found_by = [grid.cast(*rays, fields=fields)]
        if fields != ("steps",):  # brute force makes none
            found_by.append(brute_force(mesh, *rays, device=device, accuracy=accuracy, fields=fields))
        for found in found_by:
            for name in ("t_hit", "primitive_ids", *(set(found.computed) & set(whole.hits.computed))):
                np.testing.assert_array_equal(bits(found[name]), bits(whole.hits[name]))
    for fields in ((), ("t_err",), ("primitive_uvs",)):
        every = grid.cast_all(*rays, fields=fields)
        for name in ("ray_splits", "t_hit", "primitive_ids", *fields):
            np.testing.assert_array_equal(bits(every[name]), bits(whole.every[name]))


def in_parts(
    mesh: Mesh, largest: int, accuracy: str, device: Device, monkeypatch: pytest.MonkeyPatch
) -> Grid:
    with monkeypatch.context() as patch:
        limit(patch, largest)
        grid = build(mesh, density=4, accuracy=accuracy, device=device)
    assert grid.stats.parts > 1
    return grid


def assert_parts_change_nothing(whole: Grid, split: Grid, rays: Query) -> None:
    one, many = ask(whole, rays), ask(split, rays)
    assert_same(many.hits, one.hits)
    np.testing.assert_array_equal(many.counts, one.counts)
    assert_same(many.every, one.every)


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize("accuracy", RUNGS)
@pytest.mark.parametrize("largest", [100_000, 12_000])
def test_parts_change_no_query(
    largest: int, accuracy: str, device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    ball = procedural.icosphere(4)
    whole = build(ball, density=4, accuracy=accuracy, device=device)
    split = in_parts(ball, largest, accuracy, device, monkeypatch)
    assert_parts_change_nothing(whole, split, query(*mixed(ball, (9, 9, 9), 2600, 7)))
    if accuracy == "exact":
        points = np.random.default_rng(8).uniform(-1, 1, (500, 3))
        np.testing.assert_array_equal(split.contains(points), whole.contains(points))


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize("accuracy", RUNGS)
def test_ties_between_parts_change_no_query(
    accuracy: str, device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every triangle of each part has a copy, or one in its plane, in each other part."""
    rng = np.random.default_rng(9)
    corners = rng.integers(-4, 5, (300, 3, 3)).astype(float)
    corners[:, :, 2] = rng.integers(-1, 2, (300, 1))
    mesh = soup(np.concatenate([corners, corners[:, [1, 2, 0]], corners[::-1], corners]))
    targets = rng.integers(-16, 17, (1500, 3)) / 8.0
    origins = rng.integers(-8, 9, (1500, 3)) * 1.0 + [0, 0, 20]
    rays = query(origins, targets - origins)
    whole = build(mesh, density=4, accuracy=accuracy, device=device)
    split = in_parts(mesh, 30_000, accuracy, device, monkeypatch)
    assert_parts_change_nothing(whole, split, rays)
    if accuracy == "exact":
        some = part(rays, slice(0, 200))
        assert_exact(ask(split, some), truth_of(Triangles.of_mesh(mesh), some), mesh, some)


def near_ties(count: int, seed: int) -> tuple[Mesh, Query]:
    """Triangles met at a slant, so that t is off by much, and others between t and what is computed.

    Of each ray one triangle is nearly edge-on, at a t known to some 1e-11; two more face it at exact t
    within that, on either side. All are small, and apart from those of other rays.
    """
    rng = np.random.default_rng(seed)
    slanted, facing, ways = [], [], []
    for number in range(count):
        x, y = 4.0 * (number % 16) + rng.random(), 4.0 * (number // 16) + rng.random()
        slope = 10.0 ** rng.uniform(4, 5.5)
        start = np.array([x, y, -32.0])
        corners = (
            start
            + [0, 0, 32]
            + rng.uniform(0.3, 1, (3, 1)) * np.array([[-1e-4, -1e-4, 0], [1e-4, -1e-4, 0], [0, 1e-4, 0]])
        )
        corners[:, 2] += slope * (corners[:, 0] - x) + 0.3 * slope * (corners[:, 1] - y)
        slanted.append(corners)
        exact = plane_t(corners, start, (0.0, 0.0, 1.0))
        assert exact is not None
        off = 10.0 ** rng.uniform(-13, -10)
        for share in (-1.0, -0.3, 0.3, 1.0):
            height = float(exact + Fraction(off * share)) - 32.0
            flat = np.array([[x - 1, y - 1, height], [x + 1, y - 1, height], [x, y + 1, height]])
            facing.append(flat)
        ways.append(start)
    first, second = np.array(facing[::2]), np.array(facing[1::2])
    mesh = soup(np.concatenate([first, np.array(slanted), second]), np.float64)
    return mesh, query(np.array(ways), (0.0, 0.0, 1.0))


@pytest.mark.slow
@pytest.mark.thorough
def test_near_ties_are_in_exact_order(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where the triangles are in different parts, whose hits the host sorts."""
    mesh, rays = near_ties(200, 10)
    truth = truth_of(Triangles.of_mesh(mesh), rays)
    assert np.mean([len(row) for row in truth]) > 4
    whole = build(mesh, density=4, accuracy="exact", device=device)
    assert_exact(ask(whole, rays), truth, mesh, rays)
    split = in_parts(mesh, 15_000, "exact", device, monkeypatch)
    assert_exact(ask(split, rays), truth, mesh, rays)
    assert_parts_change_nothing(whole, split, rays)
