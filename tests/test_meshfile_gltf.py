"""glTF and GLB files: containers, accessors, primitives, and what a damaged document leads to."""

from __future__ import annotations

import copy
import gzip
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gltf_files import (
    TETRAHEDRON,
    TETRAHEDRON_FACES,
    TETRAHEDRON_NORMALS,
    GltfFile,
    complaints,
    corners,
    refused,
    tetrahedron,
)
from hypothesis import given
from hypothesis import strategies as st
from mesh_files import QUICK

from clgrid.mesh import load


@pytest.mark.parametrize("suffix", [".glb", ".gltf", ".GLB.gz", ".gltf.gz"])
def test_containers(tmp_path: Path, suffix: str) -> None:
    file = tetrahedron()
    plain = tmp_path / "plain"
    (file.write_glb if "glb" in suffix.lower() else file.write_gltf)(plain)
    path = tmp_path / ("a" + suffix)
    path.write_bytes(gzip.compress(plain.read_bytes()) if suffix.endswith("gz") else plain.read_bytes())
    mesh = load(path)
    assert mesh.vertices.tobytes() == TETRAHEDRON.tobytes()
    assert mesh.faces.tolist() == TETRAHEDRON_FACES.tolist()
    assert mesh.vertex_normals is not None
    assert mesh.vertex_normals.tobytes() == TETRAHEDRON_NORMALS.tobytes()
    assert mesh.geometry_names == ("tetrahedron",)
    assert mesh.warnings == ()


def test_buffer_in_a_file_beside_with_an_escaped_name(tmp_path: Path) -> None:
    path = tetrahedron().write_gltf(tmp_path / "a.gltf", uri="the%20data.bin")
    assert load(path).triangle_count == 4
    (tmp_path / "the data.bin").write_bytes(b"short")
    assert "buffer 0 announces" in refused(path)
    (tmp_path / "the data.bin").unlink()
    assert "buffer 0 'the%20data.bin' cannot be opened" in refused(path)


@pytest.mark.parametrize(
    "uri", ["https://example.org/a.bin", "file:///etc/passwd", "/etc/passwd", "data:;base64,%%%"]
)
def test_buffers_elsewhere_are_refused(tmp_path: Path, uri: str) -> None:
    path = tetrahedron().write_gltf(tmp_path / "a.gltf")
    path.write_text(json.dumps(json.loads(path.read_text()) | {"buffers": [{"byteLength": 1, "uri": uri}]}))
    assert "glTF buffer 0" in refused(path)


