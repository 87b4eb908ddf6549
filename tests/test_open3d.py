"""RaycastingScene: Open3D's answers in Open3D's shapes and dtypes, equal to brute force; what it refuses."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import trimesh
from meshes import MESHES

from clgrid import brute_force, procedural
from clgrid.brute import brute_force_count
from clgrid.device import Device
from clgrid.errors import InputError, MeshError
from clgrid.mesh import Mesh
from clgrid.open3d import RaycastingScene
from clgrid.rational import Triangles, crossings

pytestmark = pytest.mark.host

INVALID = 4294967295
TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0]], np.float32), np.array([[0, 1, 2]], np.uint32)
DTYPES = {
    "t_hit": np.float32,
    "geometry_ids": np.uint32,
    "primitive_ids": np.uint32,
    "primitive_uvs": np.float32,
    "primitive_normals": np.float32,
    "ray_splits": np.uint32,
    "ray_ids": np.uint32,
}
LAST = {"primitive_uvs": (2,), "primitive_normals": (3,)}
CAST = ("t_hit", "geometry_ids", "primitive_ids", "primitive_uvs", "primitive_normals")
LISTED = ("ray_splits", "ray_ids", "geometry_ids", "primitive_ids", "t_hit", "primitive_uvs")
Rays = npt.NDArray[Any]


def moved(mesh: Mesh, by: tuple[float, float, float]) -> tuple[npt.NDArray[Any], npt.NDArray[np.uint32]]:
    return (mesh.vertices + np.asarray(by, mesh.vertices.dtype)), mesh.faces


PARTS = [
    moved(procedural.icosphere(2), (0, 0, 0)),
    (np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint32)),
    moved(procedural.cube(), (0.5, 0.25, 0.125)),
    moved(MESHES["torus"], (-1.5, 0, 0)),
    moved(procedural.cube(), (0.5, 0.25, 0.125)),  # in the same place as geometry 2
]


def one_mesh(parts: list[Any]) -> tuple[Mesh, npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """All triangles as one mesh, and of each its geometry and its number there."""
    vertices, faces, geometries, numbers, base = [], [], [], [], 0
    for geometry, (corners, triangles) in enumerate(parts):
        vertices.append(corners)
        faces.append(triangles + np.uint32(base))
        geometries.append(np.full(len(triangles), geometry))
        numbers.append(np.arange(len(triangles)))
        base += len(corners)
    mesh = Mesh(np.concatenate(vertices), np.concatenate(faces))
    return mesh, np.concatenate(geometries), np.concatenate(numbers)


def some_rays(count: int, seed: int, dtype: Any = np.float32) -> Rays:
    """Half of them towards lattice points, which lie on edges of the cubes."""
    rng = np.random.default_rng(seed)
    origins = rng.uniform(-3, 3, (count, 3))
    targets = rng.uniform(-1.5, 1.5, (count, 3))
    targets[::2] = np.round(targets[::2] * 2) / 2 + [0.0, 0.25, 0.125]
    origins[::4] = targets[::4] + np.array([0.0, 0.0, 4.0])
    return np.concatenate([origins, targets - origins], axis=-1).astype(dtype)


def a_scene(device: Device, parts: list[Any] = PARTS, **options: Any) -> RaycastingScene:
    scene = RaycastingScene(device=device, **options)
    assert [scene.add_triangles(*part) for part in parts] == list(range(len(parts)))
    return scene


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("accuracy", ["exact", "robust"])
def test_casts_equal_brute_force_over_all_geometries(accuracy: str, dtype: Any, device: Device) -> None:
    mesh, geometries, numbers = one_mesh(PARTS)
    rays = some_rays(2000, 1, dtype)
    found = a_scene(device, accuracy=accuracy).cast_rays(rays)
    truth = brute_force(mesh, rays, device=device, accuracy=accuracy)
    hit = truth.mask
    assert {0, 2, 3} <= set(geometries[truth.primitive_ids[hit]])
    assert 0.2 < hit.mean() < 1
    np.testing.assert_array_equal(found["t_hit"], truth.t_hit.astype(np.float32))
    np.testing.assert_array_equal(found["geometry_ids"][hit], geometries[truth.primitive_ids[hit]])
    np.testing.assert_array_equal(found["primitive_ids"][hit], numbers[truth.primitive_ids[hit]])
    np.testing.assert_array_equal(found["primitive_uvs"], truth.primitive_uvs.astype(np.float32))
    np.testing.assert_array_equal(found["primitive_normals"], truth.primitive_normals.astype(np.float32))
    for name in ("geometry_ids", "primitive_ids"):
        assert (found[name][~hit] == INVALID).all()
    assert np.isposinf(found["t_hit"][~hit]).all()
    assert not found["primitive_uvs"][~hit].any()
    assert not found["primitive_normals"][~hit].any()


def test_counts_lists_and_occlusion_are_of_the_same_hits(device: Device) -> None:
    mesh, geometries, numbers = one_mesh(PARTS)
    rays = some_rays(1200, 2)
    scene = a_scene(device)
    counts, listed, first = (
        scene.count_intersections(rays), scene.list_intersections(rays), scene.cast_rays(rays)
    )  # fmt: skip
    np.testing.assert_array_equal(counts, brute_force_count(mesh, rays, device=device, accuracy="exact"))
    np.testing.assert_array_equal(np.diff(listed["ray_splits"].astype(int)), counts)
    np.testing.assert_array_equal(listed["ray_ids"], np.repeat(np.arange(len(rays)), counts))
    np.testing.assert_array_equal(scene.test_occlusions(rays), counts > 0)
    hit = counts > 0
    starts = listed["ray_splits"][:-1][hit]
    for name in ("t_hit", "geometry_ids", "primitive_ids", "primitive_uvs"):
        np.testing.assert_array_equal(listed[name][starts], first[name][hit])
    same = np.diff(listed["ray_ids"].astype(int)) == 0
    assert (np.diff(listed["t_hit"])[same] >= 0).all()
    assert sorted(set(listed["geometry_ids"].tolist())) == [0, 2, 3, 4]
    whole = {(int(g), int(n)): k for k, (g, n) in enumerate(zip(geometries, numbers, strict=True))}
    reference = Triangles.of_mesh(mesh)
    for ray in range(0, 200, 5):
        part = slice(*listed["ray_splits"][ray : ray + 2].tolist())
        pairs = zip(
            listed["geometry_ids"][part].tolist(), listed["primitive_ids"][part].tolist(), strict=True
        )
        crossed = [each for each in crossings(reference, rays[ray, :3], rays[ray, 3:]) if each.t >= 0]
        assert [whole[pair] for pair in pairs] == [each.id for each in crossed]
        np.testing.assert_array_equal(listed["t_hit"][part], np.float32([float(each.t) for each in crossed]))


def test_occlusion_between_tnear_and_tfar(device: Device) -> None:
    scene = a_scene(device, [TRIANGLE])
    rays = np.array([[0.2, 0.1, 1, 0, 0, -1], [10, 10, 10, 1, 0, 0]], np.float32)
    for bounds, first in (
        ({}, True), ({"tfar": 0.5}, False), ({"tnear": 1.5}, False), ({"tnear": 1.0, "tfar": 1.0}, True)
    ):  # fmt: skip
        assert scene.test_occlusions(rays, **bounds).tolist() == [first, False]
    assert scene.test_occlusions(rays, 0.0, 0.5, 4).tolist() == [False, False]


@pytest.mark.parametrize("shape", [(), (11,), (1, 2, 3), (32, 14), (0,), (4, 0), (0, 3)])
def test_results_have_the_leading_shape(shape: tuple[int, ...], device: Device) -> None:
    rays = np.random.default_rng(3).uniform(size=(*shape, 6)).astype(np.float32)
    for scene in (a_scene(device, [TRIANGLE]), RaycastingScene(device=device)):
        found = scene.cast_rays(rays)
        assert tuple(found) == CAST
        for name, array in found.items():
            assert (array.shape, array.dtype) == ((*shape, *LAST.get(name, ())), DTYPES[name])
        counts, occluded = scene.count_intersections(rays), scene.test_occlusions(rays)
        assert (counts.shape, counts.dtype) == (shape, np.int32)
        assert (occluded.shape, occluded.dtype) == (shape, np.bool_)
        inside = scene.compute_occupancy(rays[..., :3])
        assert (inside.shape, inside.dtype) == (shape, np.float32)
        listed = scene.list_intersections(rays)
        assert tuple(listed) == LISTED
        for name, array in listed.items():
            length = int(np.prod(shape)) + 1 if name == "ray_splits" else int(counts.sum())
            assert (array.shape, array.dtype) == ((length, *LAST.get(name, ())), DTYPES[name])


def test_an_empty_scene_is_missed_until_there_is_something(device: Device) -> None:
    scene = RaycastingScene(device=device)
    ray = [[0.2, 0.1, 1, 0, 0, -1]]
    found = scene.cast_rays(ray)
    assert found["geometry_ids"].tolist() == found["primitive_ids"].tolist() == [INVALID]
    assert RaycastingScene.INVALID_ID == scene.INVALID_ID == INVALID
    assert scene.add_triangles([[5, 5, 5]], np.zeros((0, 3), int)) == 0
    assert scene.cast_rays(ray)["t_hit"].tolist() == [np.inf]
    assert scene.add_triangles(*TRIANGLE) == 1
    assert scene.cast_rays(ray)["geometry_ids"].tolist() == [1]
    nearer = TRIANGLE[0] + np.float32([0, 0, 0.5])
    assert scene.add_triangles(nearer, TRIANGLE[1]) == 2
    nearer[:] = 9  # added arrays are copies
    found = scene.cast_rays(ray)
    assert (found["geometry_ids"].tolist(), found["primitive_ids"].tolist()) == ([2], [0])
    assert found["t_hit"].tolist() == [0.5]
    assert repr(scene) == "RaycastingScene(3 geometries, 2 triangles)"
    grid = scene.grid
    assert grid is scene.grid


def test_an_edge_of_a_closed_mesh_is_crossed_once(device: Device) -> None:
    """The diagonal of a cube's faces, which two triangles have."""
    scene = a_scene(device, [moved(procedural.cube(), (0, 0, 0))])
    low, high = scene.grid.mesh.bounds
    middle = (low + high) / 2
    rays = np.array([[*middle[:2], low[2] - 1, 0, 0, 1], [*middle, 0, 0, 1], [9, 9, 9, 1, 0, 0]], np.float32)
    assert scene.count_intersections(rays).tolist() == [2, 1, 0]
    listed = scene.list_intersections(rays)
    size = high[2] - low[2]
    assert listed["t_hit"].tolist() == [1, 1 + size, size / 2]
    assert scene.compute_occupancy([middle, low - 0.5]).tolist() == [1, 0]


