"""Frames: keyframed nodes and morph targets by hand-computed positions, arrays of vertices, files."""

from __future__ import annotations

import math

import numpy as np
import pytest
from gltf_files import TETRAHEDRON, GltfFile, tetrahedron
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from look_files import BASE, animate, frames_of, square, textured
from scenes import scene as shared_scene

from clgrid.errors import InputError, MeshError
from clgrid.mesh import load
from clgrid.meshfile.gltf_animation import Track
from clgrid.scene import load_scene

pytestmark = pytest.mark.host

HALF = math.sqrt(0.5)


def test_translations_move_in_a_straight_line_and_end_at_the_last_keyframe(tmp_path):
    file = animate(
        tetrahedron({"mesh": 0}, {"mesh": 0, "translation": [9, 0, 0]}),
        (0, "translation", [0.5, 1.5], [[0, 0, 0], [4, 8, 0]], "LINEAR"),
    )
    scene, frames = frames_of(file, tmp_path / "a.glb", fps=4)
    assert frames.times.tolist() == [0, 0.25, 0.5, 0.75, 1, 1.25, 1.5]
    assert not frames.topology_changes
    for k, share in enumerate((0, 0, 0, 0.25, 0.5, 0.75, 1)):
        moved = frames.vertices(k)
        assert moved.dtype == scene.mesh.vertices.dtype
        assert np.array_equal(moved[:4], TETRAHEDRON + np.array([4, 8, 0], np.float32) * np.float32(share))
        assert np.array_equal(moved[4:], scene.mesh.vertices[4:])
    assert frames_of(file, tmp_path / "a.glb")[1].count == 37
    assert np.array_equal(frames.scene(4).mesh.faces, scene.mesh.faces)
    assert np.array_equal(frames.scene(4).mesh.vertices, frames.vertices(4))
    assert frames.scene(4).frames is None


def test_steps_hold_and_scales_scale(tmp_path):
    file = animate(
        tetrahedron(),
        (0, "scale", [0, 1, 2], [[1, 1, 1], [2, 2, 2], [3, 3, 3]], "STEP"),
    )
    _, frames = frames_of(file, tmp_path / "a.glb", fps=2)
    assert [float(frames.vertices(k).max()) for k in range(frames.count)] == [1, 1, 2, 2, 3]


def test_rotations_turn_evenly_and_the_short_way(tmp_path):
    """A quarter turn about z, the second quaternion with its sign turned: 30 degrees at a third."""
    file = animate(tetrahedron(), (0, "rotation", [0, 3], [[0, 0, 0, 1], [0, 0, -HALF, -HALF]], "LINEAR"))
    _, frames = frames_of(file, tmp_path / "a.glb", fps=1)
    for k in range(4):
        angle = math.radians(30 * k)
        expected = [[0, 0, 0], [math.cos(angle), math.sin(angle), 0], [-math.sin(angle), math.cos(angle), 0]]
        np.testing.assert_allclose(frames.vertices(k)[:3], expected, atol=1e-6)


def test_children_follow_their_parents(tmp_path):
    nodes = ({"children": [1], "translation": [1, 0, 0]}, {"mesh": 0, "translation": [0, 1, 0]})
    file = animate(
        tetrahedron(*nodes, roots=[0]),
        (0, "rotation", [0, 1], [[0, 0, 0, 1], [0, 0, HALF, HALF]], "LINEAR"),
        (1, "scale", [0, 1], [[1, 1, 1], [2, 2, 2]], "LINEAR"),
    )
    _, frames = frames_of(file, tmp_path / "a.glb", fps=1)
    # twice the size, at (0, 1), turned by 90 degrees, at (1, 0)
    np.testing.assert_allclose(frames.vertices(1), [[0, 0, 0], [0, 2, 0], [-2, 0, 0], [0, 0, 2]], atol=1e-6)
    assert np.array_equal(frames.vertices(0), load(tmp_path / "a.glb").vertices)


def test_cubic_splines_are_hermite_in_seconds(tmp_path):
    """From 0 to 10 in 2 s, leaving at 1 a second and arriving at -3: by hand at the middle."""
    values = [[0, 0, 0], [0, 0, 0], [1, 0, 0], [-3, 0, 0], [10, 0, 0], [0, 0, 0]]
    file = animate(tetrahedron(), (0, "translation", [0, 2], values, "CUBICSPLINE"))
    _, frames = frames_of(file, tmp_path / "a.glb", fps=1)
    # 0.5 * 0 + 2 * 0.125 * 1 + 0.5 * 10 - 2 * 0.125 * (-3)
    assert [float(frames.vertices(k)[0, 0]) for k in range(3)] == [0, 6, 10]


