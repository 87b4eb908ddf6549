"""clgrid.trimesh.RayMeshIntersector: trimesh's queries, types and orders; where they differ, exact."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from meshes import MESHES, lattice_box
from rays import mixed
from trimesh_meshes import around, bumpy, by_ray, intersector, places, theirs, trimesh

from clgrid import rational
from clgrid.brute import brute_force
from clgrid.device import Device
from clgrid.errors import InputError
from clgrid.mesh import Mesh
from clgrid.trimesh import RayMeshIntersector

pytestmark = pytest.mark.host

ENGINES = ("ray_triangle", "ray_pyembree")
NEEDS = {"ray_triangle": "rtree", "ray_pyembree": "embreex"}


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("name", ["bumpy", "annulus", "boxes"])
def test_answers_are_those_of_trimesh(name: str, engine: str, device: Device) -> None:
    """Triangle by triangle; where they differ, exact arithmetic says what we say."""
    pytest.importorskip(NEEDS[engine])
    mesh = {
        "bumpy": bumpy,
        "annulus": lambda: trimesh.creation.annulus(1.0, 2.0, 0.5),
        "boxes": lambda: trimesh.util.concatenate([trimesh.creation.box(np.full(3, s)) for s in (1, 2, 3)]),
    }[name]()
    other = getattr(trimesh.ray, engine).RayMeshIntersector(mesh)
    ours, count = intersector(mesh, device), 300
    rays = around(mesh, count, 1)
    triangles, of_ray, points = ours.intersects_id(*rays, return_locations=True)
    expected, of_theirs, at = other.intersects_id(*rays, multiple_hits=True, return_locations=True)
    assert triangles.dtype == expected.dtype
    assert of_ray.dtype == of_theirs.dtype
    assert points.dtype == at.dtype
    corners = mesh.triangles.view(np.ndarray)
    lists, others = (by_ray(r, t, count) for r, t in ((of_ray, triangles), (of_theirs, expected)))
    differing = [ray for ray in range(count) if sorted(lists[ray]) != sorted(others[ray])]
    assert len(differing) <= count // 50
    for ray in range(count):
        if ray in differing or ray < 30:
            crossed = rational.crossings(corners, rays[0][ray], rays[1][ray])
            assert [c.id for c in crossed if c.t >= 0] == lists[ray]
    agreeing = ~np.isin(of_ray, differing)
    by_triangle = np.lexsort([triangles[agreeing], of_ray[agreeing]])
    agreed = ~np.isin(of_theirs, differing)
    by_theirs = np.lexsort([expected[agreed], of_theirs[agreed]])
    np.testing.assert_allclose(points[agreeing][by_triangle], at[agreed][by_theirs], rtol=0, atol=1e-9)
    sure = ~np.isin(np.arange(count), differing)
    for query in ("intersects_first", "intersects_any"):
        found, wanted = getattr(ours, query)(*rays), getattr(other, query)(*rays)
        np.testing.assert_array_equal(found[sure], wanted[sure])
    assert of_ray.max() > 250
    assert sum(map(len, lists)) > count


def test_hits_come_in_the_order_of_trimesh_and_embree(device: Device) -> None:
    """The nearest of all rays, then the second of all: element by element."""
    pytest.importorskip("embreex")
    mesh = bumpy()
    rays = around(mesh, 200, 2)
    other = trimesh.ray.ray_pyembree.RayMeshIntersector(mesh)
    for multiple in (True, False):
        points, of_ray, triangles = intersector(mesh, device).intersects_location(*rays, multiple)
        at, of_theirs, expected = other.intersects_location(*rays, multiple)
        np.testing.assert_array_equal(of_ray, of_theirs)
        np.testing.assert_array_equal(triangles, expected)
        np.testing.assert_allclose(points, at, rtol=0, atol=1e-9)


@pytest.mark.parametrize("accuracy", ["precise", "exact", "robust"])
@pytest.mark.parametrize("name", ["torus", "needle_fan", "stacks"])
def test_methods_agree_with_brute_force_and_each_other(name: str, accuracy: str, device: Device) -> None:
    mesh = MESHES[name]
    ours = intersector(mesh, device, accuracy=accuracy)
    rays = mixed(mesh, (5, 4, 6), 600, 3)
    nearest = brute_force(Mesh.from_trimesh(ours.mesh), *rays, device=device, accuracy=accuracy)
    np.testing.assert_array_equal(ours.intersects_first(*rays), nearest.primitive_ids)
    np.testing.assert_array_equal(ours.intersects_any(*rays), nearest.mask)
    one = ours.intersects_location(*rays, multiple_hits=False)
    np.testing.assert_array_equal(one[0], nearest.points[nearest.mask])
    np.testing.assert_array_equal(one[1], np.flatnonzero(nearest.mask))
    np.testing.assert_array_equal(one[2], nearest.primitive_ids[nearest.mask])
    several = ours.intersects_location(*rays)
    assert len(several[1]) > len(one[1])
    for first, found in zip(one, several, strict=True):
        np.testing.assert_array_equal(first, found[: len(first)])
    np.testing.assert_array_equal(ours.intersects_id(*rays)[0], several[2])
    np.testing.assert_array_equal(ours.intersects_id(*rays)[1], several[1])


def test_at_most_so_many_hits_of_a_ray(device: Device) -> None:
    mesh = trimesh.util.concatenate([trimesh.creation.box(np.full(3, s)) for s in range(1, 71)])
    ours = intersector(mesh, device)
    rays = [[0.1, 0.2, -90], [0.1, 0.2, 0], [80, 0, 0]], [[0, 0, 1.0], [0, 0, 1], [0, 0, 1]]
    assert np.bincount(ours.intersects_id(*rays)[1]).tolist() == [100, 70]
    assert np.bincount(ours.intersects_location(*rays)[1]).tolist() == [100, 70]
    assert np.bincount(ours.intersects_id(*rays, max_hits=None)[1]).tolist() == [140, 70]
    triangles, of_ray = ours.intersects_id(*rays, max_hits=2)
    assert of_ray.tolist() == [0, 1, 0, 1]
    assert (triangles // 12).tolist() == [69, 0, 68, 1]
    assert ours.intersects_id(*rays, multiple_hits=False, max_hits=0)[0].tolist() == []
    assert ours.intersects_id(*rays, max_hits=0)[0].tolist() == []
    with pytest.raises(InputError, match="max_hits is -1"):
        ours.intersects_id(*rays, max_hits=-1)


def test_edges_and_vertices_are_met_once(device: Device) -> None:
    """Rays through the lattice of a box, aslant and within its planes; all numbers are exact in float64."""
    mesh = theirs(lattice_box(4))
    ours = intersector(mesh, device)
    rng = np.random.default_rng(4)
    starts = rng.integers(-8, 9, (150, 3)) / 4
    ways = rng.integers(-2, 3, (150, 3)) / 2.0
    ways[~ways.any(axis=1)] = 1
    starts[:20], ways[:20] = [0.25, 0.5, 3], [0, 0, -1]
    expected = [places(mesh, o, d) for o, d in zip(starts, ways, strict=True)]
    points, of_ray, _ = ours.intersects_location(starts, ways)
    assert np.bincount(of_ray, minlength=150).tolist() == [len(ts) for ts in expected]
    for ray, found in enumerate(by_ray(of_ray, points, 150)):
        exact = [[float(o + t * d) for o, d in zip(map(Fraction, starts[ray].tolist()),
                                                   map(Fraction, ways[ray].tolist()), strict=True)]
                 for t in expected[ray]]  # fmt: skip
        np.testing.assert_allclose(np.reshape(found, (-1, 3)), np.reshape(exact, (-1, 3)), atol=1e-15)
    assert max(map(len, expected)) == 2
    assert sum(len(ts) == 1 for ts in expected) > 10
    np.testing.assert_array_equal(ours.intersects_any(starts, ways), [bool(ts) for ts in expected])


def test_exact_counts_crossings_and_not_touches(device: Device) -> None:
    """mikedh/trimesh#2317: four rays along edges of a box graze it; moved by an infinitesimal, they miss."""
    mesh = trimesh.creation.box(extents=[2, 2, 2])
    starts = np.array([[x, y, 5.0] for x in (-1, 0, 1) for y in (-1, 0, 1)])
    ways = np.tile([0.0, 0, -1], (9, 1))
    crossed = [rational.count(mesh.triangles.view(np.ndarray), o, (0, 0, -1)) for o in starts]
    assert crossed == [2, 2, 0, 2, 2, 0, 0, 0, 0]
    exact = intersector(mesh, device, accuracy="exact")
    assert np.bincount(exact.intersects_id(starts, ways)[1], minlength=9).tolist() == crossed
    assert exact.intersects_any(starts, ways).tolist() == [count > 0 for count in crossed]
    touching = intersector(mesh, device)
    assert touching.intersects_any(starts, ways).all()
    assert np.bincount(touching.intersects_id(starts, ways)[1]).tolist() == [2] * 9