def test_missing_textures_do_not_matter(tmp_path: Path) -> None:
    file = tetrahedron()
    file.json["images"] = [{"uri": "missing.png"}, {"uri": "https://example.org/x.png"}]
    file.json["textures"] = [{"source": 0}]
    file.json["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]
    file.json["meshes"][0]["primitives"][0]["material"] = 0
    assert load(file.write_gltf(tmp_path / "a.gltf")).warnings == ()


def test_every_truncation_of_a_glb_is_refused(tmp_path: Path) -> None:
    path = tetrahedron().write_glb(tmp_path / "a.glb")
    content = path.read_bytes()
    for size in range(len(content)):
        path.write_bytes(content[:size])
        refused(path)
    path.write_bytes(content + bytes(8))
    assert f"announces {len(content)} bytes and the file has {len(content) + 8}" in refused(path)


@given(data=st.data())
@QUICK
def test_damaged_bytes_never_escape_as_another_exception(tmp_path: Path, data: st.DataObject) -> None:
    path = tetrahedron({"mesh": 0, "children": [1]}, {"camera": 0}, roots=[0]).write_glb(tmp_path / "a.glb")
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(bytes(content))
    assert not any("\n" in message for message in complaints(path))


def all_places(node: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Every place in a JSON document."""
    found = [path] if path else []
    items = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for key, value in items:
        found += all_places(value, (*path, key))
    return found


@given(data=st.data())
@QUICK
def test_any_member_may_be_anything(tmp_path: Path, data: st.DataObject) -> None:
    nodes = ({"mesh": 0, "children": [1], "translation": [1, 2, 3]}, {"camera": 0, "rotation": [0, 0, 0, 1]})
    document = tetrahedron(*nodes, roots=[0])
    document.json["cameras"] = [{"type": "perspective", "perspective": {"yfov": 1, "znear": 0.1}}]
    path = document.write_gltf(tmp_path / "a.gltf")
    changed = json.loads(path.read_text())
    place = data.draw(st.sampled_from(all_places(changed)))
    holder = changed
    for key in place[:-1]:
        holder = holder[key]
    values = [None, -1, 0, 1, 7, 2**31, 2**64, 1e300, 0.5, "", "x", [], [0], [[]], {}, True]
    holder[place[-1]] = copy.deepcopy(data.draw(st.sampled_from(values)))
    path.write_text(json.dumps(changed))
    assert not any("cannot be read" in message for message in complaints(path))


def test_interleaved_vertices_and_index_types(tmp_path: Path) -> None:
    for kind in ("u1", "u2", "u4"):
        file = GltfFile()
        both = np.hstack([TETRAHEDRON, TETRAHEDRON_NORMALS]).astype(np.float32)
        file.accessor(both.reshape(-1))
        file.json["bufferViews"][0]["byteStride"] = 24
        shared = {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"}
        file.json["accessors"] = [shared, shared | {"byteOffset": 12}]
        indices = file.accessor(TETRAHEDRON_FACES.reshape(-1).astype(kind))
        file.mesh({"attributes": {"POSITION": 0, "NORMAL": 1}, "indices": indices})
        file.nodes({"mesh": 0})
        mesh = load(file.write_glb(tmp_path / "a.glb"))
        assert mesh.vertices.tobytes() == TETRAHEDRON.tobytes()
        assert mesh.vertex_normals is not None
        assert mesh.vertex_normals.tobytes() == TETRAHEDRON_NORMALS.tobytes()
        assert mesh.faces.tolist() == TETRAHEDRON_FACES.tolist()


@pytest.mark.parametrize(
    ("mode", "expected"),
    [
        (4, [[0, 1, 2], [1, 3, 2]]),
        (5, [[0, 1, 2], [2, 1, 1], [2, 1, 3], [3, 1, 2]]),
        (6, [[0, 1, 2], [0, 2, 1], [0, 1, 3], [0, 3, 2]]),
    ],
)
@pytest.mark.parametrize("indexed", [True, False])
def test_triangles_strips_and_fans(
    tmp_path: Path, mode: int, expected: list[list[int]], indexed: bool
) -> None:
    order = [0, 1, 2, 1, 3, 2]
    file = GltfFile()
    positions = TETRAHEDRON if indexed else TETRAHEDRON[order]
    primitive = {"attributes": {"POSITION": file.accessor(positions)}, "mode": mode}
    if indexed:
        primitive["indices"] = file.accessor(np.array(order, np.uint8))
    file.mesh(primitive)
    file.nodes({"mesh": 0})
    found = corners(load(file.write_glb(tmp_path / "a.glb")))
    assert found.tolist() == TETRAHEDRON[expected].tolist()


def test_points_and_lines_are_left_out_with_a_warning(tmp_path: Path) -> None:
    file = tetrahedron()
    file.json["meshes"][0]["primitives"] += [
        {"attributes": {"POSITION": 0}, "mode": mode} for mode in (0, 1, 2, 3)
    ]
    mesh = load(file.write_glb(tmp_path / "a.glb"))
    assert mesh.triangle_count == 4
    assert mesh.warnings == (f"{tmp_path / 'a.glb'}: left out: primitives of points or lines (4)",)


def test_sparse_and_absent_data(tmp_path: Path) -> None:
    """Positions that begin as zeros and are all replaced, as a morph target would be written."""
    file = GltfFile()
    values = file.accessor(TETRAHEDRON[1:])
    where = file.accessor(np.array([1, 2, 3], np.uint8))
    indices = file.accessor(TETRAHEDRON_FACES.reshape(-1))
    sparse = {
        "count": 3,
        "indices": {"bufferView": where, "componentType": 5121},
        "values": {"bufferView": values},
    }
    file.json["accessors"].append({"componentType": 5126, "count": 4, "type": "VEC3", "sparse": sparse})
    file.mesh({"attributes": {"POSITION": 3}, "indices": indices})
    file.nodes({"mesh": 0})
    assert load(file.write_glb(tmp_path / "a.glb")).vertices.tobytes() == TETRAHEDRON.tobytes()
    file.json["accessors"][3]["count"] = 3
    assert "replaces an element beyond its 3" in refused(file.write_glb(tmp_path / "a.glb"))
    file.json["accessors"][3] = {"componentType": 5126, "count": 2**40, "type": "VEC3"}
    assert f"no data for its {2**40} elements" in refused(file.write_glb(tmp_path / "a.glb"))


def test_quantized_positions_and_normals(tmp_path: Path) -> None:
    file = GltfFile()
    positions = file.accessor(
        np.array([[0, 0, 0, 0], [32767, 0, 0, 0], [0, -32768, 0, 0]], "i2")[:, :3].copy()
    )
    file.json["bufferViews"][0] |= {"byteLength": 18}
    file.json["accessors"][0]["normalized"] = True
    normals = file.accessor(np.array([[0, 0, 127]] * 3, "i1"), normalized=True)
    file.mesh({"attributes": {"POSITION": positions, "NORMAL": normals}})
    file.nodes({"mesh": 0})
    file.json["extensionsRequired"] = ["KHR_mesh_quantization"]
    mesh = load(file.write_glb(tmp_path / "a.glb"))
    assert mesh.vertices.dtype == np.float32
    assert mesh.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [0, -1, 0]]
    assert mesh.vertex_normals is not None
    assert mesh.vertex_normals.tolist() == [[0, 0, 1]] * 3
    assert mesh.warnings == ()


def test_primitives_share_vertices_where_they_share_accessors(tmp_path: Path) -> None:
    file = tetrahedron(normals=False)
    file.json["meshes"][0]["primitives"] *= 3
    mesh = load(file.write_glb(tmp_path / "a.glb"))
    assert (len(mesh.vertices), mesh.triangle_count) == (4, 12)
    assert mesh.geometry_starts.tolist() == [0, 4, 8, 12]


def test_primitives_without_normals_beside_such_with(tmp_path: Path) -> None:
    file = tetrahedron()
    bare = {"attributes": {"POSITION": file.accessor(TETRAHEDRON)}, "indices": 2}
    file.json["meshes"][0]["primitives"].append(bare)
    mesh = load(file.write_glb(tmp_path / "a.glb"))
    assert mesh.vertex_normals is not None
    assert mesh.vertex_normals.tolist() == [*TETRAHEDRON_NORMALS.tolist(), *[[0, 0, 0]] * 4]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d["accessors"][2].update(count=11), "11 corners, not whole triangles"),
        (lambda d: d["accessors"][2].update(componentType=5122), "no unsigned scalars"),
        (lambda d: d["accessors"][2].update(componentType=5126, count=6), "no unsigned scalars"),
        (lambda d: d["accessors"][2].update(type="VEC4", count=3), "no unsigned scalars"),
        (lambda d: d["accessors"][2].update(count=10**15), "its buffer view"),
        (lambda d: d["accessors"][0].update(byteOffset=1), "its buffer view has 48"),
        (lambda d: d["accessors"][0].update(type="VEC2"), "2-component"),
        (lambda d: d["accessors"][0].update(type="VEC5"), "unknown type"),
        (lambda d: d["accessors"][0].update(componentType=5130), "unknown type"),
        (lambda d: d["accessors"][0].update(bufferView=9), "names buffer view 9 of 3"),
        (lambda d: d["accessors"][1].update(count=3), "3 normals for 4 positions"),
        (lambda d: d["bufferViews"][0].update(buffer=1), "names buffer 1 of 1"),
        (lambda d: d["bufferViews"][0].update(byteOffset=999), "ends at byte"),
        (lambda d: d["bufferViews"][0].update(byteStride=4), "stride 4"),
        (lambda d: d["bufferViews"][0].update(byteStride=16), "stride 16"),
        (lambda d: d["meshes"][0]["primitives"][0].update(indices=3), "names accessor 3 of 3"),
        (lambda d: d["meshes"][0]["primitives"][0].update(mode=7), "unknown mode 7"),
        (lambda d: d["meshes"][0]["primitives"][0]["attributes"].update(POSITION=-1), "wrong type"),
        (lambda d: d["nodes"][0].update(mesh=1), "names mesh 1 of 1"),
        (lambda d: d["nodes"][0].update(children=[1]), "names child node 1 of 1"),
        (lambda d: d["nodes"][0].update(rotation=[0, 0, 0, 0]), "rotation of length 0"),
        (lambda d: d["nodes"][0].update(matrix=[1] * 15), "wrong type"),
        (lambda d: d["nodes"][0].update(scale=[1e200, 1, 1], matrix=None, translation=[1e400, 0, 0]), ""),
        (lambda d: d["scenes"][0].update(nodes=[0, 0]), "drawn twice"),
        (lambda d: d["scenes"][0].update(nodes=[1]), "names node 1 of 1"),
        (lambda d: d.update(scene=1), "names scene 1 of 1"),
        (lambda d: d["asset"].update(version="1.0"), "version '1.0'"),
        (lambda d: d.pop("asset"), "asset"),
        (lambda d: d.update(extensionsRequired=["KHR_draco_mesh_compression"]), "KHR_draco_mesh_compression"),
    ],
)
def test_malformed_documents(tmp_path: Path, change: Any, message: str) -> None:
    path = tetrahedron().write_gltf(tmp_path / "a.gltf")
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))
    assert message in refused(path)


def test_index_out_of_range_names_the_primitive(tmp_path: Path) -> None:
    file = tetrahedron()
    file.json["meshes"][0]["primitives"].append({"attributes": {"POSITION": 0}, "indices": 3})
    file.accessor(np.array([0, 1, 2, 0, 4, 65535], np.uint16))
    indices = file.json["meshes"][0]["primitives"][1]["indices"]
    last = file.accessor(np.array([0, 1, 2, 0, 3, 4], np.uint16))
    file.json["meshes"][0]["primitives"][1]["indices"] = last
    assert "1 of 6 indices" in refused(file.write_glb(tmp_path / "a.glb"))
    file.json["meshes"][0]["primitives"][1]["indices"] = indices
    message = refused(file.write_glb(tmp_path / "a.glb"))
    assert "mesh 0 primitive 1: 2 of 6 indices name a missing vertex, first index 4: vertex 4 of 4" in message
