"""Mesh files in general: names, gzip, damage; polygons; and every real scene."""

from __future__ import annotations

import gzip
import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mesh_files import (
    QUICK,
    TEXTS,
    TRIANGLE_PLY,
    binary_ply,
    corners,
    fan,
    loaded,
    outcome,
    refused,
)
from scenes import manifest, scene, shared_root

from clgrid.errors import MeshError
from clgrid.mesh import load
from clgrid.meshfile.polygons import fans, strips


@pytest.mark.parametrize("kind", TEXTS)
@pytest.mark.parametrize("packed", [False, True])
def test_one_triangle_in_every_format_and_gzipped(tmp_path: Path, kind: str, packed: bool) -> None:
    text = TEXTS[kind].encode()
    name = f"One.{kind.upper()}" + (".GZ" if packed else "")
    mesh = loaded(tmp_path, name, gzip.compress(text) if packed else text)
    assert corners(mesh).tolist() == [[[0, 0, 0], [1, 0, 0], [0, 1, 0]]]
    assert mesh.vertices.dtype == np.float32
    assert mesh.faces.dtype == np.uint32
    assert mesh.warnings == ()
    assert mesh.source == str(tmp_path / name)


@pytest.mark.parametrize("kind", TEXTS)
@pytest.mark.parametrize("newline", ["\r\n", "\r"])
def test_foreign_line_ends(tmp_path: Path, kind: str, newline: str) -> None:
    assert loaded(tmp_path, f"a.{kind}", TEXTS[kind].replace("\n", newline)).triangle_count == 1


@pytest.mark.parametrize("kind", TEXTS)
def test_every_truncation_is_refused_or_read(tmp_path: Path, kind: str) -> None:
    text = TEXTS[kind].encode()
    for size in range(len(text)):
        (tmp_path / f"cut.{kind}").write_bytes(text[:size])
        found = outcome(tmp_path / f"cut.{kind}")
        # "cannot be read" is the word for failures that no reader foresaw
        assert found in (0, 1) or "cannot be read" not in str(found)


@given(data=st.data())
@QUICK
def test_damaged_text_never_escapes_as_another_exception(tmp_path: Path, data: st.DataObject) -> None:
    kind = data.draw(st.sampled_from(sorted(TEXTS)))
    text = bytearray(TEXTS[kind].encode())
    for _ in range(data.draw(st.integers(1, 4))):
        text[data.draw(st.integers(0, len(text) - 1))] = data.draw(st.integers(0, 255))
    (tmp_path / f"bad.{kind}").write_bytes(bytes(text))
    assert "\n" not in str(outcome(tmp_path / f"bad.{kind}"))


def test_unknown_and_missing_files(tmp_path: Path) -> None:
    assert "suffix '.txt'; give one of .ply" in refused(tmp_path, "a.txt", "x")
    assert "suffix ''" in refused(tmp_path, "a.gz", gzip.compress(b"x"))
    assert "is empty (0 bytes)" in refused(tmp_path, "a.ply", "")
    assert "is empty (0 bytes) after" in refused(tmp_path, "a.ply.gz", gzip.compress(b""))
    assert "holds no gzip data" in refused(tmp_path, "b.ply.gz", TRIANGLE_PLY)
    assert "truncated gzip" in refused(tmp_path, "c.ply.gz", gzip.compress(TRIANGLE_PLY.encode())[:-9])
    (tmp_path / "folder.ply").mkdir()
    os.mkfifo(tmp_path / "pipe.ply")
    for name in ("folder.ply", "pipe.ply"):
        with pytest.raises(MeshError, match=f"{name}: is not a regular file"):
            load(tmp_path / name)
    with pytest.raises(MeshError, match=r"none\.ply: cannot be opened \(No such file"):
        load(tmp_path / "none.ply")


def test_names_cannot_break_a_message_into_lines(tmp_path: Path) -> None:
    with pytest.raises(MeshError) as caught:
        loaded(tmp_path, "two\nlines\x1b[31m.ply", "nonsense")
    assert r"two\nlines\x1b[31m.ply: does not begin" in str(caught.value)


