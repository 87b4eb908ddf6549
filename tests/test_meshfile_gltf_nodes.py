"""glTF scenes: node trees flattened with their transforms, and cameras."""

from __future__ import annotations

import gzip
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from gltf_files import (
    TETRAHEDRON,
    TETRAHEDRON_FACES,
    TETRAHEDRON_NORMALS,
    GltfFile,
    corners,
    refused,
    tetrahedron,
    translated,
    volume,
)
from hypothesis import given
from hypothesis import strategies as st
from mesh_files import QUICK
from scenes import scene

from clgrid.errors import MeshError
from clgrid.mesh import load
from clgrid.meshfile.gltf_cameras import read_cameras


def test_nested_transforms_equal_their_product(tmp_path: Path) -> None:
    turn = float(np.sqrt(0.5))
    mesh = load(
        tetrahedron(
            {"children": [1], "translation": [10, 0, 0], "rotation": [0, 0, turn, turn]},
            {"children": [2], "scale": [2, 3, 4]},
            {"mesh": 0, "matrix": translated(1, 1, 1), "name": "leaf"},
            roots=[0],
        ).write_glb(tmp_path / "a.glb")
    )
    # p -> p + 1, times (2, 3, 4), a quarter turn about z, then 10 to the right
    scaled = (TETRAHEDRON + 1) * [2, 3, 4]
    expected = np.stack([10 - scaled[:, 1], scaled[:, 0], scaled[:, 2]], axis=1)
    np.testing.assert_allclose(mesh.vertices, expected, rtol=1e-6)
    assert mesh.vertices.dtype == np.float32
    assert mesh.geometry_names == ("leaf",)
    assert volume(mesh) == pytest.approx(24 / 6)


def test_instances_become_geometries(tmp_path: Path) -> None:
    nodes = [{"mesh": 0, "name": f"n{k}", "translation": [3 * k, 0, 0]} for k in range(3)]
    mesh = load(tetrahedron(*nodes, roots=[2, 0]).write_glb(tmp_path / "a.glb"))
    assert mesh.geometry_names == ("n2", "n0")
    assert mesh.geometry_starts.tolist() == [0, 4, 8]
    assert mesh.bounds.tolist() == [[0, 0, 0], [7, 1, 1]]
    assert mesh.geometry_ids(np.array([3, 4])).tolist() == [0, 1]


@given(
    matrix=st.lists(st.floats(-4, 4), min_size=9, max_size=9).map(lambda v: np.array(v).reshape(3, 3)),
)
@QUICK
def test_normals_stay_perpendicular_and_outward(tmp_path: Path, matrix: npt.NDArray[np.float64]) -> None:
    """Whatever the matrix does: the face normals of a closed mesh, given as vertex normals, stay those."""
    if abs(np.linalg.det(matrix)) < 0.05:
        return
    soup = TETRAHEDRON[TETRAHEDRON_FACES].reshape(-1, 3)
    flat = np.cross(soup[1::3] - soup[::3], soup[2::3] - soup[::3]).repeat(3, axis=0).astype(np.float32)
    file = GltfFile()
    file.mesh({"attributes": {"POSITION": file.accessor(soup), "NORMAL": file.accessor(flat)}})
    world = np.eye(4)
    world[:3, :3] = matrix
    file.nodes({"mesh": 0, "matrix": world.T.reshape(-1).tolist()})
    mesh = load(file.write_glb(tmp_path / "a.glb"))
    a, b, c = corners(mesh).astype(np.float64).transpose(1, 0, 2)
    expected = np.cross(b - a, c - a)
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    assert mesh.vertex_normals is not None
    for corner in range(3):
        found = mesh.vertex_normals[mesh.faces[:, corner]]
        np.testing.assert_allclose(found, expected, atol=2e-4)
    assert volume(mesh) > 0


def test_normals_of_a_flattened_node(tmp_path: Path) -> None:
    mesh = load(tetrahedron({"mesh": 0, "scale": [1, 1, 0]}).write_glb(tmp_path / "a.glb"))
    assert mesh.vertex_normals is not None
    assert mesh.vertex_normals.tolist() == [[0, 0, -1], [0, 0, -1], [0, 0, -1], [0, 0, 1]]
    none = load(tetrahedron({"mesh": 0, "scale": [0, 0, 0]}).write_glb(tmp_path / "b.glb"))
    assert none.vertex_normals is not None
    assert not none.vertex_normals.any()