def test_what_is_near_a_triangle_seen_edge_on_is_not_lost(device: Device) -> None:
    """The error of its t is as large as the triangle, and another one is hit within that."""
    tilt = 2.0**-50
    wall = [[-8, -1, -8 * tilt], [8, -1, 8 * tilt], [0, 1, 0]]
    mesh = trimesh.Trimesh(
        np.array([*wall, [3, -1, -1], [3, 2, -1], [3, -1, 2]]), [[0, 1, 2], [3, 4, 5]], process=False
    )
    ours = intersector(mesh, device)
    hits = ours.grid.cast_all([-10.0, 0, tilt], [1.0, 0, 0], fields=("t_err",))
    assert hits.t_err.sum() > abs(np.diff(hits.t_hit)[0])
    assert sorted(ours.intersects_id([[-10, 0, tilt]], [[1, 0, 0]])[0].tolist()) == [0, 1]


def test_triangles_in_one_place_are_met_once_but_crossed_each(device: Device) -> None:
    twice = trimesh.util.concatenate([trimesh.creation.box(), trimesh.creation.box()])
    ray = [[0.1, 0.2, 3.0]], [[0.0, 0, -1]]
    assert len(intersector(twice, device).intersects_id(*ray)[0]) == 2
    assert len(intersector(twice, device, accuracy="exact").intersects_id(*ray)[0]) == 4