def test_arrays_do_not_change_with_the_file(tmp_path: Path) -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
    mesh = loaded(tmp_path, "a.ply", binary_ply(vertices, [[0, 1, 2]]))
    with open(tmp_path / "a.ply", "r+b") as file:
        file.seek(-50, 2)
        file.write(b"\xff" * 50)
    assert mesh.vertices.tolist() == vertices.tolist()
    assert mesh.faces.tolist() == [[0, 1, 2]]
    assert mesh.faces.flags.writeable


@given(st.lists(st.lists(st.integers(0, 99), max_size=7), max_size=9))
def test_fans_keep_the_order_of_polygons(polygons: list[list[int]]) -> None:
    flat = np.array([index for polygon in polygons for index in polygon], np.int64)
    found = fans(flat, np.array([len(polygon) for polygon in polygons], np.int64))
    assert found.tolist() == [triangle for polygon in polygons for triangle in fan(polygon)]


@given(st.lists(st.integers(-1, 5), max_size=12))
def test_strips_turn_every_second_triangle_and_restart(indices: list[int]) -> None:
    expected: list[list[int]] = []
    run: list[int] = []
    for index in indices:
        run = [] if index == -1 else [*run, index]
        if len(run) >= 3:
            a, b, c = run[-3:]
            expected.append([b, a, c] if len(run) % 2 == 0 else [a, b, c])
    assert strips(np.array(indices, np.int64), restart=-1).tolist() == expected


SCENES = [row for row in manifest("scenes") if row["triangles"] and row["format"] != "zip"]


NO_SCENES = pytest.mark.skip(reason=f"the scenes are not in {shared_root()} (set CLGRID_SCENES)")


@pytest.mark.skipif(not SCENES, reason=f"the scenes are not in {shared_root()} (set CLGRID_SCENES)")
def test_the_scenes_are_there() -> None:
    assert len(SCENES) > 20


@pytest.mark.parametrize(
    "row", SCENES or [pytest.param({}, marks=NO_SCENES)], ids=[row["file"] for row in SCENES] or ["scenes"]
)
def test_scene_counts_and_bounds(row: dict[str, str]) -> None:
    mesh = load(scene(row["file"]))
    assert mesh.triangle_count == int(row["triangles"])
    expected = [[float(value) for value in row[name].split(",")] for name in ("min_xyz", "max_xyz")]
    size = np.subtract(expected[1], expected[0]).max()
    # the manifest states six digits
    np.testing.assert_allclose(mesh.bounds, expected, rtol=1e-5, atol=1e-6 * size)
    if not row["format"].endswith("stl"):
        # of STL files the manifest counts facet normals
        assert (mesh.vertex_normals is not None) == (row["normals"] == "yes")
    if row["format"].startswith("glb"):
        assert len(mesh.geometry_names) >= int(row["materials"])


@pytest.mark.parametrize(
    "name",
    [
        "scans/horse.ply",
        "scans/bunny_zipper.ply",
        "scans/armadillo.obj",
        "cad/featuretype.STL",
        "cad/fandisk.off",
    ],
)
def test_triangles_equal_those_of_trimesh(name: str) -> None:
    trimesh = pytest.importorskip("trimesh")
    theirs = trimesh.load_mesh(scene(name), process=False, maintain_order=True)
    mesh = load(scene(name))
    assert corners(mesh).tobytes() == theirs.vertices[theirs.faces].astype(np.float32).tobytes()


@pytest.mark.parametrize(
    "name", ["textured/CesiumMilkTruck.glb", "textured/Duck.glb", "arch/sponza_dabrovic.glb"]
)
def test_transformed_triangles_equal_those_of_trimesh(name: str) -> None:
    trimesh = pytest.importorskip("trimesh")
    dumped = trimesh.load_scene(scene(name), process=False).dump()
    theirs = np.concatenate([part.vertices[part.faces] for part in dumped if hasattr(part, "faces")])
    ours = corners(load(scene(name))).astype(np.float64)
    size = np.ptp(ours.reshape(-1, 3), axis=0).max()
    for values in (ours, theirs):
        values[:] = np.round(values / (1e-5 * size))
    ours, theirs = (np.sort(values.mean(axis=1).sum(axis=1)) for values in (ours, theirs))
    np.testing.assert_allclose(ours, theirs, atol=3)
