"""Hostile files and damaged ones: looks, cameras and frames of them fail in one line or not at all."""

from __future__ import annotations

import json
import random

import pytest
from look_files import BASE, SQUARE_UV, animate, check_shapes, square, textured
from scenes import manifest, shared_file

from clgrid.errors import ClgridError
from clgrid.scene import load_scene

pytestmark = pytest.mark.host


def tried(path):
    """What went wrong, as lines; any other exception passes."""
    said = []
    try:
        scene = load_scene(path)
    except ClgridError as error:
        return [str(error)]
    for ask in (lambda: scene.look, lambda: scene.cameras, lambda: scene.frames):
        try:
            found = ask()
        except ClgridError as error:
            said.append(str(error))
            continue
        if found is not None and found is scene.__dict__.get("look"):
            check_shapes(scene.mesh, found)
        elif found is not None and found is scene.__dict__.get("frames"):
            for k in {0, found.count // 2, found.count - 1}:
                try:
                    assert found.vertices(k).shape == scene.mesh.vertices.shape
                except ClgridError as error:
                    said.append(str(error))
    return said


def test_hostile_files_are_refused_or_have_a_look():
    rows = manifest("hostile")
    if not rows:
        pytest.skip("the hostile files are not there (set CLGRID_SCENES)")
    for row in rows:
        for line in tried(shared_file("hostile", row["file"])):
            assert "\n" not in line


VALUES = [None, -1, 0, 3, 2**53, 1e308, "", "x", [], {}, [0, 0, 0, 0], True, "data:,", 5126]


def leaves(node, place=()):
    """Places of all values of a document that hold no other."""
    if isinstance(node, (dict, list)) and node:
        for key, value in node.items() if isinstance(node, dict) else enumerate(node):
            yield from leaves(value, (*place, key))
    else:
        yield place


def test_damaged_documents_are_refused_or_have_a_look(tmp_path):
    """One value of the JSON at a time is replaced: 300 damaged files of all that is read."""
    material = {
        **BASE,
        "emissiveFactor": [1, 1, 1],
        "emissiveTexture": {"index": 0, "extensions": {"KHR_texture_transform": {"scale": [2, 2]}}},
        "alphaMode": "MASK",
    }
    nodes = ({"mesh": 0, "extensions": {"KHR_lights_punctual": {"light": 0}}}, {"camera": 0})
    file = textured(
        square(material, *nodes, COLOR_0=SQUARE_UV.repeat(2, axis=1)), samplers=[{"wrapS": 33071}]
    )
    file.json["extensions"] = {
        "KHR_lights_punctual": {"lights": [{"type": "spot", "spot": {"outerConeAngle": 0.5}}]}
    }
    file.json["cameras"] = [{"type": "orthographic", "orthographic": {"xmag": 1, "ymag": 1}}]
    animate(file, (0, "translation", [0, 1], [[0, 0, 0], [1, 1, 1]], "LINEAR"))
    assert tried(file.write_glb(tmp_path / "whole.glb")) == []
    whole = json.dumps(file.json)
    places = list(leaves(file.json))
    chosen = random.Random(8)
    refused = 0
    for _ in range(300):
        file.json = json.loads(whole)
        *way, last = chosen.choice(places)
        node = file.json
        for key in way:
            node = node[key]
        node[last] = chosen.choice(VALUES)
        lines = tried(file.write_glb(tmp_path / "damaged.glb"))
        assert all("\n" not in line for line in lines)
        refused += bool(lines)
    assert 50 < refused < 300