numbers = st.floats(-1e3, 1e3, width=32)


@given(
    hnp.arrays(np.float64, (4, 3, 2), elements=numbers),
    st.lists(st.integers(0, 10**6), min_size=4, max_size=4, unique=True),
    st.sampled_from(["LINEAR", "STEP", "CUBICSPLINE"]),
)
def test_at_keyframes_the_value_is_that_of_the_keyframe(values, ticks, interpolation):
    times = np.array(sorted(ticks)) / 1000
    track = Track(0, "translation", times, values[:, 1], interpolation, values[:, 0], values[:, 2])
    for k, time in enumerate(times):
        assert np.array_equal(track.at(float(time)), values[k, 1])
    assert np.array_equal(track.at(times[0] - 1), values[0, 1])
    assert np.array_equal(track.at(times[-1] + 1), values[-1, 1])


@given(
    hnp.arrays(np.float64, (2, 4), elements=st.floats(-1, 1, width=32)).filter(
        lambda rows: (np.abs(rows).max(axis=1) > 0.1).all()
    ),
    st.floats(0, 1),
)
def test_rotations_between_keyframes_keep_their_length(rows, share):
    unit = rows / np.sqrt((rows * rows).sum(axis=1, keepdims=True))
    value = Track(0, "rotation", np.array([0.0, 1.0]), unit, "LINEAR").at(share)
    assert float((value * value).sum()) == pytest.approx(1, abs=1e-8)


def morphing():
    file = GltfFile()
    targets = [
        {"POSITION": file.accessor(np.array([[0, 0, 0]] * 3 + [[0, 0, 1]], np.float32))},
        {"POSITION": file.accessor(np.array([[1, 0, 0]] * 4, np.float32))},
    ]
    faces = np.array([0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3], np.uint16)
    attributes = {"POSITION": file.accessor(TETRAHEDRON), "NORMAL": file.accessor(TETRAHEDRON)}
    file.mesh({"attributes": attributes, "indices": file.accessor(faces), "targets": targets})
    file.nodes({"mesh": 0})
    return file


def test_morph_targets_by_weights_at_rest_and_in_motion(tmp_path):
    file = morphing()
    file.json["meshes"][0]["weights"] = [0.5, 2]
    mesh = load(file.write_glb(tmp_path / "a.glb"))
    assert np.array_equal(mesh.vertices, TETRAHEDRON + np.array([[2, 0, 0]] * 3 + [[2, 0, 0.5]], np.float32))
    assert mesh.warnings == ()
    file.json["nodes"][0]["weights"] = [1, 0]
    assert load(file.write_glb(tmp_path / "a.glb")).vertices[3].tolist() == [0, 0, 2]
    animate(file, (0, "weights", [0, 1], [0, 0, 1, 1], "LINEAR"))
    _, frames = frames_of(file, tmp_path / "a.glb", fps=2)
    assert frames.vertices(0).tolist() == TETRAHEDRON.tolist()
    assert frames.vertices(1)[3].tolist() == [0.5, 0, 1.5]
    assert frames.vertices(2)[1].tolist() == [2, 0, 0]


def test_normalized_integers_stand_for_rotations(tmp_path):
    file = animate(tetrahedron(), (0, "rotation", [0, 1], [[0, 0, 0, 1]] * 2, "LINEAR"))
    packed = np.array([[0, 0, 0, 127], [0, 0, 127, 0]], np.int8)
    file.json["animations"][0]["samplers"][0]["output"] = file.accessor(packed, normalized=True)
    _, frames = frames_of(file, tmp_path / "a.glb", fps=1)
    np.testing.assert_allclose(frames.vertices(1)[1], [-1, 0, 0], atol=1e-6)