def test_occupancy_is_exact_parity(device: Device) -> None:
    ball = procedural.icosphere(2)
    scene = a_scene(device, [(ball.vertices, ball.faces)])
    axis = np.linspace(-1.1, 1.1, 9)
    points = np.stack(np.meshgrid(axis, axis, axis), axis=-1).astype(np.float32)
    inside = scene.compute_occupancy(points)
    np.testing.assert_array_equal(inside, scene.grid.contains(points))
    radii = np.linalg.norm(points, axis=-1)
    assert (inside[radii < 0.9] == 1).all()
    assert (inside[radii > 1.01] == 0).all()
    np.testing.assert_array_equal(scene.compute_occupancy(points, nsamples=3), inside)
    for samples in (0, 2, -1):
        with pytest.raises(InputError, match="odd"):
            scene.compute_occupancy(points, nsamples=samples)


class FakeTensor:
    """A tensor of another device: only what is read of one."""

    def __init__(self, array: npt.NDArray[Any], on_host: bool = False) -> None:
        self.array, self.on_host = array, on_host

    def cpu(self) -> FakeTensor:
        return FakeTensor(self.array, True)

    def numpy(self) -> npt.NDArray[Any]:
        assert self.on_host
        return self.array


def as_they_come(vertices: Any, faces: Any) -> list[Any]:
    tensors = FakeTensor(vertices), FakeTensor(faces.astype(np.int64))
    vertex, triangle = {"positions": tensors[0]}, {"indices": tensors[1]}
    return [
        Mesh(vertices, faces),
        trimesh.Trimesh(vertices, faces, process=False),
        SimpleNamespace(vertex=vertex, triangle=triangle),
        SimpleNamespace(vertices=vertices.tolist(), triangles=faces.tolist()),
    ]


