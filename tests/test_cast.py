"""Casting: hits through the grid equal brute force bit for bit, nothing escapes, and the shapes fit."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from agreement import KINDS
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from meshes import CLOSED, MESHES, edge_on_slivers, scaled, soup, torus
from rays import FAMILIES, Rays, lattice_meshes, lattice_rays, mixed, surroundings
from scenes import scene

import clgrid
from clgrid import procedural
from clgrid.brute import brute_force
from clgrid.cast import NO_HIT, _signed
from clgrid.device import Device
from clgrid.errors import InputError
from clgrid.grid import build
from clgrid.hits import Hits
from clgrid.mesh import Mesh

Resolution = tuple[int, int, int]


def assert_same(found: Hits, expected: Hits) -> None:
    """Every bit of t, id, u and v."""
    np.testing.assert_array_equal(found.primitive_ids, expected.primitive_ids)
    np.testing.assert_array_equal(found.t_hit.view(np.uint64), expected.t_hit.view(np.uint64))
    np.testing.assert_array_equal(found.primitive_uvs.view(np.uint32), expected.primitive_uvs.view(np.uint32))
    assert found.invalid_rays == expected.invalid_rays


EVERY_GRID = [{"layout": layout, "skipping": skipping} for layout, skipping in KINDS]


def assert_lossless(
    mesh: Mesh, device: Device, count: int, seed: int, grids: list[dict[str, object]], **options: object
) -> Hits:
    """Hits of all the grids equal brute force on rays of all families; brute force's."""
    built = [build(mesh, device=device, **{**options, **own}) for own in grids]  # type: ignore[arg-type]
    rays = mixed(mesh, built[0].stats.resolution, count, seed)
    expected = brute_force(mesh, *rays, device=device)
    for grid in built:
        assert_same(grid.cast(*rays), expected)
    t = np.where(expected.mask, expected.t_hit, 1.0)
    after, before = np.nextafter(t, np.inf), np.nextafter(t, 0)
    for low, high in ((t, np.inf), (after, np.inf), (0.0, t), (0.0, before), (-np.inf, np.inf)):
        limits = (np.broadcast_to(side, t.shape) for side in (low, high))
        part = [side[::5] for side in (*rays, *limits)]
        within = brute_force(mesh, *part, device=device)
        for grid in built[:2]:
            assert_same(grid.cast(*part), within)
    return expected


@pytest.mark.thorough
@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize(
    ("density", "grids"),
    [
        (4, EVERY_GRID),
        (0.5, [{"layout": "linked-list"}]),
        (30, [{"layout": "hashed"}]),
        (200, [{"skipping": True}, {"layout": "dynamic-array"}]),
    ],
)
def test_the_grid_changes_no_answer(
    name: str, density: float, grids: list[dict[str, object]], device: Device
) -> None:
    hits = assert_lossless(MESHES[name], device, 5200, 1, grids, density=density)
    assert hits.mask.any() or name == "line"


@pytest.mark.thorough
@pytest.mark.parametrize(
    "resolution", [(1, 1, 1), (3000, 1, 1), (1, 2100, 3), (2, 1, 1100), (61, 7, 13)], ids=str
)
def test_odd_resolutions_change_no_answer(resolution: Resolution, device: Device) -> None:
    grids: list[dict[str, object]] = [{"layout": "compact"}, {"layout": "hashed", "skipping": True}]
    for name in ("torus", "edge_on_slivers", "stacks"):
        assert_lossless(MESHES[name], device, 1300, 2, grids, resolution=resolution)


def test_float32_rays_change_no_answer(device: Device) -> None:
    grid = build(MESHES["torus"], device=device)
    with np.errstate(under="ignore"):
        rays = [part.astype(np.float32) for part in mixed(MESHES["torus"], grid.stats.resolution, 13000, 3)]
    hits = grid.cast(*rays)
    assert_same(hits, brute_force(MESHES["torus"], *rays, device=device))
    assert hits.mask.any()