def test_lights_and_cameras_move_with_their_nodes(tmp_path):
    file = textured(
        square(
            BASE,
            {"mesh": 0},
            {"camera": 0, "name": "eye", "extensions": {"KHR_lights_punctual": {"light": 0}}},
            {"camera": 1, "name": "plan"},
        )
    )
    file.json["extensions"] = {"KHR_lights_punctual": {"lights": [{"type": "point"}]}}
    file.json["cameras"] = [
        {"type": "perspective", "perspective": {"yfov": 1, "znear": 1}},
        {"type": "orthographic", "orthographic": {"xmag": 3, "ymag": 2, "znear": 0, "zfar": 9}},
    ]
    animate(file, (1, "translation", [0, 1], [[0, 0, 1], [0, 0, 5]], "LINEAR"))
    scene, frames = frames_of(file, tmp_path / "a.glb", fps=1)
    assert frames.cameras_move
    assert [camera.name for camera in scene.cameras] == ["eye", "plan"]
    assert scene.cameras[1].orthographic_height == 4
    assert frames.camera(1, "eye").eye.tolist() == [0, 0, 5]
    assert frames.scene(1).cameras[0].eye.tolist() == [0, 0, 5]
    assert frames.camera(1, "1").orthographic_height == 4
    assert scene.look.lights[0].position == (0, 0, 0)
    assert frames.look(1).lights[0].position == (0, 0, 5)
    assert frames.scene(1).look.textures[0] is scene.look.textures[0]
    with pytest.raises(InputError, match="'nosuch'"):
        frames.camera(1, "nosuch")
    still = animate(tetrahedron(), (0, "scale", [0], [[2, 2, 2]], "LINEAR"))
    assert not frames_of(still, tmp_path / "b.glb")[1].cameras_move
    assert frames_of(still, tmp_path / "b.glb")[1].count == 1


def test_one_of_several_animations(tmp_path):
    file = tetrahedron()
    animate(file, (0, "scale", [0, 1], [[1, 1, 1], [2, 2, 2]], "LINEAR"), name="grow")
    animate(file, (0, "scale", [0, 2], [[1, 1, 1], [4, 4, 4]], "LINEAR"), name="more")
    path = file.write_glb(tmp_path / "a.glb")
    first = load_scene(path, fps=1).frames
    assert first.count == 2
    assert "2 animations ('grow', 'more')" in first.warnings[0]
    for wanted in ("more", "1", 1):
        assert load_scene(path, fps=1, animation=wanted).frames.count == 3
    with pytest.raises(InputError, match="1 'more'"):
        _ = load_scene(path, animation="walk").frames
    with pytest.raises(InputError, match="0 to 1"):
        first.vertices(2)
    with pytest.raises(InputError, match="too many frames"):
        _ = load_scene(path, fps=1e9).frames
    with pytest.raises(InputError, match="fps"):
        load_scene(path, fps=0)


def test_what_does_not_move_has_no_frames(tmp_path):
    assert load_scene("cube").frames is None
    assert load_scene(tetrahedron().write_glb(tmp_path / "a.glb")).frames is None
    file = tetrahedron()
    animate(file, (0, "weights", [0, 1], [0, 1], "LINEAR"))
    assert load_scene(file.write_glb(tmp_path / "b.glb")).frames is None


@pytest.mark.parametrize(
    ("channel", "message"),
    [
        ((0, "translation", [1, 0], [[0, 0, 0]] * 2, "LINEAR"), "do not ascend"),
        ((0, "translation", [0, np.nan], [[0, 0, 0]] * 2, "LINEAR"), "do not ascend"),
        ((0, "translation", [0, 1], [[0, 0, 0]] * 3, "LINEAR"), "9 values for 2 keyframes, 6"),
        ((0, "translation", [0, 1], [[0, 0, 0]] * 2, "CUBICSPLINE"), "18 finite ones"),
        ((0, "translation", [0, 1], [[0, 0, np.inf]] * 2, "LINEAR"), "finite"),
        ((0, "translation", [0, 1], [[0, 0, 0]] * 2, "WAVY"), "'WAVY'"),
        ((7, "translation", [0, 1], [[0, 0, 0]] * 2, "LINEAR"), "node 7 of 1"),
        ((0, "rotation", [0, 1], [[0, 0, 0, 0]] * 2, "LINEAR"), "rotation of length 0"),
    ],
)
def test_malformed_animations_are_mesh_errors(tmp_path, channel, message):
    path = animate(tetrahedron(), channel).write_glb(tmp_path / "a.glb")
    scene = load_scene(path)
    with pytest.raises(MeshError, match=message) as caught:
        scene.frames.vertices(0)
    assert str(caught.value).startswith(f"{path}: ")


