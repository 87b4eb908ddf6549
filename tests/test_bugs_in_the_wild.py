"""Bugs that users of other ray casters reported, each rebuilt: the source is in the test's docstring.

Names are owner/repository#number of issues and pull requests. Where a thread's own mesh is not to be had,
what it complains of is built anew. Grid walks and whole suites are in ``test_watertightness_suites.py``.
"""

from __future__ import annotations

import itertools

import numpy as np
import numpy.typing as npt
import pytest
from meshes import lattice_box, moved, scaled, soup, torus
from promises import FIELDS, kept

from clgrid import procedural, rational
from clgrid.brute import brute_force
from clgrid.device import Device
from clgrid.grid import build
from clgrid.mesh import Mesh
from clgrid.rungs import LOSSLESS

F64 = npt.NDArray[np.float64]

WAYS = np.array([way for way in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(way)])
"""The 26 directions along axes and diagonals."""


def box(low: npt.ArrayLike, high: npt.ArrayLike, dtype: type = np.float32) -> Mesh:
    cube = procedural.cube()
    low, high = np.asarray(low, np.float64), np.asarray(high, np.float64)
    return Mesh(np.where(cube.vertices > 0, high, low).astype(dtype), cube.faces)


def joined(*parts: Mesh) -> Mesh:
    """One geometry each."""
    first = np.cumsum([0, *(len(part.vertices) for part in parts)])[:-1]
    faces = [part.faces + np.uint32(start) for part, start in zip(parts, first, strict=True)]
    starts = np.cumsum([0, *(len(part.faces) for part in parts)]).astype(np.int64)
    names = tuple(str(number) for number in range(len(parts)))
    vertices = np.concatenate([part.vertices for part in parts])
    return Mesh(vertices, np.concatenate(faces), geometry_starts=starts, geometry_names=names)


def uv_sphere(radius: float, across: int, down: int) -> Mesh:
    """Rings of quads between two poles, as most toolkits make them: symmetric, with vertices on the axes."""
    down_angle, angle = np.pi * np.arange(1, down) / down, 2 * np.pi * np.arange(across) / across
    ring = np.stack([np.cos(angle), np.zeros(across), np.sin(angle)], -1)
    points = np.sin(down_angle)[:, None, None] * ring + np.cos(down_angle)[:, None, None] * np.array(
        [0, 1, 0]
    )
    poles = np.array([[0.0, 1, 0], [0, -1, 0]])
    vertices = radius * np.concatenate([points.reshape(-1, 3), poles])
    top, bottom = len(vertices) - 2, len(vertices) - 1
    r, c = np.meshgrid(np.arange(down - 2), np.arange(across), indexing="ij")
    a, b = r * across + c, r * across + (c + 1) % across
    quads = np.stack([a, b, b + across, a, b + across, a + across], -1).reshape(-1, 3)
    c = np.arange(across)
    n, last = (c + 1) % across, (down - 2) * across
    caps = [
        np.stack([np.full(across, top), n, c], -1),
        np.stack([np.full(across, bottom), last + c, last + n], -1),
    ]
    return Mesh(vertices.astype(np.float32), np.concatenate([quads, *caps]).astype(np.uint32))


