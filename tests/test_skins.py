"""Skins of glTF files: vertices that follow joints, by hand-computed positions."""

from __future__ import annotations

import math

import numpy as np
import pytest
from gltf_files import TETRAHEDRON, TETRAHEDRON_FACES, TETRAHEDRON_NORMALS, GltfFile, refused, translated
from look_files import animate, frames_of

from clgrid.mesh import load

pytestmark = pytest.mark.host

HALF = math.sqrt(0.5)


def skinned(joints, weights, *nodes, inverses=None, **mesh_node):
    """The tetrahedron on joints 1 and 2; the node that shows it is moved, which must not matter."""
    file = GltfFile()
    attributes = {
        "POSITION": file.accessor(TETRAHEDRON),
        "NORMAL": file.accessor(TETRAHEDRON_NORMALS),
        "JOINTS_0": file.accessor(np.array(joints, np.uint8)),
        "WEIGHTS_0": file.accessor(np.array(weights, np.float32)),
    }
    file.mesh({"attributes": attributes, "indices": file.accessor(TETRAHEDRON_FACES.reshape(-1))})
    skin = {"joints": [1, 2]}
    if inverses is not None:
        skin["inverseBindMatrices"] = file.accessor(np.array(inverses, np.float32))
    file.json["skins"] = [skin]
    file.nodes({"mesh": 0, "skin": 0, "translation": [7, 7, 7], **mesh_node}, *nodes)
    return file


FIRST, SECOND, EVEN = [1, 0, 0, 0], [0, 1, 0, 0], [0.5, 0.5, 0, 0]
JOINTS = [[0, 1, 0, 0]] * 4


def test_vertices_follow_their_joints_and_not_their_node(tmp_path):
    file = skinned(
        JOINTS,
        [FIRST, SECOND, EVEN, [0, 0, 0, 0]],
        {"translation": [0, 0, 2]},
        {"translation": [0, 4, 0], "scale": [2, 2, 2]},
    )
    mesh = load(file.write_glb(tmp_path / "a.glb"))
    assert mesh.warnings == ()
    assert mesh.vertices.tolist() == [[0, 0, 2], [2, 4, 0], [0, 3.5, 1], [0, 0, 3]]
    assert np.array_equal(mesh.faces, TETRAHEDRON_FACES)
    np.testing.assert_allclose(mesh.vertex_normals[0], [-1 / math.sqrt(3)] * 3, rtol=1e-6)


def test_inverse_bind_matrices_take_the_rest_pose_back(tmp_path):
    inverses = [translated(0, 0, -2), translated(-1, 0, 0)]
    file = skinned(
        JOINTS,
        [FIRST, SECOND, EVEN, FIRST],
        {"translation": [0, 0, 2]},
        {"translation": [1, 0, 0]},
        inverses=inverses,
    )
    animate(file, (2, "rotation", [0, 1], [[0, 0, 0, 1], [0, 0, HALF, HALF]], "LINEAR"))
    scene, frames = frames_of(file, tmp_path / "a.glb", fps=1)
    assert np.array_equal(scene.mesh.vertices, TETRAHEDRON)
    assert np.array_equal(frames.vertices(0), TETRAHEDRON)
    # joint 2 stands at (1, 0, 0) and turns by 90 degrees about z: (0, 1, 0) comes to (0, -1, 0)
    np.testing.assert_allclose(frames.vertices(1), [[0, 0, 0], [1, 0, 0], [0, 0, 0], [0, 0, 1]], atol=1e-6)


def test_weights_are_brought_to_a_sum_of_one(tmp_path):
    file = skinned(JOINTS, [[3, 1, 0, 0]] * 4, {}, {"translation": [0, 0, 8]})
    assert load(file.write_glb(tmp_path / "a.glb")).vertices[0].tolist() == [0, 0, 2]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"skins": []}, "skin 0 of 0"),
        ({"skins": [{"joints": []}]}, "no joints"),
        ({"skins": [{"joints": [1, 9]}]}, "joint 9"),
        ({"skins": [{"joints": [1]}]}, "beyond its 1"),
        ({"skins": [{"joints": [1, 2], "inverseBindMatrices": 0}]}, "inverse matrices"),
    ],
)
def test_malformed_skins_are_mesh_errors(tmp_path, change, message):
    file = skinned(JOINTS, [SECOND] * 4, {}, {})
    file.json.update(change)
    assert message in refused(file.write_glb(tmp_path / "a.glb"))


def test_joints_and_weights_of_another_length_are_mesh_errors(tmp_path):
    assert "four a vertex" in refused(skinned(JOINTS[:3], [SECOND] * 4, {}, {}).write_glb(tmp_path / "a.glb"))
    assert "not finite" in refused(
        skinned(JOINTS, [[np.nan, 0, 0, 0]] * 4, {}, {}).write_glb(tmp_path / "b.glb")
    )