FORMS = {
    "lists": lambda a: a.tolist(),
    "tuples": lambda a: tuple(map(tuple, a.tolist())),
    "float32": lambda a: a.astype(np.float32),
    "integers": lambda a: a.astype(np.int16),
    "unsigned": lambda a: (a + 0).astype(np.int64),
    "strided": lambda a: np.repeat(a, 2, axis=0)[::2],
    "fortran": np.asfortranarray,
    "swapped": lambda a: a.astype(">f8"),
    "tracked": lambda a: trimesh.caching.tracked_array(a),
}


@pytest.mark.parametrize("form", FORMS)
def test_any_array_of_numbers_will_do(form: str, device: Device) -> None:
    mesh = trimesh.creation.box(extents=[3, 3, 3])
    starts, ways = (
        np.array([[0.0, 0, 0], [1, 0, -9], [7, 7, 7]]),
        np.array([[1.0, 2, 5], [0, 0, 3], [1, 0, 0]]),
    )
    starts.setflags(write=False)
    ours = intersector(mesh, device)
    given = FORMS[form](starts), FORMS[form](ways)
    for query in ("intersects_first", "intersects_any", "intersects_id", "intersects_location"):
        found, expected = getattr(ours, query)(*given), getattr(ours, query)(starts, ways)
        for one, other in zip(found, expected, strict=True):
            np.testing.assert_array_equal(one, other)
    assert ours.contains_points(FORMS[form](starts)).tolist() == [True, False, False]


def test_types_and_shapes_for_any_number_of_rays(device: Device) -> None:
    ball = trimesh.creation.icosphere()
    for mesh in (ball, trimesh.Trimesh()):
        ours = intersector(mesh, device)
        for count in (0, 1, 3):
            rays = np.zeros((count, 3)), np.ones((count, 3))
            hits = count if mesh is ball else 0
            triangles, of_ray, points = ours.intersects_id(*rays, return_locations=True)
            assert (triangles.dtype, of_ray.dtype, points.dtype) == (np.int64, np.int64, np.float64)
            assert (triangles.shape, of_ray.shape, points.shape) == ((hits,), (hits,), (hits, 3))
            assert [type(array) for array in (triangles, of_ray, points)] == [np.ndarray] * 3
            first, some = ours.intersects_first(*rays), ours.intersects_any(*rays)
            assert (first.dtype, first.shape) == (np.int64, (count,))
            assert (some.dtype, some.tolist()) == (np.bool_, [bool(hits)] * count)
            assert ours.contains_points(rays[0]).tolist() == [bool(hits)] * count
        assert ours.intersects_id([], [])[0].shape == (0,)
        assert ours.contains_points([]).shape == (0,)


