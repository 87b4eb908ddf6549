"""Mesh arrays: what is accepted, what is refused and in which words."""

from __future__ import annotations

import numpy as np
import pytest

import clgrid.mesh
from clgrid.errors import MeshError
from clgrid.mesh import Mesh
from clgrid.outermost import extent

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
FACES = np.array([[0, 1, 2], [0, 2, 3]], np.uint32)


def test_a_plain_mesh_has_one_unnamed_geometry() -> None:
    mesh = Mesh(SQUARE, FACES)
    assert mesh.triangle_count == 2
    assert mesh.geometry_names == ("",)
    assert mesh.geometry_starts.tolist() == [0, 2]
    assert mesh.nbytes == 48 + 24 + 16


def test_bounds_are_of_used_vertices_only() -> None:
    vertices = np.concatenate([SQUARE, [[9, 9, 9]]]).astype(np.float32)
    bounds = Mesh(vertices, FACES).bounds
    assert bounds.dtype == np.float64
    assert bounds.tolist() == [[0, 0, 0], [1, 1, 0]]
    with pytest.raises(ValueError, match="read-only"):
        bounds[0, 0] = 1


@pytest.mark.parametrize("count", [1, 2, 3, 255, 256, 257, 511, 512, 513, 5000])
def test_bounds_of_any_number_of_vertices(count: int) -> None:
    """Of few different numbers, so that several vertices are outermost; some not in use, some NaN."""
    rng = np.random.default_rng(count)
    for dtype in (np.float32, np.float64, np.float32, np.float64):
        points = rng.integers(-9, 9, (count, 3)).astype(dtype)
        np.testing.assert_array_equal(extent(points), [points.min(axis=0), points.max(axis=0)])
        points[rng.integers(count), rng.integers(3)] = np.nan
        np.testing.assert_array_equal(extent(points), [points.min(axis=0), points.max(axis=0)])
        faces = rng.integers(count, size=(count // 4 + 1, 3)).astype(np.uint32)
        faces = faces[~np.isnan(points[faces]).any(axis=(1, 2))]
        if len(faces):
            used = points[np.unique(faces)]
            np.testing.assert_array_equal(Mesh(points, faces).bounds, [used.min(axis=0), used.max(axis=0)])


def test_a_moved_mesh_is_checked_as_a_new_one() -> None:
    mesh = Mesh(SQUARE, FACES, np.ones((4, 3), np.float32), source="m", warnings=("w",))
    assert mesh.bounds.tolist() == [[0, 0, 0], [1, 1, 0]]
    moved = mesh.moved(SQUARE * np.float32(2))
    assert moved.bounds.tolist() == [[0, 0, 0], [2, 2, 0]]
    assert (moved.vertex_normals, moved.source, moved.warnings) == (None, "m", ("w",))
    assert (moved.faces is mesh.faces, moved.geometry_names) == (True, ("",))
    for bad, message in ((np.full_like(SQUARE, np.nan), "NaN"), (SQUARE.astype(np.int64), "dtype int64")):
        with pytest.raises(MeshError, match=message):
            mesh.moved(bad)


def test_bounds_of_nothing_are_refused() -> None:
    empty = Mesh(SQUARE, np.zeros((0, 3), np.uint32), source="nothing.ply")
    with pytest.raises(MeshError, match=r"nothing\.ply: no triangles"):
        _ = empty.bounds


def test_geometry_ids() -> None:
    faces = np.repeat(FACES, 3, axis=0)
    mesh = Mesh(SQUARE, faces, geometry_starts=np.array([0, 2, 2, 6]), geometry_names=("a", "none", "b"))
    assert mesh.geometry_ids(np.array([[-1, 0, 1], [2, 5, -1]])).tolist() == [[-1, 0, 0], [2, 2, -1]]


def test_unused_vertices_may_be_anything() -> None:
    vertices = np.concatenate([SQUARE, [[np.nan, np.inf, 0]]]).astype(np.float32)
    assert Mesh(vertices, FACES).bounds.tolist() == [[0, 0, 0], [1, 1, 0]]


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_non_finite_vertices_in_use_are_counted_and_named(bad: float, dtype: type) -> None:
    vertices = np.concatenate([SQUARE, SQUARE]).astype(dtype)
    vertices[3, 1] = vertices[5, 0] = bad
    faces = np.concatenate([FACES, FACES + np.uint32(4)])
    with pytest.raises(
        MeshError, match=r"^m: 2 vertices in use are NaN or infinite, first vertex 3 .*triangle 1 of"
    ):
        Mesh(vertices, faces, source="m", geometry_starts=np.array([0, 2, 4]), geometry_names=("a", "b"))


def test_index_beyond_the_vertices() -> None:
    with pytest.raises(MeshError, match=r"1 of 1 triangles"):
        Mesh(SQUARE, np.array([[0, 1, 4]], np.uint32))
    faces = np.array([[0, 1, 2], [0, 4, 2], [0, 1, 2**32 - 1]], np.uint32)
    with pytest.raises(
        MeshError, match=r"^m: 2 of 3 triangles name a missing vertex, first triangle 1: vertex 4 of 4"
    ):
        Mesh(SQUARE, faces, source="m")


@pytest.mark.parametrize(
    ("vertices", "faces", "normals"),
    [
        (SQUARE.astype(np.float16), FACES, None),
        (SQUARE.astype(np.int32), FACES, None),
        (SQUARE.astype(">f4"), FACES, None),
        (SQUARE[:, :2], FACES, None),
        (SQUARE.ravel(), FACES, None),
        (np.asfortranarray(SQUARE), FACES, None),
        (SQUARE.tolist(), FACES, None),
        (SQUARE, FACES.astype(np.int64), None),
        (SQUARE, FACES.astype(np.int32), None),
        (SQUARE, FACES.ravel(), None),
        (SQUARE, FACES[:, [0, 1, 2, 2]], None),
        (SQUARE, FACES[:, ::-1], None),
        (SQUARE, FACES, SQUARE[:3]),
        (SQUARE, FACES, SQUARE.astype(np.float64)),
    ],
)
def test_wrong_shapes_and_types_are_refused(vertices: object, faces: object, normals: object) -> None:
    with pytest.raises(MeshError, match=r"^<arrays>: .*give|require") as caught:
        Mesh(vertices, faces, normals)  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("starts", [[0, 1], [1, 2, 2], [0, 2, 1], [0, 3, 2], [0, 2, 3]])
def test_geometry_starts_must_partition_the_triangles(starts: list[int]) -> None:
    with pytest.raises(MeshError, match="geometry_starts"):
        Mesh(SQUARE, FACES, geometry_starts=np.array(starts), geometry_names=("a", "b"))


@pytest.mark.parametrize("limit", [1, 3])
def test_more_than_32_bits_of_rows_are_refused(monkeypatch: pytest.MonkeyPatch, limit: int) -> None:
    monkeypatch.setattr(clgrid.mesh, "MAX_COUNT", limit)
    with pytest.raises(MeshError, match=f"at most {limit} fit"):
        Mesh(SQUARE, FACES)


def test_the_limit_leaves_one_index_free() -> None:
    assert clgrid.mesh.MAX_COUNT == 0xFFFFFFFE
