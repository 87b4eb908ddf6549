from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from scenes import scene as shared_scene

from clgrid.errors import InputError, MeshError
from clgrid.mesh import Mesh
from clgrid.scene import (
    camera_file,
    default_camera,
    load_scene,
    named_camera,
    parse_up,
    short_name,
    up_axis,
)


def flat_mesh(source: str = "a.ply", thickness: float = 0.1) -> Mesh:
    vertices = np.array([[0, 0, 0], [2, 0, thickness], [0, 3, 0]], np.float32)
    return Mesh(vertices, np.array([[0, 1, 2]], np.uint32), source=source)


def gltf_with_cameras(folder: Path) -> Path:
    """A file with a perspective camera at (1, 2, 3), one turned to look along +x, an orthographic one."""
    half = math.sqrt(0.5)
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0, 1, 2]}],
        "nodes": [
            {"camera": 0, "name": "front", "translation": [1, 2, 3], "scale": [2, 2, 2]},
            {"camera": 0, "name": "side", "rotation": [0, -half, 0, half]},
            {"camera": 1, "name": "plan"},
        ],
        "cameras": [
            {"type": "perspective", "perspective": {"yfov": math.pi / 3, "znear": 0.1}},
            {"type": "orthographic", "orthographic": {"xmag": 1, "ymag": 1, "znear": 0.1, "zfar": 9}},
        ],
    }
    path = folder / "cameras.gltf"
    path.write_text(json.dumps(document))
    return path


def test_built_in_scenes_load_by_name_and_files_win(tmp_path, monkeypatch):
    assert load_scene("icosphere:1").mesh.triangle_count == 80
    monkeypatch.chdir(tmp_path)
    Path("cube").write_text("no mesh format")
    with pytest.raises(MeshError):
        load_scene("cube")


def test_a_missing_file_is_a_mesh_error():
    with pytest.raises(MeshError, match=r"nosuch\.ply"):
        load_scene("nosuch.ply")


def test_short_names_drop_format_and_gz():
    assert short_name(Path("a/b/dragon_vrip.ply.gz")) == "dragon_vrip"
    assert short_name(Path("Duck.glb")) == "Duck"


@pytest.mark.parametrize(
    ("mesh", "expected"),
    [
        (flat_mesh("a.ply"), (0, 0, 1)),
        (flat_mesh("a.ply", thickness=2), (0, 1, 0)),
        (flat_mesh("a.stl.gz", thickness=2), (0, 0, 1)),
        (flat_mesh("a.glb"), (0, 1, 0)),
        (Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint32)), (0, 1, 0)),
    ],
)
def test_up_follows_format_and_shape(mesh, expected):
    assert up_axis(mesh) == expected


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("auto", (0, 0, 1)),
        ("x", (1, 0, 0)),
        ("-y", (0, -1, 0)),
        ("+z", (0, 0, 1)),
        ("1,-2.5,3e2", (1, -2.5, 300)),
    ],
)
def test_up_is_read_as_axis_or_vector(text, expected):
    assert parse_up(text, flat_mesh()) == expected


@pytest.mark.parametrize("text", ["w", "1,2", "1,2,nan", "", "1,2,3,4"])
def test_other_ups_are_input_errors(text):
    with pytest.raises(InputError, match="up"):
        parse_up(text, flat_mesh())


def test_default_camera_of_nothing_is_a_camera():
    empty = Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint32))
    assert np.isfinite(default_camera(empty).eye).all()


def test_gltf_cameras_by_index_and_name(tmp_path):
    scene = load_scene(gltf_with_cameras(tmp_path))
    front = named_camera(scene, "0")
    assert front.eye.tolist() == [1, 2, 3]
    assert front.forward.tolist() == [0, 0, -1]
    assert front.fov == pytest.approx(60)
    assert front.fov_axis == "y"
    side = named_camera(scene, "side")
    np.testing.assert_allclose(side.forward, [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(side.right, [0, 0, 1], atol=1e-12)


@pytest.mark.parametrize(("selector", "message"), [("3", "0 'front', 1 'side'"), ("top", "2 'plan'")])
def test_cameras_that_cannot_be_are_named(tmp_path, selector, message):
    with pytest.raises(InputError, match=message):
        named_camera(load_scene(gltf_with_cameras(tmp_path)), selector)


def test_a_scene_without_cameras_says_none():
    with pytest.raises(InputError, match="none"):
        named_camera(load_scene("cube"), "0")


def test_mitsuba_camera_looks_along_plus_z_with_x_to_the_left(tmp_path):
    path = tmp_path / "m.camera.json"
    matrix = [[-1, 0, 0, 4], [0, 1, 0, 5], [0, 0, -1, 6], [0, 0, 0, 1]]
    path.write_text(json.dumps({"camera": {"toWorld": matrix, "fov": "60"}, "parts": 3}))
    camera = camera_file(path)
    assert (camera.eye.tolist(), camera.forward.tolist()) == ([4, 5, 6], [0, 0, -1])
    assert camera.right.tolist() == [1, 0, 0]
    assert (camera.fov, camera.fov_axis) == (60, "x")


def test_pbrt_camera_is_a_world_to_camera_matrix_with_x_to_the_right(tmp_path):
    path = tmp_path / "p.json"
    matrix = [[1, 0, 0, -4], [0, 1, 0, -5], [0, 0, -1, 6], [0, 0, 0, 1]]
    path.write_text(json.dumps({"camera": {"worldToCam": matrix, "fov": ["58.7"]}}))
    camera = camera_file(path)
    assert (camera.eye.tolist(), camera.forward.tolist()) == ([4, 5, 6], [0, 0, -1])
    assert camera.right.tolist() == [1, 0, 0]
    assert (camera.fov, camera.fov_axis) == (58.7, "smaller")


def test_plain_camera_files_use_the_command_lines_words(tmp_path):
    path = tmp_path / "c.json"
    path.write_text('{"eye": [0, 0, 5], "look_at": [0, 0, 0], "fov": 30}')
    camera = camera_file(path)
    assert (camera.eye.tolist(), camera.forward.tolist(), camera.fov) == ([0, 0, 5], [0, 0, -1], 30)


@pytest.mark.parametrize(
    "text",
    [
        *["", "[]", "{}", '{"camera": {"fov": 4}}', '{"camera": {"worldToCam": [[0]]}}', '{"eye": "x"}'],
        '{"camera": {"toWorld": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]], "fov": "wide"}}',
    ],
)
def test_other_camera_files_are_input_errors(tmp_path, text):
    path = tmp_path / "c.json"
    path.write_text(text)
    with pytest.raises(InputError, match="camera"):
        camera_file(path)
    with pytest.raises(InputError, match="cannot be read"):
        camera_file(tmp_path / "missing.json")


@pytest.mark.parametrize("name", ["country_kitchen", "white_room"])
def test_the_rooms_own_cameras_are_right_handed_and_upright(name):
    camera = camera_file(shared_scene(f"arch/{name}.camera.json"))
    # A mirrored picture would have right = forward x up with the other sign.
    np.testing.assert_allclose(np.cross(camera.forward, camera.up), camera.right, atol=1e-4)
    assert camera.up[1] > 0.9