def test_the_truck_rolls_on_its_wheels():
    scene = load_scene(shared_scene("textured/CesiumMilkTruck.glb"))
    frames = scene.frames
    assert frames.count == 31
    quarter = frames.vertices(8)
    moved = (quarter != scene.mesh.vertices).any(axis=1)
    starts = scene.mesh.geometry_starts
    wheels = np.unique(scene.mesh.faces[starts[3] :])
    assert moved[wheels].mean() > 0.9
    assert not moved[np.unique(scene.mesh.faces[: starts[3]])].any()
    for first, last in ((3, 4), (4, 5)):
        wheel = np.unique(scene.mesh.faces[starts[first] : starts[last]])
        np.testing.assert_allclose(
            np.ptp(quarter[wheel], axis=0), np.ptp(scene.mesh.vertices[wheel], axis=0), rtol=0.03
        )


def test_arrays_of_vertices(tmp_path):
    mesh_path = tetrahedron().write_glb(tmp_path / "a.glb")
    positions = np.stack([TETRAHEDRON * k for k in range(1, 4)]).astype(np.float32)
    np.save(tmp_path / "a.npy", positions)
    scene = load_scene(mesh_path, frames=tmp_path / "a.npy", fps=2)
    assert scene.frames.times.tolist() == [0, 0.5, 1]
    assert np.array_equal(scene.frames.vertices(2), positions[2])
    assert np.array_equal(scene.frames.scene(1).mesh.vertices, positions[1])
    np.save(tmp_path / "b.npy", positions[:, :3])
    with pytest.raises(InputError, match="3 vertices a frame"):
        _ = load_scene(mesh_path, frames=tmp_path / "b.npy").frames
    with pytest.raises(InputError, match="0 to 2"):
        scene.frames.vertices(-1)


def test_the_horse_gallops():
    frames = load_scene(
        shared_scene("dynamic/horse_gallop_frame0.ply"), shared_scene("dynamic/horse_gallop_frames.npy.gz")
    ).frames
    assert frames.count == 48
    np.testing.assert_allclose(frames.vertices(0), frames.base.mesh.vertices, atol=1e-6)


def off(path, count):
    text = "\n".join(f"{k} 0 0\n{k} 1 0\n{k} 0 1" for k in range(count))
    faces = "\n".join(f"3 {3 * k} {3 * k + 1} {3 * k + 2}" for k in range(count))
    path.write_text(f"OFF\n{3 * count} {count} 0\n{text}\n{faces}\n")


def test_folders_and_patterns_of_files(tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    for k, count in ((2, 2), (10, 3), (1, 2)):
        off(folder / f"cow_{k}.off", count)
    (folder / "notes.txt").write_text("no mesh")
    for name in (folder, f"{folder}/cow_*.off"):
        scene = load_scene(name)
        assert scene.name == ("run" if name == folder else "cow")
        frames = scene.frames
        assert [path.name for path in frames.files] == ["cow_1.off", "cow_2.off", "cow_10.off"]
        assert frames.topology_changes
        assert [frames.scene(k).mesh.triangle_count for k in range(3)] == [2, 2, 3]
        assert np.array_equal(frames.vertices(1), scene.mesh.vertices)
        with pytest.raises(InputError, match="other triangles"):
            frames.vertices(2)
        assert frames.scene(2).path == folder / "cow_10.off"
    assert load_scene(folder / "cow_1.off", frames=folder).frames.count == 3
    with pytest.raises(InputError, match="no mesh file"):
        load_scene(f"{folder}/pig_*.off")
    with pytest.raises(InputError, match="already"):
        load_scene(folder, frames=folder)
    (folder / "a[1].off").write_text((folder / "cow_1.off").read_text())
    assert load_scene(folder / "a[1].off").frames is None


def test_plain_loads_read_neither_look_nor_frames(tmp_path, monkeypatch):
    import clgrid.animation
    import clgrid.lookfile

    path = animate(textured(square(BASE)), (0, "scale", [0], [[1, 1, 1]], "LINEAR")).write_glb(
        tmp_path / "a.glb"
    )

    def asked(*given):
        raise AssertionError("asked for")

    monkeypatch.setattr(clgrid.lookfile, "read_look", asked)
    monkeypatch.setattr(clgrid.animation, "frames_of", asked)
    scene = load_scene(path)
    monkeypatch.undo()
    assert scene.look is scene.look
    assert scene.frames is scene.frames
