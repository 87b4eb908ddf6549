"""RaycastingScene's distances and closest points: those of all triangles asked in turn; Open3D's shapes."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from test_open3d import PARTS, TRIANGLE, one_mesh
from trimesh.triangles import closest_point

from clgrid import procedural
from clgrid.device import Device
from clgrid.errors import ClgridError, InputError, UnsupportedError
from clgrid.mesh import Mesh
from clgrid.open3d import RaycastingScene

pytestmark = pytest.mark.host

INVALID = RaycastingScene.INVALID_ID
KEYS = {
    "points": (np.float32, (3,)),
    "geometry_ids": (np.uint32, ()),
    "primitive_ids": (np.uint32, ()),
    "primitive_uvs": (np.float32, (2,)),
    "primitive_normals": (np.float32, (3,)),
}


@pytest.fixture(autouse=True)
def _libigl() -> None:
    pytest.importorskip("igl", reason="libigl is not installed: the extra distances")


def a_scene(parts: list[Any], device: Device | None = None) -> RaycastingScene:
    scene = RaycastingScene(device=device)
    for part in parts:
        scene.add_triangles(*part)
    return scene


def some_points(count: int, seed: int) -> npt.NDArray[np.float32]:
    """A third of them near lattice points, where faces, edges and vertices of the cubes are."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-3, 3, (count, 3))
    points[::3] = np.round(points[::3]) + np.array([0.5, 0.25, 0.125])
    return points.astype(np.float32)


