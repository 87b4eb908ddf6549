"""Missed hits and wrong parity that users of other ray casters reported, each rebuilt.

Each test's docstring names its source: owner/repository#number of an issue or a pull request. Where a
thread's own mesh is not to be had, what it complains of is built anew.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from agreement import RUNGS, ask, assert_same, query
from meshes import lattice_box, scaled, soup, torus
from promises import kept
from shapes import WAYS, box, cylinder, edge_middles, joined, uv_sphere

from clgrid import procedural, rational
from clgrid.device import Device
from clgrid.grid import build
from clgrid.mesh import Mesh

# Seconds in all, but the fast part has none to spare: of these, it has test_watertightness_suites.py.
pytestmark = [pytest.mark.slow, pytest.mark.thorough]


# Missed hits


def test_a_mesh_elsewhere_changes_no_hit_at_a_vertex_embree_181(device: Device) -> None:
    """RenderKit/embree#181: nested cylinders; one more outside, and rays from the fifth pass the next two."""
    tubes = [cylinder(radius) for radius in range(1, 12)]
    target = tubes[5].vertices[:48].astype(np.float64)
    origins = target * (5.5 / 6, 5.5 / 6, 0.5)
    before = kept(joined(*tubes[:10]), origins, target - origins, device)
    after = kept(joined(*tubes), origins, target - origins, device)
    for rung in RUNGS:
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
    assert outer.every["exact"].t_hit.reshape(-1, 2).tolist() == [[2.0, 4.0]] * 26


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
    """RenderKit/embree#387, #423: a triangle of 11.2, 9.7, 1.4 met at 0.5 degrees: a hit 20 times too far."""
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


@pytest.mark.parametrize("across", [128, 1024])
def test_every_pixel_of_a_panorama_within_a_ball_is_hit_trimesh_1180(across: int, device: Device) -> None:
    """mikedh/trimesh#1180: 1024 x 512 directions from within a closed mesh, and 524,287 hits."""
    angle, down = np.meshgrid(
        np.arange(across) / across * 2 * np.pi, (np.arange(across // 2)) / (across // 2 - 1) * np.pi
    )
    ways = np.stack([np.sin(down) * np.cos(angle), np.sin(down) * np.sin(angle), np.cos(down)], -1)
    ball = procedural.icosphere(3)
    for rung in RUNGS:
        grid = build(ball, accuracy=rung, device=device, density=4)
        answers = ask(grid, query(np.zeros(3), ways.reshape(-1, 3)))
        assert answers.hits.mask.all()
    assert (answers.counts == 1).all()


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
    for every in found.every.values():
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
    for rung in RUNGS:
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
    rays = query((0.1, 0.2, 3.0), targets - (0.1, 0.2, 3.0))
    for rung in RUNGS:
        first, *others = (
            ask(build(ring, accuracy=rung, device=each, density=4), rays) for each in all_devices
        )
        for other in others:
            assert_same(first.hits, other.hits)
            assert_same(first.every, other.every)


# Inside and outside


def test_contains_a_lattice_around_a_sphere_open3d_5669(device: Device) -> None:
    """isl-org/Open3D#5669: the sign of the distance to a sphere is wrong for some of a 64^3 lattice."""
    ball = uv_sphere(0.8, 40, 20)
    grid = build(ball, accuracy="exact", device=device, density=4)
    span = np.linspace(ball.bounds[0] * 1.1, ball.bounds[1] * 1.1, 64)
    points = (
        np.stack(np.meshgrid(*span.T), -1).astype(np.float32)[:, :, 28:36:3].reshape(-1, 3).astype(np.float64)
    )
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
        np.testing.assert_array_equal(grid.count(*query(points, way)) % 2 == 1, expected)
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
