"""What info says of materials, textures, lights and frames."""

from __future__ import annotations

import numpy as np
import pytest
from look_files import BASE, SQUARE_UV, animate, data_uri, square, textured
from pictures import CORNERS, png
from scenes import scene as shared_scene

from clgrid.cli import main
from clgrid.features import features, look_bytes
from clgrid.info import info
from clgrid.info_record import InfoRecord
from clgrid.record import decode, encode
from clgrid.scene import load_scene

pytestmark = pytest.mark.host


def everything(folder):
    material = {
        **BASE,
        "emissiveFactor": [1, 1, 1],
        "emissiveTexture": {"index": 1, "texCoord": 1},
        "alphaMode": "MASK",
        "doubleSided": True,
    }
    lamp = {"extensions": {"KHR_lights_punctual": {"light": 0}}, "name": "lamp"}
    file = textured(
        square(
            material, {"mesh": 0}, lamp, {"camera": 0}, TEXCOORD_1=SQUARE_UV, COLOR_0=np.ones((4, 4), "f4")
        ),
        data_uri(png(CORNERS)),
        "nosuch.png",
    )
    file.json["extensions"] = {"KHR_lights_punctual": {"lights": [{"type": "point"}]}}
    file.json["cameras"] = [{"type": "orthographic", "orthographic": {"xmag": 1, "ymag": 1}}]
    animate(file, (0, "translation", [0, 1], [[0, 0, 0], [1, 1, 1]], "LINEAR"))
    return file.write_glb(folder / "all.glb")


def test_all_features_with_their_bytes(tmp_path):
    scene = load_scene(everything(tmp_path), fps=10)
    found = features(scene)
    assert (found.materials, found.double_sided, found.masked, found.emissive) == (1, 1, 1, 1)
    assert [(each.width, each.height, each.nbytes, each.alpha) for each in found.textures] == [
        (2, 2, 16, False),
        (1, 1, 4, False),
    ]
    assert [(uv.rows, uv.nbytes, uv.own_faces, uv.uses) for uv in found.uv_sets] == [(4, 32, False, 1)] * 2
    assert found.vertex_colours
    assert [(light.kind, light.name) for light in found.lights] == [("point", "lamp")]
    assert found.orthographic == 1
    assert (found.frames.count, found.frames.fps, found.frames.seconds, found.frames.nbytes) == (
        11,
        10,
        1,
        48,
    )
    assert found.nbytes == {"textures": 20, "uvs": 64, "colours": 64} == look_bytes(scene.look)
    assert "nosuch.png" in found.warnings[0]


def test_the_record_of_info_holds_them(tmp_path):
    record = info(load_scene(everything(tmp_path)))
    assert decode(encode(record), InfoRecord) == record
    assert record.features.lights[0].kind == "point"
    plain = info(load_scene("cube")).features
    assert (plain.materials, plain.textures, plain.nbytes, plain.frames) == (0, [], {}, None)


def test_info_prints_what_there_is(tmp_path, capsys):
    with pytest.raises(SystemExit, match="0"):
        main(["info", str(everything(tmp_path))])
    said = capsys.readouterr()
    lines = {line.split()[0]: " ".join(line.split()) for line in said.out.splitlines() if line.strip()}
    assert lines["materials"] == "materials 1, 1 double-sided, 1 masked, 1 emissive"
    assert "'nosuch.png' 1x1: 4 B" in lines["texture"]
    assert lines["uv"].startswith("uv 4 rows: 32 B")
    assert lines["colours"] == "colours of vertices: 64 B"
    assert lines["light"] == "light 'lamp' point"
    assert lines["frames"].startswith("frames 25 at 24 a second: 48 B each")
    assert "drawn black" in said.err
    with pytest.raises(SystemExit, match="0"):
        main(["info", "cube"])
    assert "materials" not in capsys.readouterr().out


def test_real_scenes_in_info():
    found = features(load_scene(shared_scene("textured/CesiumMilkTruck.glb")))
    assert found.nbytes == {"material_ids": 2 * 3624, "textures": 4 * 2048 * 2048, "uvs": 8 * 3564}
    assert found.frames.count == 31
    horse = features(load_scene(shared_scene("scans/horse.ply")))
    assert horse.nbytes == {"colours": 16 * 48485}