def edge_middles(mesh: Mesh) -> F64:
    """(E, 3) middles of all edges, in float64."""
    ends = np.unique(np.sort(mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    return mesh.vertices[ends].astype(np.float64).mean(axis=1)


def cylinder(radius: float, sides: int = 24) -> Mesh:
    """Closed, from z = -10 to 10."""
    angle = 2 * np.pi * np.arange(sides) / sides
    rim = radius * np.stack([np.cos(angle), np.sin(angle)], -1)
    ends = [np.concatenate([rim, np.full((sides, 1), z)], axis=1) for z in (-10.0, 10.0)]
    vertices = np.concatenate([*ends, [[0, 0, -10], [0, 0, 10]]])
    i, j = np.arange(sides), (np.arange(sides) + 1) % sides
    low, high = np.full(sides, 2 * sides), np.full(sides, 2 * sides + 1)
    parts = [(i, j, j + sides), (i, j + sides, i + sides), (j, i, low), (i + sides, j + sides, high)]
    return Mesh(
        vertices.astype(np.float32), np.concatenate([np.stack(p, -1) for p in parts]).astype(np.uint32)
    )


# Missed hits


def test_a_mesh_elsewhere_changes_no_hit_at_a_vertex_embree_181(device: Device) -> None:
    """RenderKit/embree#181: nested cylinders; one more outside, and rays from the fifth pass the next two."""
    tubes = [cylinder(radius) for radius in range(1, 12)]
    target = tubes[5].vertices[:48].astype(np.float64)
    origins = target * (5.5 / 6, 5.5 / 6, 0.5)
    before = kept(joined(*tubes[:10]), origins, target - origins, device)
    after = kept(joined(*tubes), origins, target - origins, device)
    for rung in LOSSLESS:
        for found in (before, after):
            assert (found.hits[rung].geometry_ids == 5).all()
    assert before.ids() == after.ids()
    np.testing.assert_array_equal(before.counts + 1, after.counts)


def test_a_watertight_surface_is_hit_at_its_vertices_embree_174(device: Device) -> None:
    """RenderKit/embree#174, gkjohnson/three-mesh-bvh#169: a ray exactly at a vertex may record nothing."""
    ball = uv_sphere(1.0, 16, 12)
    targets = ball.vertices.astype(np.float64)
    for origin in ((0.0, 0.0, 0.0), (0.25, -0.125, 0.0)):
        found = kept(ball, origin, targets - origin, device, sample=40)
        assert found.all_hit()
        assert (found.counts == 1).all()


def test_each_crossing_of_an_edge_is_gathered_once_embree_188(device: Device) -> None:
    """RenderKit/embree#188, mikedh/trimesh#2317: all hits of a ray through edges, once each."""
    cube = procedural.cube()
    inner = kept(cube, (0, 0, 0), WAYS, device)
    assert (inner.counts == 1).all()
    outer = kept(cube, -3 * WAYS, WAYS, device)
    assert (outer.counts == 2).all()
    every = outer.exact.cast_all(-3 * WAYS, WAYS)
    assert every.t_hit.reshape(-1, 2).tolist() == [[2.0, 4.0]] * 26


def test_the_back_of_a_sphere_is_never_hit_embree_381(device: Device) -> None:
    """RenderKit/embree#381: from (100, 0, 0), hits on the far side of a sphere of radius 5 about 0."""
    ball = Mesh(procedural.icosphere(3).vertices * np.float32(5), procedural.icosphere(3).faces)
    eye = np.array([100.0, 0, 0])
    targets = np.concatenate([ball.vertices, edge_middles(ball)]).astype(np.float64)
    targets = targets[targets[:, 0] > 1.0]  # those nearer to the horizon may be passed
    found = kept(ball, eye, targets - eye, device)
    assert found.all_hit()
    for hits in found.hits.values():
        assert (hits.points[:, 0] > 0.4).all()
        np.testing.assert_allclose(hits.points, targets, atol=1e-4)


@pytest.mark.parametrize("tilt", [0.52, 0.01])
def test_hits_on_skinny_triangles_seen_edge_on_lie_on_them_embree_387(tilt: float, device: Device) -> None:
    """RenderKit/embree#387, #423: a triangle of 11.2, 9.7, 1.4 met at half a degree: a hit 20 times too far."""
    rng = np.random.default_rng(387)
    x = (11.2**2 + 9.7**2 - 1.6**2) / (2 * 11.2)
    flat = np.array([[0, 0, 0], [11.2, 0, 0], [x, np.sqrt(9.7**2 - x**2), 0]])
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    mesh = soup((flat @ turn.T + (40.0, -25.0, 300.0))[None])
    corners = mesh.vertices.astype(np.float64)
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    normal /= np.linalg.norm(normal)
    weights = rng.dirichlet([0.5, 0.5, 0.5], size=600)
    aim = weights @ corners + rng.normal(size=(600, 3)) * rng.choice([0, 1e-6, 0.1, 1.0], size=(600, 1))
    along = np.cross(normal, rng.normal(size=(600, 3)))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    way = along + np.tan(np.radians(tilt)) * rng.choice([-1, 1], size=(600, 1)) * normal
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    origins = aim - 590 * way
    found = kept(mesh, origins, way, device)
    depth = np.sum((corners[None] - origins[:, None]) * way[:, None], axis=2)
    for hits in found.hits.values():
        met = hits.mask
        assert 0.1 < met.mean() < 0.9
        assert (hits.t_hit >= depth.min(axis=1) - 1e-3)[met].all()
        assert (hits.t_hit <= depth.max(axis=1) + 1e-3)[met].all()


def test_no_segment_meets_what_is_far_from_it_embree_423(device: Device) -> None:
    """RenderKit/embree#423: edges of a mesh cast as segments hit triangles far away, or not, by backend."""
    ring = torus(18, 12)
    ends = np.unique(np.sort(ring.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    a, b = ring.vertices[ends[:, 0]].astype(np.float64), ring.vertices[ends[:, 1]].astype(np.float64)
    other = Mesh((ring.vertices + np.float32([0.0, 0.0, 0.90625])).astype(np.float32), ring.faces)
    found = kept(other, a, b - a, device, t_max=1.0, sample=400)
    assert found.none_hit()
    assert kept(ring, a, b - a, device, t_max=1.0, sample=20).hits["exact"].mask.any()


def test_uv_and_t_are_of_one_point_embree_52(device: Device) -> None:
    """RenderKit/embree#52: u and v twice too large where a direction component is zero; #462: u < 0."""
    plane = soup(
        np.array(
            [[[-500, 0, 0], [500, 0, 0], [-500, 1000, 0]], [[500, 0, 0], [500, 1000, 0], [-500, 1000, 0]]]
        )
    )
    rng = np.random.default_rng(52)
    targets = rng.uniform((-490, 10, 0), (490, 990, 0), (100, 3))
    targets[50:, 1] = 500 - targets[50:, 0]  # upon the diagonal
    origin = np.array([0.1, 1.09482, 29.8984])
    ways = np.concatenate([[[0, 0.99482, -0.101655]], targets - origin])
    found = kept(plane, origin, ways, device)
    assert found.all_hit()
    for hits in found.hits.values():
        assert hits.t_hit[0] == pytest.approx(294.116, abs=1e-3)
        u, v = np.moveaxis(hits.primitive_uvs.astype(np.float64), -1, 0)
        assert (u >= 0).all()
        assert (v >= 0).all()
        assert (u + v <= 1 + 2.0**-22).all()
        a, b, c = np.moveaxis(plane.vertices[plane.faces[hits.primitive_ids]].astype(np.float64), 1, 0)
        points = a + u[:, None] * (b - a) + v[:, None] * (c - a)
        np.testing.assert_allclose(points, hits.points, atol=1e-3)


def test_a_ray_within_the_plane_of_a_triangle_misses_it_embree_298(device: Device) -> None:
    """RenderKit/embree#298: whether such a ray hits must be one rule; here it does not, in any position."""
    mesh = soup(np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]]))
    found = kept(
        mesh,
        [(-1, 0.5, 0), (-1, 0, 0), (-1, 2, 0), (0, -5, 0)],
        [(1, 0, 0), (1, 0, 0), (1, -1, 0), (0, 1, 0)],
        device,
    )
    assert found.none_hit()


def test_a_square_is_hit_on_its_diagonal_trimesh_1766(device: Device) -> None:
    """mikedh/trimesh#1766, #263: a ray passes between two triangles; dimforge/parry#444: one-pixel holes."""
    corners = np.float32([[-1, -1, 0], [-1, 1, 0], [1, 1, 0], [1, -1, 0]])
    square = Mesh(corners, np.uint32([[0, 1, 2], [2, 3, 0]]))
    for size in (1.0, 40.0, 1 / 64, 1e-6):
        s = np.linspace(-0.75, 0.75, 13)[:, None] * (size, size, 0)
        found = kept(scaled(square, size), s + np.array([0, 0, size]), (0, 0, -1), device)
        assert found.all_hit()
        assert (found.counts == 1).all()


def test_any_first_and_all_agree_at_vertices_trimesh_1496(device: Device) -> None:
    """mikedh/trimesh#1496: from within a box, at the lattice of a larger one: some rays hit, some do not."""
    small, big = scaled(lattice_box(2), 20.0), scaled(lattice_box(3), 30.0)
    found = kept(small, (0, 0, 0), big.vertices, device)
    assert found.all_hit()
    assert (found.counts == 1).all()
    assert found.exact.occluded(np.zeros(3), big.vertices).all()
    assert (found.exact.cast_all(np.zeros(3), big.vertices).counts == 1).all()


@pytest.mark.parametrize("across", [128, pytest.param(1024, marks=pytest.mark.slow)])
def test_every_pixel_of_a_panorama_within_a_ball_is_hit_trimesh_1180(across: int, device: Device) -> None:
    """mikedh/trimesh#1180: 1024 x 512 directions from within a closed mesh, and 524,287 hits."""
    angle, down = np.meshgrid(
        np.arange(across) / across * 2 * np.pi, (np.arange(across // 2)) / (across // 2 - 1) * np.pi
    )
    ways = np.stack([np.sin(down) * np.cos(angle), np.sin(down) * np.sin(angle), np.cos(down)], -1)
    ball = procedural.icosphere(3)
    for rung in LOSSLESS:
        grid = build(ball, accuracy=rung, device=device, density=4)
        assert grid.cast(np.zeros(3), ways).mask.all()
    assert (grid.count(np.zeros(3), ways) == 1).all()


def test_a_face_is_hit_from_its_own_centre_trimesh_306(device: Device) -> None:
    """mikedh/trimesh#306, #457: a hundredth above a face and back; another face is reported, or none."""
    ball = procedural.icosphere(2)
    corners = ball.vertices[ball.faces].astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    found = kept(ball, corners.mean(axis=1) + 0.01 * normals, -normals, device)
    for hits in found.hits.values():
        np.testing.assert_array_equal(hits.primitive_ids, np.arange(len(ball.faces)))
        np.testing.assert_allclose(hits.t_hit, 0.01, atol=3e-6)


@pytest.mark.parametrize("size", [1e-8, 1.0, 1e4, 1e8, 1e12])
def test_all_hits_hold_no_duplicates_at_any_scale_trimesh_2504(size: float, device: Device) -> None:
    """mikedh/trimesh#2504, PR#2524, #1097: a hit repeated up to max_hits, its offset lost in rounding."""
    ball = scaled(procedural.icosphere(2), size)
    rng = np.random.default_rng(2504)
    origins = size * rng.uniform(-0.5, 0.5, (200, 3)) + (0, 0, 3 * size)
    found = kept(ball, origins, (0, 0, -1), device, sample=20)
    assert (found.counts == 2).all()
    for rung in LOSSLESS:
        every = build(ball, accuracy=rung, device=device, density=4).cast_all(origins, (0, 0, -1))
        assert (every.counts == 2).all()
        assert (every.t_hit[::2] < every.t_hit[1::2]).all()


def test_a_triangle_of_any_size_is_hit_tinybvh_283(device: Device) -> None:
    """jbikker/tinybvh PR#283: a triangle of 2e-4 is lost to an absolute epsilon; lighttransport/nanort#30."""
    for s in (2e-4, 1e-12, 1e-30, 1e12, 1e30):
        mesh = soup(np.array([[[0, 0, 0], [s, 0, 0], [0, s, 0]]]))
        ways = np.array([[0, 0, 1], [1e-16, 0, 1], [0, -1e-16, 1]]) * s
        found = kept(mesh, (s / 3, s / 3, -s), ways, device)
        assert found.all_hit()
        for hits in found.hits.values():
            np.testing.assert_allclose(hits.t_hit, 1.0, rtol=1e-6)


def test_minus_zero_is_zero_bvh_20(device: Device) -> None:
    """madmann91/bvh#20, jbikker/tinybvh PR#282, vkoskiv/c-ray PR#87: a component of -0.0 finds no hit."""
    near = [[1, -1, 1], [1, 1, 1], [-1, 1, 1]]
    mesh = soup(np.array([near, near + np.array([0, 0, 1.1])]))
    for sign in itertools.product((0.0, -0.0), repeat=2):
        hits = kept(mesh, (0.25, 0.25, 0), (*sign, 1), device).hits
        assert all((h.t_hit[0], h.primitive_ids[0]) == (1, 0) for h in hits.values())
    ring = torus(18, 12)
    zeros = WAYS[np.abs(WAYS).sum(axis=1) < 3]
    origins = np.random.default_rng(20).uniform(-1.5, 1.5, (len(zeros), 3))
    plus = kept(ring, origins, np.where(zeros == 0, 0.0, zeros), device)
    minus = kept(ring, origins, np.where(zeros == 0, -0.0, zeros), device)
    for rung in LOSSLESS:
        assert plus.hits[rung].t_hit.tobytes() == minus.hits[rung].t_hit.tobytes()


def test_a_cube_is_hit_across_its_diagonals_fcpw_14(device: Device) -> None:
    """rohan-sawhney/fcpw#14, PR#22: of two rays into one side of a cube, one hits and the other does not."""
    faces = np.uint32([
        [2, 1, 0], [1, 2, 3], [4, 2, 0], [2, 4, 6], [1, 4, 0], [4, 1, 5],
        [6, 5, 7], [5, 6, 4], [3, 6, 7], [6, 3, 2], [5, 3, 7], [3, 5, 1],
    ])  # fmt: skip
    cube = Mesh(np.float32([[x, y, z] for z in (1.6, 14.4) for y in (1.6, 14.4) for x in (1.6, 14.4)]), faces)
    y, z = np.meshgrid(np.linspace(2, 14, 25), np.linspace(2, 14, 25))
    for x, way in ((1.0, 1.0), (15.0, -1.0)):
        found = kept(cube, np.stack([np.full(y.shape, x), y, z], -1), (14 * way, 0, 0), device)
        assert found.all_hit()
        assert (found.counts == 2).all()


def test_bits_at_edges_are_equal_on_every_device_embree_51(all_devices: list[Device]) -> None:
    """RenderKit/embree#51, #596, mmp/pbrt-v4#85, LuxCoreRender/LuxCore#198: answers differ by processor."""
    ring = torus(18, 12)
    targets = np.concatenate([ring.vertices, edge_middles(ring)]).astype(np.float64)
    for rung in LOSSLESS:
        first, *others = (
            build(ring, accuracy=rung, device=each, density=4).cast(
                (0.1, 0.2, 3.0), targets - (0.1, 0.2, 3.0), fields=FIELDS
            )
            for each in all_devices
        )
        for other, name in itertools.product(others, ("t_hit", "primitive_ids", *FIELDS)):
            assert first[name].tobytes() == other[name].tobytes(), f"{rung}: {name}"


# Inside and outside


def test_contains_a_lattice_around_a_sphere_open3d_5669(device: Device) -> None:
    """isl-org/Open3D#5669: the sign of the distance to a sphere is wrong for some of a 64^3 lattice."""
    ball = uv_sphere(0.8, 40, 20)
    grid = build(ball, accuracy="exact", device=device, density=4)
    span = np.linspace(ball.bounds[0] * 1.1, ball.bounds[1] * 1.1, 64)
    points = np.stack(np.meshgrid(*span.T), -1).astype(np.float32)[:, :, 28:36:3].reshape(-1, 3)
    points = np.concatenate([points, ball.vertices * np.float32(0.5), ball.vertices])
    inside, distance = grid.contains(points), np.linalg.norm(points.astype(np.float64), axis=1)
    assert not inside[distance > 0.8 + 1e-6].any()
    assert inside[distance < 0.8 * np.cos(np.pi / 20) ** 2 - 1e-6].all()
    triangles = rational.Triangles.of_mesh(ball)
    rows = np.flatnonzero(np.abs(distance - 0.795) < 0.0055)[::4]
    assert len(rows) > 100
    for row in rows:
        assert inside[row] == rational.inside(triangles, points[row], (0.3, -0.2, 0.9))


def test_a_ray_that_touches_an_edge_from_outside_open3d_5105(device: Device) -> None:
    """isl-org/Open3D#5105: (-1, -1, 0) is inside the unit cube: the ray (1, 1, 1) touches an edge."""
    cube = box((0, 0, 0), (1, 1, 1))
    points = [(-1, -1, 0), (-1, -1, -1), (0.5, 0.5, 0.5)]
    grid = build(cube, accuracy="exact", device=device)
    assert grid.contains(points).tolist() == [False, False, True]
    assert (kept(cube, points, (1, 1, 1), device).counts % 2).tolist() == [0, 0, 1]


def test_inside_is_the_same_in_every_direction_ncollpyde_3(device: Device) -> None:
    """clbarnes/ncollpyde#3, mikedh/trimesh#181, #545: jitter decides. Rays here lie in planes of vertices."""
    mesh = joined(lattice_box(4), scaled(lattice_box(2), 3.0))
    points = np.stack(np.meshgrid(*[np.arange(-3.75, 4, 0.75)] * 3), -1).reshape(-1, 3)
    size = np.abs(points).max(axis=1)
    expected = (size < 3) & (size > 1)
    points, expected = points[(size != 3) & (size != 1)], expected[(size != 3) & (size != 1)]
    grid = build(mesh, accuracy="exact", device=device)
    for way in WAYS:
        np.testing.assert_array_equal(grid.count(points, way) % 2 == 1, expected)
    np.testing.assert_array_equal(grid.contains(points), expected)


def test_contains_of_cavities_and_overlaps_trimesh_2534(device: Device) -> None:
    """mikedh/trimesh#2534: a cavity is inside; #1416, #242: overlapping boxes change from call to call."""
    hollow = joined(box((-0.5,) * 3, (0.5,) * 3), box((-0.05,) * 3, (0.05,) * 3))
    grid = build(hollow, accuracy="exact", device=device)
    assert grid.contains([(0, 0, 0), (0.2, 0, 0), (0.6, 0, 0)]).tolist() == [False, True, False]
    overlap = joined(box((0, 0, 0), (1, 1, 1)), box((0.5, 0, 0), (1.5, 1, 1)))
    points = np.stack(np.meshgrid(*[np.arange(-0.25, 2, 0.25)] * 3), -1).reshape(-1, 3)
    grid = build(overlap, accuracy="exact", device=device)
    first = grid.contains(points)
    assert all(first.tobytes() == grid.contains(points).tobytes() for _ in range(3))
    triangles = rational.Triangles.of_mesh(overlap)
    assert first.tolist() == [rational.inside(triangles, point, (0.1, 0.7, -0.4)) for point in points]


# Precision, scale, double


def test_doubles_tell_triangles_apart_embree_291(device: Device) -> None:
    """RenderKit/embree#291, #45: with coordinates in double, single finds the wrong triangle, or none."""
    sheets = np.array([[-1, -1, 0], [1, -1, 0], [0, 1, 0]]) + np.array([0, 0, 1.0])
    gap = np.array([0, 0, 2.0**-40])
    near = soup(np.stack([sheets + gap, sheets, sheets - gap]), np.float64)
    seam = 1 / 3 + 1e-13  # both sides of an edge, apart by less than a float
    wedge = np.array([[[seam, -1, 1], [seam, 1, 1], [-1, 0, 1]], [[seam, 1, 1], [seam, -1, 1], [2, 0, 1]]])
    rays = (1 / 3, 0, 0), (1 / 3 + 2e-13, 0, 0)
    above, below = (
        kept(near, (0.1, 0.1, 9), (0, 0, -1), device),
        kept(near, (0.1, 0.1, -9), (0, 0, 1), device),
    )
    sides = kept(soup(wedge, np.float64), rays, (0, 0, 1), device)
    for rung in ("precise", "exact"):
        assert (above.ids(rung), below.ids(rung), sides.ids(rung)) == ([0], [2], [0, 1])
        assert above.hits[rung].t_hit[0] == pytest.approx(8 - gap[2], abs=1e-14)


def test_hits_lie_in_the_plane_open3d_5777(device: Device) -> None:
    """isl-org/Open3D#5777: off by 3e-5; sampotter/python-embree#20: by 1e-5; mikedh/trimesh#1338: by 2e-5."""
    rng = np.random.default_rng(5777)
    corners = rng.uniform(-10, 10, (2, 3, 3))
    mesh = soup(np.concatenate([corners, corners[:1] + 30]), np.float64)
    aim = rng.dirichlet([1, 1, 1], size=200) @ mesh.vertices[:3]
    origins = aim + rng.normal(size=(200, 3)) * 20
    found = kept(mesh, origins, aim - origins, device)
    normals = np.cross(mesh.vertices[1::3] - mesh.vertices[::3], mesh.vertices[2::3] - mesh.vertices[::3])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    for rung, bound in (("robust", 1e-4), ("precise", 1e-12), ("exact", 1e-12)):
        hits = found.hits[rung]
        ids = hits.primitive_ids[hits.mask]
        off = np.sum((hits.points[hits.mask] - mesh.vertices[3 * ids]) * normals[ids], axis=1)
        assert hits.mask.mean() > 0.9
        assert np.abs(off).max() < bound


@pytest.mark.parametrize("size", [1.0, 1e5])
def test_triangles_are_hit_from_afar_trimesh_48(size: float, device: Device) -> None:
    """mikedh/trimesh#48: up to 44 % of rays miss the triangle that they start 1 to 10^9 above."""
    rng = np.random.default_rng(48)
    corners = size * (rng.random((60, 3, 3)) + 4 * rng.integers(-3, 4, (60, 1, 3)))
    edges = corners[:, 1:] - corners[:, :1]
    normals = np.cross(edges[:, 0], edges[:, 1])
    area = np.linalg.norm(normals, axis=1)
    broad = area > 0.05 * size**2
    mesh = soup(corners[broad], np.float64)
    middles, normals = corners[broad].mean(axis=1), normals[broad] / area[broad, None]
    for exponent in range(10):
        origins = middles + normals * 10.0**exponent
        found = kept(mesh, origins, -normals, device, sample=10)
        assert found.all_hit()
        for rung in LOSSLESS:
            every = build(mesh, accuracy=rung, device=device, density=4).cast_all(origins, -normals)
            own = every.primitive_ids == every.ray_ids
            assert (np.bincount(every.ray_ids[own], minlength=len(middles)) == 1).all()


def test_a_mesh_far_from_the_origin_is_hit_three_mesh_bvh_112(device: Device) -> None:
    """gkjohnson/three-mesh-bvh#112: bounds of (100928, 99222, 3541) to (101194, 99508, 3644) lose hits."""
    low, high = np.array([100928.0, 99222, 3541]), np.array([101194.0, 99508, 3644])
    hills = procedural.terrain(24)
    share = (hills.vertices - hills.bounds[0]) / (hills.bounds[1] - hills.bounds[0])
    mesh = Mesh((low + share * (high - low)).astype(np.float32), hills.faces)
    targets = np.concatenate([mesh.vertices, edge_middles(mesh)]).astype(np.float64)
    targets = targets[(np.abs(targets - (low + high) / 2)[:, :2] < 0.49 * (high - low)[:2]).all(axis=1)]
    down = kept(mesh, targets * (1, 1, 0) + (0, 0, 5000), (0, 0, -1), device, sample=40)
    assert down.all_hit()
    assert (down.counts == 1).all()


def test_a_huge_triangle_beside_small_ones_pbrt_249(device: Device) -> None:
    """mmp/pbrt-v4#249: a light of 2e9 over triangles of 4 and 200; float32 and double differ."""
    corners = [[[-1e9, 9, -1e9], [1e9, 9, -1e9], [0, 9, 1e9]], [[0, 2, 0], [4, -1, 0], [0, -1, 10]]]
    mesh = soup(np.array([*corners, [[-100, -1, -100], [100, -1, -100], [0, -1, 100]]]))
    eye, (x, y) = np.array([0.0, 8, -8]), np.meshgrid(*[np.linspace(-0.6, 0.6, 24)] * 2)
    ways = np.stack([x, -0.7 + y, np.full(x.shape, 0.7)], -1).reshape(-1, 3)
    seen = kept(mesh, eye, ways, device, sample=600)
    assert {1, 2} <= set(seen.ids())
    shadow = kept(mesh, seen.hits["exact"].points[seen.hits["exact"].mask], (0, 1, 0), device, t_min=1e-3)
    assert shadow.hits["exact"].mask.all()
    assert {0, 1} == set(shadow.ids())


@pytest.mark.parametrize("width", [5.89075e8, 5.89075e11])
def test_a_huge_flat_box_has_two_sides_embree_416(width: float, device: Device) -> None:
    """RenderKit/embree#416: a box of 6e11 x 6e11 x 120000: hits that do not exist, just above its bottom."""
    mesh = box((-width, -width, 0), (width, width, 120000))
    for height, met in ((120500, [500, 120500]), (120000, [0, 120000]), (60000, [60000]), (0, [0]), (-1, [])):
        found = kept(mesh, (0, 0, height), (0, 0, -1), device)
        every = found.exact.cast_all((0, 0, height), (0, 0, -1))
        np.testing.assert_allclose(every.t_hit, met, rtol=1e-15)
        for hits in found.hits.values():
            assert hits.t_hit[0] == pytest.approx(met[0] if met else np.inf, rel=1e-6)


# Starting on a surface


def test_starting_on_a_surface_is_one_rule_trimesh_331(device: Device) -> None:
    """mikedh/trimesh#331: "sometimes the origin itself as a collision"; RenderKit/embree#133: hit or not."""
    triangle = soup(np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]]))
    found = kept(triangle, (0.25, 0.25, 0), [(0, 0, 1), (0, 0, -1), (1, 2, 3)], device)
    assert all((hits.t_hit == 0).all() for hits in found.hits.values())
    ball = procedural.icosphere(2)
    rng = np.random.default_rng(331)
    face = rng.integers(len(ball.faces), size=200)
    corners = ball.vertices[ball.faces[face]].astype(np.float64)
    starts = (corners * rng.dirichlet([1, 1, 1], size=200)[..., None]).sum(axis=1)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    kept(ball, starts, normals, device)
    inward = kept(ball, starts, -normals / np.linalg.norm(normals, axis=1, keepdims=True), device, t_min=1e-4)
    assert inward.all_hit()
    assert all((hits.t_hit > 1).all() for hits in inward.hits.values())