def test_nodes_far_from_the_origin_keep_doubles(tmp_path: Path) -> None:
    far = load(tetrahedron({"mesh": 0, "translation": [1e7 + 0.1, 0, 0]}).write_glb(tmp_path / "a.glb"))
    assert far.vertices.dtype == np.float64
    assert far.vertices[:, 0].tolist() == [1e7 + 0.1, 1e7 + 1.1, 1e7 + 0.1, 1e7 + 0.1]
    near = load(tetrahedron({"mesh": 0, "translation": [9.1, 0, 0]}).write_glb(tmp_path / "b.glb"))
    assert near.vertices.dtype == np.float32


def test_overflow_in_a_transform_is_named(tmp_path: Path) -> None:
    path = tetrahedron({"mesh": 0, "scale": [1e308, 1, 1], "children": []}).write_glb(tmp_path / "a.glb")
    assert load(path).bounds[1, 0] == 1e308
    nodes = ({"scale": [1e308, 1, 1], "children": [1]}, {"mesh": 0, "scale": [1e308, 1, 1]})
    assert "NaN or infinite" in refused(tetrahedron(*nodes, roots=[0]).write_glb(tmp_path / "a.glb"))


@pytest.mark.parametrize(
    ("children", "message"),
    [
        ([[1], [0]], "cycle"),
        ([[0]], "cycle"),
        ([[1], [2], [1]], "two parents"),
        ([[2], [2], []], "two parents"),
        ([[], [2], [1]], "cycle"),
    ],
)
@pytest.mark.parametrize("with_scene", [True, False])
def test_node_graphs_that_are_no_trees(
    tmp_path: Path, children: list[list[int]], message: str, with_scene: bool
) -> None:
    file = tetrahedron(*({"mesh": 0, "children": below} for below in children), roots=[0])
    if not with_scene:
        del file.json["scenes"], file.json["scene"]
    path = file.write_glb(tmp_path / "a.glb")
    assert message in refused(path)
    with pytest.raises(MeshError, match=message):
        read_cameras(path)


def test_deep_trees_do_not_overflow(tmp_path: Path) -> None:
    nodes: list[dict[str, Any]] = [{"children": [k + 1], "translation": [0, 0, 1]} for k in range(3000)]
    mesh = load(tetrahedron(*nodes, {"mesh": 0}, roots=[0]).write_glb(tmp_path / "a.glb"))
    assert mesh.bounds[0].tolist() == [0, 0, 3000]


def test_instances_beyond_memory_are_refused(tmp_path: Path) -> None:
    """Little JSON, many triangles: refused by their number, before anything is allocated."""
    file = GltfFile()
    position = file.accessor(np.zeros((3, 3), np.float32))
    index = file.accessor(np.zeros(300_000, np.uint8))
    file.mesh(*[{"attributes": {"POSITION": position}, "indices": index}] * 50)
    file.nodes(*[{"mesh": 0}] * 1000)
    assert "at most 4294967294 fit" in refused(file.write_glb(tmp_path / "a.glb"))


def test_without_scenes_everything_counts(tmp_path: Path) -> None:
    file = tetrahedron({"children": [1]}, {"mesh": 0, "translation": [1, 0, 0]}, {"mesh": 0}, roots=[2])
    assert load(file.write_glb(tmp_path / "a.glb")).triangle_count == 4
    del file.json["scenes"], file.json["scene"]
    assert load(file.write_glb(tmp_path / "a.glb")).bounds.tolist() == [[0, 0, 0], [2, 1, 1]]
    del file.json["nodes"]
    assert load(file.write_glb(tmp_path / "a.glb")).bounds.tolist() == [[0, 0, 0], [1, 1, 1]]


def test_what_is_not_applied_is_said(tmp_path: Path) -> None:
    file = tetrahedron({"mesh": 0}, {"mesh": 0, "extensions": {"EXT_mesh_gpu_instancing": {}}})
    file.json["extensionsRequired"] = ["KHR_materials_unlit", "ACME_shape"]
    text = "\n".join(load(file.write_glb(tmp_path / "a.glb")).warnings)
    for part in (
        "not instanced (1)",
        "ACME_shape",
    ):
        assert part in text
    assert "KHR_materials_unlit" not in text