def test_rays_that_are_none_hit_nothing(device: Device) -> None:
    ours = intersector(trimesh.creation.box(), device)
    starts, ways = np.zeros((3, 3)), np.array([[0, 0, 0], [np.nan, 0, 1], [np.inf, 0, 0]])
    assert ours.intersects_first(starts, ways).tolist() == [-1] * 3
    assert ours.intersects_any(starts, ways).tolist() == [False] * 3
    assert ours.intersects_id(starts, ways)[1].tolist() == []
    assert ours.contains_points([[np.nan, 0, 0], [np.inf, 0, 0]]).tolist() == [False] * 2


@pytest.mark.parametrize("length", [5e-324, 1e-300, 1e-30, 1e30, 1e150, 1e308])
def test_directions_have_any_length(length: float, device: Device) -> None:
    ours = intersector(trimesh.creation.box(extents=[2, 2, 2]), device)
    ray = [[0.25, 0.125, -3]], [[0, 0, length]]
    points = ours.intersects_location(*ray)[0]
    np.testing.assert_allclose(points, [[0.25, 0.125, -1], [0.25, 0.125, 1]], rtol=0, atol=1e-15)
    assert ours.intersects_any(*ray).tolist() == [True]


BAD = [
    (lambda ray: ray.intersects_id([0, 0, 0], [0, 0, 1]), r"ray_origins has shape \(3,\); give \(n, 3\)"),
    (lambda ray: ray.intersects_any(np.zeros((2, 3)), np.ones((1, 3))), "2 ray_origins for 1 ray_directions"),
    (lambda ray: ray.intersects_first(np.zeros((2, 2)), np.ones((2, 2))), r"shape \(2, 2\)"),
    (lambda ray: ray.intersects_location([["a", "b", "c"]], [[0, 0, 1]]), "ray_origins has dtype <U1"),
    (lambda ray: ray.intersects_any([[0, 0, 0]], [[0, 0, 1j]]), "ray_directions has dtype complex128"),
    (lambda ray: ray.intersects_any([[0, 0, 0], [0]], [[0, 0, 1]]), "ray_origins: no array of numbers"),
    (lambda ray: ray.contains_points([0, 0, 0]), r"points has shape \(3,\)"),
]  # fmt: skip


@pytest.mark.parametrize("number", range(len(BAD)))
def test_what_is_refused_is_refused_in_one_line(number: int, device: Device) -> None:
    ask, message = BAD[number]
    for mesh in (trimesh.creation.box(), trimesh.Trimesh()):
        with pytest.raises(InputError, match=message) as caught:
            ask(intersector(mesh, device))
        assert isinstance(caught.value, ValueError)
        assert "\n" not in str(caught.value)


def test_options_are_those_of_build(device: Device) -> None:
    mesh = trimesh.creation.icosphere()
    ours = RayMeshIntersector(mesh, accuracy="exact", layout="hashed", density=3.0, device=device)
    assert (ours.grid.accuracy, ours.grid.layout, ours.grid.device) == ("exact", "hashed", device)
    assert RayMeshIntersector(geometry=mesh, scale_to_box=False).mesh is mesh
    with pytest.raises(InputError, match=r"give one trimesh\.Trimesh"):
        RayMeshIntersector()
    with pytest.raises(InputError, match="accuracy is 'fast'; choose one of robust, precise, exact"):
        RayMeshIntersector(mesh, accuracy="fast")
    with pytest.raises(InputError, match="layout is 'bvh'"):
        RayMeshIntersector(mesh, layout="bvh", device=device).intersects_any([], [])


@pytest.mark.parametrize("name", ["bumpy", "needle_fan", "stacks"])
def test_exact_counts_are_those_of_rational_arithmetic(name: str, device: Device) -> None:
    """Rays at vertices and edges, where two crossings may be nearer than float64 can tell."""
    mesh = bumpy() if name == "bumpy" else theirs(MESHES[name])
    rng = np.random.default_rng(8)
    corners = mesh.triangles.view(np.ndarray)
    starts = mesh.bounds.mean(axis=0) + rng.normal(size=(120, 3)) * 3 * np.ptp(mesh.bounds)
    some = corners[rng.integers(0, len(corners), 120)]
    some[:, 2] = np.where(rng.random((120, 1)) < 0.5, some[:, 1], some[:, 0])
    ways = (some[:, 1] + some[:, 2]) / 2 - starts
    expected = [rational.count(corners, o, d) for o, d in zip(starts, ways, strict=True)]
    ours = intersector(mesh, device, accuracy="exact")
    assert np.bincount(ours.intersects_id(starts, ways)[1], minlength=120).tolist() == expected
    assert ours.intersects_any(starts, ways).tolist() == [count > 0 for count in expected]