def test_meshes_of_all_kinds_are_the_same(device: Device) -> None:
    vertices, faces = PARTS[3]
    rays = some_rays(300, 4)
    by_arrays = a_scene(device, [(vertices, faces)]).cast_rays(rays)
    ways: list[Callable[[RaycastingScene], int]] = [
        *(lambda scene, mesh=mesh: scene.add_triangles(mesh) for mesh in as_they_come(vertices, faces)),
        lambda scene: scene.add_triangles(mesh=Mesh(vertices, faces)),
        lambda scene: scene.add_triangles(vertex_positions=vertices[::1], triangle_indices=faces[:, ::1]),
        lambda scene: scene.add_triangles(np.asfortranarray(vertices), faces.astype(np.int16)),
        lambda scene: scene.add_triangles(FakeTensor(vertices), FakeTensor(faces)),
    ]
    for add in ways:
        scene = RaycastingScene(device=device)
        assert add(scene) == 0
        found = scene.cast_rays(FakeTensor(rays))
        for name, array in by_arrays.items():
            np.testing.assert_array_equal(found[name], array)


def test_a_mesh_of_many_geometries_is_one(device: Device) -> None:
    mesh = Mesh(np.concatenate([TRIANGLE[0], TRIANGLE[0] + 3]), np.arange(6, dtype=np.uint32).reshape(2, 3),
                None, np.array([0, 1, 2], np.int64), ("a", "b"))  # fmt: skip
    scene = RaycastingScene(device=device)
    assert [scene.add_triangles(mesh), scene.add_triangles(mesh)] == [0, 1]
    found = scene.cast_rays([[3.2, 3.1, 9, 0, 0, -1]])
    assert (found["geometry_ids"].tolist(), found["primitive_ids"].tolist()) == ([0], [1])