@settings(max_examples=80, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(mesh=lattice_meshes(), rays=lattice_rays(), resolution=st.tuples(*[st.integers(1, 9)] * 3))
def test_lattice_coincidences_change_no_answer(
    mesh: Mesh, rays: Rays, resolution: Resolution, device: Device
) -> None:
    assert_same(
        build(mesh, resolution=resolution, device=device).cast(*rays), brute_force(mesh, *rays, device=device)
    )


def test_hits_are_equal_on_every_device(all_devices: list[Device]) -> None:
    for name in ("torus", "edge_on_slivers", "stacks", "lattice_box"):
        rays = mixed(MESHES[name], (9, 9, 9), 13000, 4)
        first, *others = (build(MESHES[name], device=device).cast(*rays) for device in all_devices)
        for other in others:
            assert_same(other, first)


def test_slivers_seen_edge_on_are_found(device: Device) -> None:
    """Rays within the planes of slivers: hits lie anywhere along many cells."""
    rng = np.random.default_rng(6)
    for seed in range(4):
        mesh = edge_on_slivers(np.random.default_rng(seed))
        corners = mesh.vertices[mesh.faces].astype(np.float64)
        face, weights = rng.integers(len(corners), size=6000), rng.dirichlet([1, 1, 1], size=6000)
        eye = np.array([0.0, 0.0, 3.0]) + rng.choice([0.0, 1e-8, 1e-6], size=(6000, 1)) * rng.normal(
            size=(6000, 3)
        )
        rays = eye, (corners[face] * weights[:, :, None]).sum(axis=1) - eye
        expected = brute_force(mesh, *rays, device=device)
        assert expected.mask.mean() > 0.05
        for options in ({"resolution": (50, 50, 50)}, {"density": 4}, {"resolution": (1, 1, 700)}):
            assert_same(build(mesh, device=device, **options).cast(*rays), expected)  # type: ignore[arg-type]


def blocked_slivers(rng: np.random.Generator, count: int = 150) -> Mesh:
    """Slivers along a diagonal of the box, and small triangles that a wrong t of theirs would pass."""
    y, ends = rng.uniform(-1, 1, (count, 1)), rng.uniform(0.5, 1, (4, count, 1))
    a = np.concatenate([-ends[0], y, ends[1]], axis=1)
    b = np.concatenate([ends[2], y + rng.uniform(-0.1, 0.1, (count, 1)), -ends[3]], axis=1)
    thin = 10.0 ** rng.uniform(-8, -5, (count, 1)) * rng.normal(size=(count, 3))
    blocks = rng.uniform(-1, 1, (600, 1, 3)) + 0.1 * rng.normal(size=(600, 3, 3))
    slivers = np.stack([a, b, a + rng.random((count, 1)) * (b - a) + thin], axis=1)
    return soup(np.concatenate([slivers, np.clip(blocks, -1, 1)]))


def test_slivers_met_at_an_end_are_found_before_what_is_behind(device: Device) -> None:
    for seed in range(3):
        rng = np.random.default_rng(seed)
        mesh = blocked_slivers(rng)
        slivers = mesh.vertices[mesh.faces[:150]].astype(np.float64)
        face, weights = rng.integers(150, size=8000), rng.dirichlet([0.3, 0.3, 0.3], size=8000)
        targets = (slivers[face] * weights[:, :, None]).sum(axis=1)
        along = rng.uniform(-0.1, 0.1, (8000, 1)) * (slivers[face, 1] - slivers[face, 0])
        directions = (
            np.array([1, 0, 1]) * rng.choice([-1, 1], size=(8000, 1)) * rng.uniform(0.2, 1, (8000, 1)) + along
        )
        rays = targets - directions * rng.uniform(0.5, 1.5, (8000, 1)), directions
        expected = brute_force(mesh, *rays, device=device)
        assert ((expected.primitive_ids >= 0) & (expected.primitive_ids < 150)).mean() > 0.1
        assert_same(build(mesh, resolution=(20, 20, 20), device=device).cast(*rays), expected)


def inside_rays(mesh: Mesh, count: int, seed: int) -> Rays:
    """From near the centre of a star-shaped mesh, at all its vertices and edges, and along axes."""
    rng = np.random.default_rng(seed)
    around = surroundings(mesh, (4, 4, 4))
    middle = around.low / 2 + around.high / 2
    origins = middle + rng.uniform(-1e-6, 1e-6, (count, 3)) * (around.high - around.low)
    parts = [FAMILIES[name](around, count // 4, rng)[1] for name in ("along_axes", "random")]
    targets = [FAMILIES[name](around, count // 4, rng) for name in ("at_vertices", "at_edges")]
    aimed = [start + way for start, way in targets]
    directions = np.concatenate([*parts, *(end - middle for end in aimed)])
    return origins[: len(directions)], directions


@pytest.mark.thorough
@pytest.mark.parametrize("name", CLOSED)
def test_no_ray_escapes(name: str, device: Device) -> None:
    rays = inside_rays(MESHES[name], 12000, 7)
    for options in ({}, {"density": 30}, {"resolution": (8, 8, 8)}):
        hits = build(MESHES[name], device=device, **options).cast(*rays)  # type: ignore[arg-type]
        assert hits.mask.all()
        assert (hits.t_hit > 0).all()


@pytest.mark.thorough
def test_the_lowest_of_equal_triangles_wins(device: Device) -> None:
    ball = procedural.icosphere(2)
    faces = np.concatenate([ball.faces[::-1], ball.faces, ball.faces[:, [1, 2, 0]]])
    mesh = Mesh(ball.vertices, faces)
    count = len(ball.faces)
    hits = assert_lossless(mesh, device, 13000, 8, EVERY_GRID)
    ids = hits.primitive_ids[hits.mask]
    # The first copy of every triangle comes first; the third has other weights, so perhaps another t.
    assert (ids < count).mean() > 0.9
    assert not ((ids >= count) & (ids < 2 * count)).any()


def test_triangles_with_a_repeated_corner_change_nothing(device: Device) -> None:
    ball = procedural.icosphere(2)
    points = np.repeat(ball.faces[:, :1], 3, axis=1)
    lines = ball.faces[:, [0, 1, 1]]
    mesh = Mesh(ball.vertices, np.concatenate([points, lines, ball.faces]))
    rays = mixed(ball, (9, 9, 9), 13000, 9)
    hits, plain = build(mesh, device=device).cast(*rays), brute_force(ball, *rays, device=device)
    np.testing.assert_array_equal(hits.t_hit, plain.t_hit)
    np.testing.assert_array_equal(hits.primitive_ids - 2 * len(ball.faces) * hits.mask, plain.primitive_ids)


def test_a_known_hit(device: Device) -> None:
    mesh = Mesh(np.array([[0, 0, 0], [4, 0, 0], [0, 4, 0]], np.float32), np.array([[0, 1, 2]], np.uint32))
    hits = build(mesh, device=device).cast((1, 2, 6), (0, 0, -3))
    assert (hits.t_hit, hits.primitive_ids, hits.geometry_ids, hits.invalid_rays) == (2, 0, 0, 0)
    assert hits.primitive_uvs.tolist() == [0.25, 0.5]
    assert hits.points.tolist() == [1, 2, 0]
    assert hits.primitive_normals.tolist() == [0, 0, 1]
    assert hits["t_hit"] == 2
    with pytest.raises(KeyError):
        hits["_mesh"]


def test_a_miss_is_marked(device: Device) -> None:
    hits = build(procedural.cube(), device=device).cast((0, 0, 5), (0, 0, 1))
    assert (hits.t_hit, hits.primitive_ids, hits.geometry_ids, bool(hits.mask)) == (np.inf, -1, -1, False)
    assert hits.primitive_uvs.tolist() == hits.primitive_normals.tolist()[:2] == [0, 0]
    assert np.isnan(hits.points).all()


def test_the_interval_is_closed(device: Device) -> None:
    grid = build(procedural.cube(), device=device)
    ray = (0.25, 0.5, 5), (0, 0, -1)
    assert grid.cast(*ray, t_max=4).t_hit == 4
    assert grid.cast(*ray, t_max=np.nextafter(4, 0)).t_hit == np.inf
    assert grid.cast(*ray, t_min=4).t_hit == 4
    assert grid.cast(*ray, t_min=np.nextafter(4, 5)).t_hit == 6
    assert grid.cast(*ray, t_min=5, t_max=5.5).t_hit == np.inf
    assert grid.cast(*ray, t_min=6, t_max=6).t_hit == 6
    assert grid.cast(*ray, t_min=7, t_max=2).t_hit == np.inf


@pytest.mark.parametrize("distance", [1.5, 3.0, 200.0, 1e6])
def test_hits_behind_the_origin_count_where_asked(distance: float, device: Device) -> None:
    grid = build(procedural.cube(), device=device)
    ray = (0.25, 0.5, distance), (0, 0, 1)
    assert grid.cast(*ray).t_hit == np.inf
    assert grid.cast(*ray, t_min=-np.inf).t_hit == -distance - 1
    assert grid.cast(*ray, t_min=-distance).t_hit == 1 - distance
    assert grid.cast(*ray, t_min=-distance - 1, t_max=-distance).t_hit == -distance - 1


def test_rays_that_are_none_are_counted_misses(device: Device) -> None:
    bad = [np.nan, np.inf, -np.inf]
    origins = np.zeros((13, 3))
    directions = np.tile([0.0, 0, 1], (13, 1))
    for i, value in enumerate(bad):
        origins[i, i] = value
        directions[3 + i, i] = value
    directions[6:8] = [[0, 0, 0], [-0.0, 0, -0.0]]
    t_min, t_max = np.zeros(13), np.full(13, np.inf)
    t_min[8], t_max[9] = np.nan, np.nan
    for cast in (build(procedural.cube(), device=device).cast, brute(procedural.cube(), device)):
        hits = cast(origins, directions, t_min, t_max)
        assert hits.mask.tolist() == [False] * 10 + [True] * 3
        assert hits.invalid_rays == 10
        assert not hits.primitive_uvs[:10].any()


def test_t_beyond_all_scales_is_refused_and_counted(device: Device) -> None:
    """On a tiny mesh, t of a long direction would be denormal: an interval could not be told from another."""
    mesh = scaled(procedural.cube(), 2.0**-890, np.float64)
    origin = np.array([0.25, 0.5, 5]) * 2.0**-890
    for cast in (build(mesh, device=device).cast, brute(mesh, device)):
        assert cast(origin, (0, 0, -(2.0**60))).t_hit == 4 * 2.0**-950
        for length in (2.0**80, 2.0**180, 2.0**1000):
            hits = cast(origin, (0, 0, -length))
            assert not hits.mask
            assert hits.invalid_rays == 1


def brute(mesh: Mesh, device: Device) -> Callable[..., Hits]:
    return lambda *rays: brute_force(mesh, *rays, device=device)


def test_shapes_broadcast(device: Device) -> None:
    grid = build(procedural.cube(), device=device)
    out = grid.cast(np.zeros((4, 1, 3)), np.eye(3))
    assert out.t_hit.shape == out.primitive_ids.shape == out.geometry_ids.shape == (4, 3)
    assert out.primitive_uvs.shape == (4, 3, 2)
    assert out.primitive_normals.shape == out.points.shape == (4, 3, 3)
    assert out.mask.all()
    single = grid.cast([0, 0, 0], [0, 0, 1])
    assert single.t_hit.shape == ()
    assert single.t_hit == 1
    joined = grid.cast(np.array([[0, 0, 0, 0, 0, 1], [0, 0, 9, 0, 0, -2]]))
    assert joined.t_hit.tolist() == [1, 4]
    assert grid.cast(np.zeros((2, 5, 6)) + 1).t_hit.shape == (2, 5)
    # One interval a ray, or a row.
    limits = grid.cast(np.zeros(3), np.eye(3), t_max=[0.5, 1.0, 2.0])
    assert limits.mask.tolist() == [False, True, True]
    assert grid.cast(np.zeros((4, 1, 3)), np.eye(3), t_min=[[0], [1], [2], [3]]).mask.sum() == 6


def test_no_rays_are_no_hits(device: Device) -> None:
    grid = build(procedural.cube(), device=device)
    for hits in (grid.cast(np.zeros((0, 3)), np.zeros((0, 3))), grid.cast(np.zeros((5, 0, 6)))):
        assert hits.t_hit.size == 0
        assert hits.invalid_rays == 0
        assert hits.points.shape == (*hits.t_hit.shape, 3)


def test_any_memory_layout_is_taken(device: Device) -> None:
    grid = build(torus(), device=device)
    origins, directions = mixed(torus(), (9, 9, 9), 1300, 10)
    expected = grid.cast(origins, directions)
    locked = origins.copy(), directions.copy()
    for part in locked:
        part.setflags(write=False)
    layouts = [
        locked,
        (np.asfortranarray(origins), np.asfortranarray(directions)),
        (np.repeat(origins, 2, axis=0)[::2], np.flip(np.flip(directions, 0).copy(), 0)),
        (origins.tolist(), directions.tolist()),
        (origins.astype(">f8"), directions.astype(np.longdouble)),
    ]
    for rays in layouts:
        assert_same(grid.cast(*rays), expected)
        assert_same(brute_force(torus(), *rays, device=device), expected)
    assert_same(grid.cast(np.concatenate([origins, directions], axis=1)), expected)
    np.testing.assert_array_equal(locked[0], origins)
    integers = grid.cast(np.array([[0, 0, 9]], np.int8), np.array([[0, 0, -1]], np.int64))
    assert_same(integers, grid.cast([[0.0, 0, 9]], [[0.0, 0, -1]]))


@pytest.mark.parametrize(
    ("rays", "message"),
    [
        ((np.zeros((4, 2)), np.zeros((4, 3))), r"origins have shape \(4, 2\)"),
        ((np.zeros((4, 3)), np.zeros((4, 4))), r"directions have shape \(4, 4\)"),
        ((np.zeros((4, 3)), np.zeros((5, 3))), "do not broadcast"),
        ((np.zeros((4, 3)), None), r"rays have shape \(4, 3\); give \(..., 6\)"),
        ((np.zeros((4, 6)), np.zeros((4, 3))), r"origins have shape \(4, 6\)"),
        ((3.0, np.zeros(3)), r"origins have shape \(\)"),
        ((None, None), "rays"),
        ((np.zeros((2, 3), complex), np.zeros((2, 3))), "dtype complex128"),
        ((np.zeros((2, 3)), np.array([["a", "b", "c"]] * 2)), "dtype <U1"),
        (([[0, 0, 0], [1]], np.zeros((2, 3))), "not arrays of numbers"),
        ((np.zeros((4, 3)), np.ones((4, 3)), np.zeros(3)), r"t_min \(3,\)"),
        ((np.zeros((4, 3)), np.ones((4, 3)), 0.0, np.zeros((4, 3))), "do not broadcast"),
        ((np.zeros((4, 3)), np.ones((4, 3)), "near"), "t_min and t_max"),
        ((np.zeros((4, 3)), np.ones((4, 3)), 0.0, [[1], [2, 3]]), "t_min and t_max"),
    ],
)
def test_what_is_no_array_of_rays_is_refused(rays: tuple[object, ...], message: str, device: Device) -> None:
    nothing = Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint32))
    for cast in (
        build(procedural.cube(), device=device).cast, brute(procedural.cube(), device),
        build(nothing, device=device).cast, brute(nothing, device),
    ):  # fmt: skip
        with pytest.raises(InputError, match=message):
            cast(*rays)


def test_an_empty_mesh_is_missed(device: Device) -> None:
    nothing = Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint32))
    for cast in (build(nothing, device=device).cast, brute(nothing, device)):
        hits = cast(np.zeros((3, 3)), np.eye(3), [0.0, np.nan, 0.0])
        assert not hits.mask.any()
        assert hits.invalid_rays == 1
        assert hits.primitive_normals.shape == (3, 3)


REAL = {
    "cad/fandisk.off": {"density": 30},
    "cad/gears.stl": {"density": 0.5},
    "dynamic/horse_gallop_frame0.ply": {"resolution": (61, 7, 113)},
    "scans/dragon_vrip_res3.ply.gz": {"density": 30},
    "arch/openarena_ctf_inyard.glb": {"density": 0.5},
    "arch/sponza_dabrovic.glb": {},
    "scans/bunny_zipper.ply": {"resolution": (100, 99, 98)},
    "scans/terrain_st_helens.ply": {},
}


@pytest.mark.thorough
@pytest.mark.parametrize("name", REAL)
def test_the_grid_changes_no_answer_on_real_meshes(name: str, device: Device) -> None:
    mesh = clgrid.load(scene(name))
    hits = assert_lossless(mesh, device, 2600, 11, EVERY_GRID)
    assert hits.mask.mean() > 0.1


@pytest.mark.thorough
@pytest.mark.slow
@pytest.mark.parametrize("name", REAL)
def test_200_000_rays_on_real_meshes(name: str, device: Device) -> None:
    mesh = clgrid.load(scene(name))
    grid = build(mesh, device=device)
    rays = mixed(mesh, grid.stats.resolution, 200_000, 12)
    expected = brute_force(mesh, *rays, device=device)
    for layout, skipping in KINDS:
        assert_same(build(mesh, layout, skipping=skipping, device=device).cast(*rays), expected)
    if REAL[name]:
        assert_same(build(mesh, device=device, **REAL[name]).cast(*rays), expected)  # type: ignore[arg-type]
    t = np.where(expected.mask, expected.t_hit, 1.0)[::8]
    part = rays[0][::8], rays[1][::8]
    for low, high in ((np.nextafter(t, np.inf), np.inf), (0.0, np.nextafter(t, 0))):
        assert_same(grid.cast(*part, low, high), brute_force(mesh, *part, low, high, device=device))


def test_ids_beyond_31_bits_are_kept() -> None:
    for ids in ([0, 5, 2**31 - 1, 2**32 - 1], [0, 2**31, 2**32 - 2, 2**32 - 1], [2**32 - 1], []):
        signed = _signed(np.array(ids, np.uint32))
        assert signed.dtype == np.int64
        assert signed.tolist() == [-1 if each == NO_HIT else each for each in ids]