def test_closest_points_are_those_of_all_triangles_asked_in_turn() -> None:
    mesh, geometries, numbers = one_mesh(PARTS)
    points = some_points(300, 1)
    scene = a_scene(PARTS)
    found = scene.compute_closest_points(points)
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    each = np.stack([closest_point(corners, np.tile(point, (len(corners), 1))) for point in points])
    distances = np.linalg.norm(each - points[:, None], axis=-1)
    np.testing.assert_allclose(scene.compute_distance(points), distances.min(1), rtol=1e-6, atol=1e-12)
    triangles = np.array(
        [
            np.flatnonzero((geometries == geometry) & (numbers == number))[0]
            for geometry, number in zip(found["geometry_ids"], found["primitive_ids"], strict=True)
        ]
    )
    # Geometry 4 is where geometry 2 is, and either may be named.
    assert {2 if each == 4 else each for each in found["geometry_ids"].tolist()} == {0, 2, 3}
    rows = np.arange(len(points))
    np.testing.assert_allclose(distances[rows, triangles], distances.min(1), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(found["points"], each[rows, triangles], atol=1e-6)
    u, v = found["primitive_uvs"].astype(np.float64).T
    weighted = np.einsum("ni,nij->nj", np.stack([1 - u - v, u, v], -1), corners[triangles])
    np.testing.assert_allclose(weighted, found["points"], atol=2e-6)
    normals = np.cross(*(corners[triangles, k] - corners[triangles, 0] for k in (1, 2)))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    np.testing.assert_allclose(found["primitive_normals"], normals, atol=1e-6)


def test_the_sign_is_inside(device: Device) -> None:
    scene = a_scene(PARTS[:1], device)
    points = some_points(300, 2) / 2
    signed, inside = scene.compute_signed_distance(points), scene.compute_occupancy(points)
    np.testing.assert_array_equal(np.abs(signed), scene.compute_distance(points))
    assert 0.02 < inside.mean() < 0.5
    np.testing.assert_array_equal(signed < 0, inside == 1)
    np.testing.assert_array_equal(scene.compute_signed_distance(points, nsamples=3), signed)
    with pytest.raises(InputError, match="nsamples is 2"):
        scene.compute_signed_distance(points, nsamples=2)


def test_a_vertex_is_at_distance_zero(device: Device) -> None:
    cube = procedural.cube()
    scene = a_scene([(cube.vertices, cube.faces)], device)
    assert scene.compute_distance(cube.vertices).tolist() == [0] * len(cube.vertices)
    assert scene.compute_signed_distance(cube.vertices).tolist() == [0] * len(cube.vertices)
    low, high = cube.bounds
    assert scene.compute_signed_distance((low + high) / 2) == -(high[0] - low[0]) / 2


@pytest.mark.parametrize("shape", [(), (11,), (1, 2, 3), (32, 14), (0,), (4, 0), (0, 3)])
def test_results_have_the_leading_shape(shape: tuple[int, ...], device: Device) -> None:
    points = np.zeros((*shape, 3))
    for scene in (a_scene([TRIANGLE], device), RaycastingScene(device=device)):
        found = scene.compute_closest_points(points)
        assert list(found) == list(KEYS)
        for name, (dtype, last) in KEYS.items():
            assert (found[name].shape, found[name].dtype) == ((*shape, *last), dtype)
        for distances in (scene.compute_distance(points), scene.compute_signed_distance(points)):
            assert (distances.shape, distances.dtype) == (shape, np.float32)


def test_what_is_near_nothing() -> None:
    odd = [[np.nan, 0, 0], [0, np.inf, 0], [0.25, 0.125, 2]]
    scene = RaycastingScene()
    assert scene.compute_distance(odd[2:]).tolist() == [np.inf]
    assert np.isnan(scene.compute_closest_points(odd)["points"]).all()
    scene.add_triangles(*TRIANGLE)
    assert scene.compute_distance(odd).tolist()[2:] == [2]
    assert np.isnan(scene.compute_distance(odd)[:2]).all()
    found = scene.compute_closest_points(odd)
    assert found["geometry_ids"].tolist() == found["primitive_ids"].tolist() == [INVALID, INVALID, 0]
    assert np.isnan(found["points"][:2]).all()
    assert not found["primitive_uvs"][:2].any()


def test_what_is_added_later_counts() -> None:
    scene = a_scene([TRIANGLE])
    point = [[0.5, 0.25, 2.0]]
    assert scene.compute_distance(point).tolist() == [2]
    scene.add_triangles(TRIANGLE[0] + np.float32([0, 0, 1]), TRIANGLE[1])
    assert scene.compute_distance(point).tolist() == [1]
    assert scene.compute_closest_points(point)["geometry_ids"].tolist() == [1]


@pytest.mark.parametrize("exponent", [-600, -60, 0, 60, 600])
def test_any_size_is_as_good(exponent: int) -> None:
    """Scaled by powers of two, which rounds nothing; float32 holds no distance of the largest."""
    ball, points = procedural.icosphere(2), some_points(200, 3).astype(np.float64)
    near = a_scene([(ball.vertices.astype(np.float64), ball.faces)]).compute_closest_points(points)
    scaled = a_scene([(np.ldexp(ball.vertices.astype(np.float64), exponent), ball.faces)])
    found = scaled.compute_closest_points(np.ldexp(points, exponent))
    for name in ("primitive_ids", "primitive_uvs", "primitive_normals"):
        np.testing.assert_array_equal(found[name], near[name])
    assert np.isfinite(found["points"]).all()
    assert np.isfinite(scaled.compute_distance(np.ldexp(points, exponent))).all()


def test_triangles_without_area_are_segments_and_points() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [3, 4, 5], [np.nan, 0, 0]])
    scene = RaycastingScene()
    scene.add_triangles(Mesh(vertices, np.array([[0, 1, 0], [2, 2, 2]], np.uint32)))
    points = [[0.5, 2, 0], [4, 0, 0], [3, 4, 6]]
    found = scene.compute_closest_points(points)
    assert found["points"].tolist() == [[0.5, 0, 0], [1, 0, 0], [3, 4, 5]]
    assert found["primitive_ids"].tolist() == [0, 0, 1]
    assert scene.compute_distance(points).tolist() == [2, 3, 1]
    assert not found["primitive_uvs"].any()
    assert not found["primitive_normals"].any()


BAD_POINTS = {
    "shape (2,); give (..., 3)": [1.0, 2.0],
    "shape (1, 6); give (..., 3)": np.zeros((1, 6)),
    "dtype complex128": np.zeros((1, 3), complex),
    "no array of numbers": [[1, 2, 3], [1]],
}


@pytest.mark.parametrize("message", BAD_POINTS)
def test_bad_points_are_one_clear_error(message: str) -> None:
    for scene in (a_scene([TRIANGLE]), RaycastingScene()):
        for ask in (scene.compute_distance, scene.compute_closest_points):
            with pytest.raises(InputError) as refused:
                ask(BAD_POINTS[message])
            assert message in str(refused.value)


def test_without_the_library_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "igl", None)
    scene = a_scene([TRIANGLE])
    for ask in (scene.compute_distance, scene.compute_closest_points):
        with pytest.raises(UnsupportedError, match=r"pip install 'clgrid\[distances\]'$") as refused:
            ask([[0, 0, 0]])
        assert "\n" not in str(refused.value)
    assert issubclass(UnsupportedError, ClgridError)
    assert issubclass(UnsupportedError, NotImplementedError)