def test_doubles_are_kept(device: Device) -> None:
    """A triangle and a ray that float32 would not tell apart from a miss."""
    near = np.array([[0, 0, 0], [1, 0, 0], [0, 1e-12, 0]]) + np.array([1, 1, 0])
    scene = a_scene(device, [TRIANGLE, (near, [[0, 1, 2]])])
    found = scene.cast_rays([[1.125, 1 + 5e-13, 1, 0, 0, -1], [1.125, 1 + 2e-12, 1, 0, 0, -1]])
    assert found["geometry_ids"].tolist() == [1, INVALID]


def test_a_hit_beyond_float32_is_no_miss(device: Device) -> None:
    scene = a_scene(device, [TRIANGLE])
    found = scene.cast_rays(np.array([[0.5, 0.25, 1, 0, 0, -1e-60]]))
    assert found["t_hit"].tolist() == [np.finfo(np.float32).max]
    assert found["geometry_ids"].tolist() == [0]


BAD_RAYS = [
    (lambda scene: scene.cast_rays(np.zeros((4, 5))), r"rays have shape \(4, 5\)"),
    (lambda scene: scene.cast_rays(3.0), r"rays"),
    (lambda scene: scene.cast_rays(np.zeros((4, 6), complex)), "dtype complex128"),
    (lambda scene: scene.cast_rays([["a"] * 6]), "dtype <U1"),
    (lambda scene: scene.cast_rays([[1, 2], [3]]), "arrays of numbers"),
    (lambda scene: scene.count_intersections(np.zeros((2, 3))), r"\(2, 3\)"),
    (lambda scene: scene.list_intersections(np.zeros((2, 7))), r"\(2, 7\)"),
    (lambda scene: scene.test_occlusions(np.zeros(5)), r"\(5,\)"),
    (lambda scene: scene.test_occlusions(np.zeros((2, 6)), "near"), "t_min and t_max"),
    (lambda scene: scene.compute_occupancy(np.zeros((2, 6))), r"\(2, 6\)"),
]  # fmt: skip


@pytest.mark.parametrize("number", range(len(BAD_RAYS)))
def test_bad_rays_are_one_clear_error(number: int, device: Device) -> None:
    ask, message = BAD_RAYS[number]
    for scene in (a_scene(device, [TRIANGLE]), RaycastingScene(device=device)):
        with pytest.raises(InputError, match=message):
            ask(scene)


FINE, THREE = TRIANGLE
BAD_MESHES: list[tuple[tuple[Any, ...], dict[str, Any], str]] = [
    ((FINE[:, :2], THREE), {}, r"vertices has shape \(3, 2\)"),
    ((FINE, THREE[0]), {}, r"faces has shape \(3,\)"),
    ((FINE, THREE.astype(float)), {}, "triangles have dtype float64; give integers"),
    ((FINE, THREE > 0), {}, "triangles have dtype bool"),
    ((FINE.astype(complex), THREE), {}, "vertices have dtype complex128"),
    (([["a", "b", "c"]], THREE), {}, "vertices have dtype <U1"),
    (([[1, 2], [3]], THREE), {}, "vertices are no array of numbers"),
    ((FINE, [[0, 1, 3]]), {}, "name a missing vertex"),
    ((FINE, [[0, 1, -1]]), {}, "name vertices -1 to 1; count vertices from 0"),
    ((FINE, [[0, 1, 2**32]]), {}, "name vertices 0 to 4294967296"),
    ((FINE * np.float32(np.nan), THREE), {}, "NaN or infinite"),
    (("bunny.ply",), {}, "a str is no mesh"),
    ((), {}, "a NoneType is no mesh"),
    ((SimpleNamespace(vertex={}, triangle={}),), {}, "the mesh has no positions"),
    ((FINE, THREE), {"mesh": Mesh(FINE, THREE)}, "give one of them"),
]


@pytest.mark.parametrize("number", range(len(BAD_MESHES)))
def test_bad_meshes_are_one_clear_error_and_change_nothing(number: int, device: Device) -> None:
    args, kwargs, message = BAD_MESHES[number]
    scene = a_scene(device, [TRIANGLE])
    with pytest.raises(MeshError, match=f"geometry 1: .*{message}"):
        scene.add_triangles(*args, **kwargs)
    assert scene.add_triangles(*TRIANGLE) == 1
    assert scene.grid.mesh.triangle_count == 2


def test_the_script_wants_a_checkout(tmp_path: Path) -> None:
    script = Path(__file__).resolve().parent.parent / "scripts" / "upstream_open3d"
    done = subprocess.run([sys.executable, str(script), str(tmp_path)], capture_output=True, text=True)
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 1
    assert "test_raycasting_scene.py is not there" in done.stderr