def test_non_finite_positions_and_normals(tmp_path: Path) -> None:
    file = tetrahedron()
    before, _, after = file.data.rpartition(TETRAHEDRON_NORMALS[3].tobytes())
    file.data = before + np.full(3, np.nan, np.float32).tobytes() + after
    mesh = load(file.write_glb(tmp_path / "a.glb"))
    assert mesh.vertex_normals is not None
    assert mesh.vertex_normals[3].tolist() == [0, 0, 0]
    assert "NaN or infinite (1)" in mesh.warnings[0]
    file = tetrahedron({"mesh": 0}, {"mesh": 0, "scale": [2, 2, 2]})
    file.data = file.data[:36] + np.array([0, np.inf, 1], np.float32).tobytes() + file.data[48:]
    assert "2 vertices in use are NaN or infinite, first vertex 3" in refused(
        file.write_glb(tmp_path / "b.glb")
    )


def camera_file() -> GltfFile:
    file = tetrahedron(
        {"mesh": 0},
        {"children": [2], "translation": [0, 0, 5]},
        {"camera": 0, "rotation": [0, 1, 0, 0], "name": "back"},
        {"camera": 1, "matrix": translated(1, 2, 3)},
        {"camera": 0, "name": "unused"},
        roots=[0, 1, 3],
    )
    file.json["cameras"] = [
        {
            "type": "perspective",
            "name": "lens",
            "perspective": {"yfov": 0.7, "aspectRatio": 1.5, "znear": 0.01},
        },
        {
            "type": "orthographic",
            "name": "plan",
            "orthographic": {"xmag": 4, "ymag": 2, "znear": 0, "zfar": 9},
        },
    ]
    return file


@pytest.mark.parametrize("suffix", [".glb", ".gltf", ".gltf.gz"])
def test_cameras_of_the_scene(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / ("a" + suffix)
    (camera_file().write_glb if suffix == ".glb" else camera_file().write_gltf)(path)
    if suffix.endswith("gz"):
        path.write_bytes(gzip.compress(path.read_bytes()))
    back, plan = read_cameras(path)
    assert (back.name, back.yfov, back.ymag, back.aspect, back.znear) == ("back", 0.7, None, 1.5, 0.01)
    assert back.matrix.dtype == np.float64
    # half a turn about y looks along +z
    expected = [[-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, 5], [0, 0, 0, 1]]
    np.testing.assert_allclose(back.matrix, expected, atol=1e-15)
    assert (plan.name, plan.yfov, plan.ymag, plan.aspect, plan.znear) == ("plan", None, 2, 2, 0)
    assert plan.matrix[:3, 3].tolist() == [1, 2, 3]


def test_cameras_of_other_files(tmp_path: Path) -> None:
    assert read_cameras(tetrahedron().write_glb(tmp_path / "a.glb")) == ()
    assert read_cameras(tmp_path / "never opened.ply") == ()
    with pytest.raises(MeshError, match="cannot be opened"):
        read_cameras(tmp_path / "missing.glb")


@pytest.mark.parametrize(
    ("camera", "message"),
    [
        ({"type": "perspective"}, "without its lens"),
        ({"type": "fisheye", "perspective": {"yfov": 1, "znear": 1}}, "'fisheye'"),
        ({"type": "perspective", "perspective": {"yfov": "1", "znear": 1}}, "wrong type"),
    ],
)
def test_malformed_cameras(tmp_path: Path, camera: dict[str, Any], message: str) -> None:
    file = camera_file()
    file.json["cameras"][0] = camera
    with pytest.raises(MeshError, match=message):
        read_cameras(file.write_glb(tmp_path / "a.glb"))


def test_dangling_camera(tmp_path: Path) -> None:
    file = camera_file()
    del file.json["cameras"][1]
    with pytest.raises(MeshError, match=r"node 3 names camera 1 of 1"):
        read_cameras(file.write_glb(tmp_path / "a.glb"))


def test_flight_helmet_with_a_missing_texture(tmp_path: Path) -> None:
    with zipfile.ZipFile(scene("textured/flight_helmet_gltf.zip")) as archive:
        archive.extractall(tmp_path)
    (path,) = tmp_path.rglob("FlightHelmet.gltf")
    for image in [*tmp_path.rglob("*.png"), *tmp_path.rglob("*.jpg")]:
        image.unlink()
    mesh = load(path)
    assert mesh.triangle_count == 94722
    assert mesh.vertex_normals is not None
    assert mesh.warnings == ()
    assert read_cameras(path) == ()
