"""Precision, scale and starts on a surface: what users of other ray casters reported, each rebuilt.

Each test's docstring names its source, as in ``test_bugs_in_the_wild.py``.
"""

from __future__ import annotations

import numpy as np
import pytest
from meshes import moved, soup, torus
from promises import kept
from shapes import box, edge_middles

from clgrid import procedural
from clgrid.device import Device
from clgrid.mesh import Mesh

# Seconds in all, but the fast part has none to spare: of these, it has test_watertightness_suites.py.
pytestmark = [pytest.mark.slow, pytest.mark.thorough]


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
        assert (above.ids(rung), below.ids(rung), sides.ids(rung)) == ([0, 0], [2, 2], [0, 1])
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
        for every in found.every.values():
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
        np.testing.assert_allclose(found.every["exact"].t_hit, met * 2, rtol=1e-15)
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