def test_shadows_on_a_strip_have_no_spots_open3d_5430(device: Device) -> None:
    """isl-org/Open3D#5430, #5870: vertices of a Moebius strip of two twists, lit along x: spotty shadows."""
    along, across = np.meshgrid(np.arange(70) * 2 * np.pi / 70, np.linspace(-0.2, 0.2, 9), indexing="ij")
    width = 1 + across * np.cos(along)
    points = np.stack([width * np.cos(along), width * np.sin(along), across * np.sin(along)], -1)
    i, j = np.meshgrid(np.arange(70), np.arange(8), indexing="ij")
    a, b = 9 * i + j, 9 * ((i + 1) % 70) + j
    faces = np.stack([a, b, b + 1, a, b + 1, a + 1], -1).reshape(-1, 3)
    strip = Mesh(points.reshape(-1, 3).astype(np.float32), faces.astype(np.uint32))
    found = kept(strip, strip.vertices, (1, 0, 0), device, t_min=1e-4)
    lit = np.stack([~hits.mask for hits in found.hits.values()])
    assert (lit == lit[-1]).mean() > 0.99
    assert (found.exact.occluded(strip.vertices, (1, 0, 0), 1e-4) == ~lit[-1]).all()


def test_the_bound_says_how_far_a_point_is_behind_the_surface_mitsuba2_171(device: Device) -> None:
    """mitsuba-renderer/mitsuba2#171, mitsuba3 PR#1962: points behind the surface by more than the epsilon."""
    ground = soup(np.array([[[-1e3, -1e3, 0.1], [1e3, -1e3, 0.1], [0, 2e3, 0.1]]]))
    rng = np.random.default_rng(171)
    targets = np.append(rng.uniform(-300, 300, (300, 2)), np.full((300, 1), 0.1), axis=1)
    origins = targets + rng.normal(size=(300, 3)) * (1000, 1000, 30)
    found = kept(ground, origins, targets - origins, device, t_min=-np.inf, sample=300)
    for rung, bound in (("robust", 1e-2), ("precise", 1e-9), ("exact", 1e-10)):
        hits = found.hits[rung]
        assert hits.mask.all()
        assert np.median(hits.t_err) < bound


