"""What batches draw is what scenes are: their frames, cameras, looks, and every file that they name."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from gltf_files import GltfFile, tetrahedron
from look_files import BASE, animate, square, textured
from pictures import CORNERS, png

from clgrid.batch.item import Item
from clgrid.batch.job import parse_job
from clgrid.batch.keys import Hashes
from clgrid.batch.loader import Loader
from clgrid.batch.painter import Painter
from clgrid.batch.plan import plan
from clgrid.batch.run import Choices, run
from clgrid.camera import Camera
from clgrid.cli import main
from clgrid.cli.batch_progress import Quiet
from clgrid.errors import InputError, MeshError
from clgrid.image import Image, read_image
from clgrid.look import Shading
from clgrid.lookfile.companions import companions
from clgrid.mesh import Mesh, load
from clgrid.record import describe_builds
from clgrid.renderer import render, warm_up
from clgrid.scene import count_frames, load_scene

pytestmark = pytest.mark.host

SIZE = "size = [20, 16]\n"
SUN = "sun = [1, 2, 3]\n"
SUNNY = Shading(sun=(1, 2, 3))


def items(text: str, base: Path) -> list[Item]:
    return plan(parse_job(text, "job.toml"), base).items


def keyed(text: str, base: Path) -> str:
    return Hashes().with_key(items(text, base)[0]).key


def moving(folder: Path, *, mesh: bool) -> Path:
    """A textured square with a camera and a lamp that rise; with ``mesh``, the square moves too."""
    file = textured(
        square(
            BASE,
            {"mesh": 0},
            {
                "camera": 0,
                "name": "eye",
                "translation": [0.5, 0.5, 2],
                "extensions": {"KHR_lights_punctual": {"light": 0}},
            },
            {"camera": 1, "name": "plan", "translation": [0.5, 0.5, 3]},
            NORMAL=np.tile(np.float32([0, 0, 1]), (4, 1)),
        )
    )
    file.json["extensions"] = {"KHR_lights_punctual": {"lights": [{"type": "point", "intensity": 9}]}}
    file.json["cameras"] = [
        {"type": "perspective", "perspective": {"yfov": 1, "znear": 1}},
        {"type": "orthographic", "orthographic": {"xmag": 1, "ymag": 1, "znear": 0, "zfar": 9}},
    ]
    tracks = [(1, "translation", [0, 2], [[0.5, 0.5, 2], [0.5, 0.5, 4]], "LINEAR")]
    if mesh:
        tracks.append((0, "translation", [0, 2], [[0, 0, 0], [0.5, 0, 0]], "LINEAR"))
    return animate(file, *tracks).write_glb(folder / "moving.glb")


def same(one: Image, other: Image) -> bool:
    names = ("rgba", "depth", "albedo", "primitive_id")
    return all(np.array_equal(getattr(one, name), getattr(other, name), equal_nan=True) for name in names)


def drawn(text: str, base: Path, device: str) -> list[tuple[Item, Image, Mesh]]:
    """All items in the order of the job, by one painter, with the mesh of each."""
    loader, painter, found = Loader(), Painter(device), []
    for item in items(text, base):
        loaded = loader.load(item)
        found.append((item, painter.paint(item, loaded).image, loaded.mesh))
    return found


def test_cameras_lamps_and_meshes_of_a_frame_are_drawn_where_they_are_by_then(tmp_path, device):
    path = moving(tmp_path, mesh=True)
    text = (
        'scenes = ["moving.glb"]\ncameras = ["eye", "plan"]\nframes = "all"\nfps = 1\nlights = true\n'
        f'output = "{{camera}}.{{frame}}.exr"\naovs = ["depth", "albedo", "id"]\ndensity = 4.0\n{SIZE}'
    )
    found = drawn(text, tmp_path, device.label)
    assert [(item.frame, item.camera_name) for item, _, _ in found] == [
        (k, name) for k in range(3) for name in ("eye", "plan")
    ]
    frames = load_scene(path, fps=1).frames
    aovs = ("depth", "albedo", "id")
    for item, image, _ in found:
        alone = render(
            frames.scene(item.frame),
            frames.camera(item.frame, item.camera_name),
            20, 16, aovs, shading=Shading(lights=True), device=device, density=4.0,
        )  # fmt: skip
        assert same(image, alone), item.title
    assert len({image.rgba.tobytes() for _, image, _ in found}) == 6


def test_a_mesh_that_no_keyframe_moves_is_one_and_keeps_its_normals(tmp_path, device):
    moving(tmp_path, mesh=False)
    text = 'scenes = ["moving.glb"]\ncameras = ["eye"]\nframes = "all"\nfps = 1\noutput = "{frame}.png"\n'
    found = drawn(text + "size = [60, 48]\n", tmp_path, device.label)
    assert len({id(mesh) for _, _, mesh in found}) == 1
    assert found[0][2].vertex_normals is not None
    assert len({image.rgba.tobytes() for _, image, _ in found}) == 3
    still = load_scene(tmp_path / "moving.glb").frames
    assert not still.mesh_moves
    assert load_scene(moving(tmp_path, mesh=True)).frames.mesh_moves
    # What hangs on a node that moves does too, and so may a skin.
    file = animate(
        tetrahedron({"children": [1]}, {"mesh": 0}, roots=[0]),
        (0, "scale", [0, 1], [[1, 1, 1], [2, 2, 2]], "LINEAR"),
    )
    assert load_scene(file.write_glb(tmp_path / "b.glb")).frames.mesh_moves


def test_files_with_other_triangles_each_are_frames_of_one_scene(tmp_path, device):
    (tmp_path / "walk").mkdir()
    for k in (10, 9):
        mesh = load_scene(f"icosphere:{k - 8}").mesh
        lines = [f"v {x + k} {y} {z}\n" for x, y, z in mesh.vertices.tolist()]
        lines += ["f {} {} {}\n".format(*face) for face in (mesh.faces + 1).tolist()]
        (tmp_path / "walk" / f"w_{k}.obj").write_text("".join(lines))
    text = f'scenes = ["walk"]\nframes = "all"\noutput = "{{scene}}.{{frame}}.png"\n{SIZE}'
    found = drawn(text, tmp_path, device.label)
    assert [Path(item.outputs[0]).name for item, _, _ in found] == ["walk.0.png", "walk.1.png"]
    meshes = [load(tmp_path / "walk" / f"w_{k}.obj") for k in (9, 10)]
    low, high = zip(*(mesh.bounds for mesh in meshes), strict=True)
    view = Camera.framing(np.stack([np.min(low, axis=0), np.max(high, axis=0)]), aspect=20 / 16)
    for (_, image, _), mesh in zip(found, meshes, strict=True):
        assert (image.rgba == render(mesh, view, 20, 16, device=device).rgba).all()
    # As what moves another scene, by a pattern.
    moved = text.replace('["walk"]', '["cube"]\nvertices = "walk/w_*.obj"')
    again = drawn(moved, tmp_path, device.label)
    assert all(
        (image.rgba == one.rgba).all() for (_, image, _), (_, one, _) in zip(again, found, strict=True)
    )
    with pytest.raises(InputError, match="whose files are frames"):
        items('scenes = ["walk"]\noutput = "a.png"\n', tmp_path)


def test_frames_are_counted_without_what_is_not_needed(tmp_path):
    np.save(tmp_path / "v.npy", np.zeros((5, 8, 3), np.float32))
    (tmp_path / "bad.npy").write_bytes(b"no array")
    assert count_frames("cube", str(tmp_path / "v.npy"), 24, None) == 5
    assert count_frames("cube", None, 24, None) == 1
    path = str(moving(tmp_path, mesh=True))
    assert [count_frames(path, None, fps, None) for fps in (1, 10)] == [3, 21]
    with pytest.raises(InputError, match=r"bad\.npy: not a \.npy"):
        count_frames("cube", str(tmp_path / "bad.npy"), 24, None)
    (tmp_path / "bad.glb").write_bytes(b"no scene")
    with pytest.raises(MeshError):
        count_frames(str(tmp_path / "bad.glb"), None, 24, None)
    # In a job that is the failure of one item, and scenes that stand still have one frame.
    text = 'scenes = ["cube", "moving.glb", "bad.glb"]\nfps = 1\nframes = "all"\noutput = "{item}.png"\n'
    found = [(Path(item.scene).name, item.frame) for item in items(text, tmp_path)]
    assert found == [("cube", 0), *(("moving.glb", k) for k in range(3)), ("bad.glb", 0)]


# Files beside files


def sided(folder: Path, name: str) -> tuple[str, list[Path]]:
    """A scene with files beside it, and those."""
    (folder / "t.png").write_bytes(png(CORNERS))
    if name == "a.gltf":
        textured(square(BASE), "t.png").write_gltf(folder / name, "a%20b.bin")
        return name, [folder / "a b.bin", folder / "t.png"]
    if name == "a.obj":
        (folder / name).write_text(
            "mtllib A.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl m\nf 1/1 2/2 3/3\n"
        )
        (folder / "a.mtl").write_text("newmtl m\nmap_Kd -s 1 1 T.png\n")
        return name, [folder / "a.mtl", folder / "t.png"]
    (folder / name).write_text(
        "ply\nformat ascii 1.0\ncomment TextureFile t.png\nelement vertex 3\nproperty float x\n"
        "property float y\nproperty float z\nproperty float s\nproperty float t\nelement face 1\n"
        "property list uchar int vertex_indices\nend_header\n0 0 0 0 0\n1 0 0 1 0\n0 1 0 0 1\n3 0 1 2\n"
    )
    return name, [folder / "t.png"]


@pytest.mark.parametrize("name", ["a.gltf", "a.obj", "a.ply"])
def test_the_key_holds_every_file_that_a_scene_names(tmp_path, name):
    scene, beside = sided(tmp_path, name)
    assert [found for _, found in companions(tmp_path / scene)] == beside
    text = f'scenes = ["{scene}"]\noutput = "a.png"\n'
    keys = [keyed(text, tmp_path)]
    assert keyed(text, tmp_path) == keys[0]
    for path in beside:
        content = path.read_bytes()
        path.write_bytes(content + b" ")
        keys.append(keyed(text, tmp_path))
        path.unlink()
        keys.append(keyed(text, tmp_path))
        path.write_bytes(content)
        assert keyed(text, tmp_path) == keys[0]
    assert len(set(keys)) == len(keys) == 1 + 2 * len(beside)


def test_damaged_scenes_name_no_files_and_have_a_key(tmp_path):
    for text in (
        "[]",
        "{",
        '{"buffers": [1]}',
        '{"asset": {"version": "2.0"}, "buffers": [{"uri": "a\\u0000"}]}',
    ):
        (tmp_path / "b.gltf").write_text(text)
        assert all(found is None or not found.exists() for _, found in _quietly(tmp_path / "b.gltf"))
        assert keyed('scenes = ["b.gltf"]\noutput = "a.png"\n', tmp_path)
    assert companions(tmp_path / "nosuch.obj") == []


def _quietly(path: Path) -> list[tuple[str, Path | None]]:
    return [(name, None if "\0" in str(found) else found) for name, found in companions(path)]


def test_the_key_holds_what_moves_a_scene_and_camera_files(tmp_path):
    (tmp_path / "c.json").write_text('{"eye": [1, 2, 3], "look_at": [0, 0, 0]}')
    np.save(tmp_path / "v.npy", np.zeros((2, 8, 3), np.float32))
    (tmp_path / "walk").mkdir()
    for k in range(2):
        (tmp_path / "walk" / f"{k}.obj").write_text("mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    out = 'output = "a.png"\n'
    by_camera = f'scenes = ["cube"]\ncameras = ["c.json"]\n{out}'
    by_array = f'scenes = ["cube"]\nvertices = "v.npy"\nframes = "1"\n{out}'
    by_files = f'scenes = ["walk"]\nframes = "1"\n{out}'
    texts = (by_camera, by_array, by_files, by_files + "fps = 30\n", by_files.replace('"1"', '"0"'))
    keys = [keyed(text, tmp_path) for text in texts]
    assert len(set(keys)) == len(keys)
    (tmp_path / "c.json").write_text('{"eye": [1, 2, 4], "look_at": [0, 0, 0]}')
    np.save(tmp_path / "v.npy", np.ones((2, 8, 3), np.float32))
    # The default camera sees all frames, so that each matters to each.
    (tmp_path / "walk" / "m.mtl").write_text("newmtl m\n")
    assert not {keyed(text, tmp_path) for text in texts} & set(keys)


def test_one_texel_changed_draws_a_picture_again(tmp_path, device, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).resolve().parent.parent))
    sided(tmp_path, "a.gltf")
    text = f'scenes = ["a.gltf"]\noutput = "a.exr"\naovs = ["albedo"]\n{SIZE}'
    seen = []
    for pixels in (CORNERS, CORNERS, np.where(np.arange(3) == 1, CORNERS, 255 - CORNERS).astype(np.uint8)):
        (tmp_path / "t.png").write_bytes(png(pixels))
        outcome = run(
            plan(parse_job(text, "j"), tmp_path), Choices(skip_existing=True, device=device.label), Quiet()
        )
        seen.append(
            (outcome.records[0].status, read_image(tmp_path / "a.exr").albedo.max(axis=(0, 1)).tolist())
        )
    assert [status for status, _ in seen] == ["done", "skipped", "done"]
    assert seen[0] == ("done", seen[1][1])
    assert seen[0][1] != seen[2][1]


# The command line, and what is compiled beforehand


def test_render_shows_the_look_by_cameras_of_every_kind_and_says_what_is_missing(
    tmp_path, device, monkeypatch, capsys
):
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).resolve().parent.parent))
    monkeypatch.chdir(tmp_path)
    path = moving(tmp_path, mesh=False)
    words = ["render", path.name, "--size", "20x16", "--device", device.label]

    def call(*more: str) -> str:
        with pytest.raises(SystemExit) as ended:
            main([*words, *more])
        assert ended.value.code == 0
        return capsys.readouterr().err

    call(
        "--camera", "plan", "--aov", "albedo,depth,id", "--sun", "1,2,3", "--crop", "4,2,20,16", "-o", "a.exr"
    )
    scene = load_scene(path)
    alone = render(
        scene,
        scene.cameras[1],
        20,
        16,
        ("albedo", "depth", "id"),
        shading=SUNNY,
        crop=(4, 2, 20, 16),
        device=device,
    )
    image = read_image(tmp_path / "a.exr")
    assert same(image, alone)
    assert (image.crop, image.full_size) == ((4, 2), (20, 16))
    assert np.ptp(alone.albedo, axis=2).max() > 0.5
    call("--camera", "all", "-o", "{camera}.png")
    assert {each.name for each in tmp_path.glob("*.png")} == {"eye.png", "plan.png"}
    words[1] = textured(square(BASE), "nosuch.png").write_gltf(tmp_path / "b.gltf").name
    assert "warning" not in call("-o", "b.png")
    told = "'nosuch.png' is missing"
    assert told in call("-o", "b.png", "--sun", "1,2,3")
    assert call("-o", "{scene}.png", "--sun", "1,2,3").count(told) == 1
    assert told in json.loads((tmp_path / "run.jsonl").read_text().splitlines()[-1])["warnings"][0]


def test_warm_up_leaves_nothing_to_compile_for_what_is_shown(tmp_path, device):
    material = {**BASE, "alphaMode": "MASK", "alphaCutoff": 0.5}
    texels = np.concatenate([CORNERS, np.array([[[0], [255]], [[255], [0]]], np.uint8)], axis=2)
    (tmp_path / "t.png").write_bytes(png(texels))
    colours = np.ones((4, 3), np.float32)
    file: GltfFile = textured(square(material, COLOR_0=colours), "t.png")
    scene = load_scene(file.write_glb(tmp_path / "a.glb"))
    shading = Shading(samples=4, sun=(0, 1, 3), sky=(1, 1, 1), occlusion_rays=4)
    options = {"density": 1.0, "layout": "compact"}
    warm_up(device, ("uv",), look=scene.look, shading=shading, orthographic=True, **options)
    before = set(describe_builds(device))
    view = Camera.look_at((0.5, 0.5, 2), (0.5, 0.5, 0), orthographic_height=2)
    render(scene, view, 20, 16, ("uv",), shading=shading, device=device, **options)
    assert set(describe_builds(device)) == before