@pytest.mark.parametrize("by", [1e3, 1e6, 1e9])
def test_moved_meshes_answer_as_unmoved_ones_embree_45(by: float, device: Device) -> None:
    """RenderKit/embree#45: large world coordinates; moved by powers of two, no answer may change."""
    ring = torus(18, 12)
    offset = 2.0 ** np.round(np.log2(by)) * np.array([1, -0.5, 0.25])
    rng = np.random.default_rng(45)
    origins = np.round(rng.uniform(-2, 2, (300, 3)) * 2**10) / 2**10
    targets = np.round(ring.vertices[rng.integers(len(ring.vertices), size=300)] * 2.0**10) / 2**10
    shape = Mesh(np.round(ring.vertices * 2.0**10).astype(np.float64) / 2**10, ring.faces)
    away = Mesh(shape.vertices + offset, ring.faces)
    here, there = (
        kept(shape, origins, targets - origins, device),
        kept(away, origins + offset, targets - origins, device),
    )
    assert here.ids() == there.ids()
    np.testing.assert_array_equal(here.counts, there.counts)


def test_a_moved_brute_force_is_no_other_open3d_scale(device: Device) -> None:
    """Measured with Open3D 0.20 (an icosphere at 1e3 and 1e5): wrong parity thousands of times."""
    for by in (1e3, 1e5):
        ball = moved(procedural.icosphere(2), by, np.float32)
        centre = by * np.array([1, -0.7, 0.3])
        found = kept(ball, centre, ball.vertices - centre, device)
        assert found.all_hit()
        assert (found.counts % 2 == 1).all()
        assert brute_force(ball, centre, ball.vertices - centre, device=device).mask.all()
