"""OBJ, OFF and STL files, and how text of unstated precision is stored."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from mesh_files import (
    QUICK,
    TRIANGLE_OBJ,
    TRIANGLE_OFF,
    TRIANGLE_STL,
    corners,
    fan,
    loaded,
    refused,
)


@given(data=st.data())
@QUICK
def test_obj_corners_in_all_spellings(tmp_path: Path, data: st.DataObject) -> None:
    """Corners written alike take the fast way, others the slow one; both must find the same vertices."""
    count = data.draw(st.integers(3, 6))
    polygons = data.draw(
        st.lists(st.lists(st.integers(0, count - 1), min_size=3, max_size=5), min_size=1, max_size=6)
    )
    styles = data.draw(
        st.lists(st.sampled_from(["{v}", "{v}/9", "{v}//{n}", "{v}/9/{n}", "{v}/"]), min_size=1, max_size=2)
    )
    relative = data.draw(st.booleans())
    lines = [f"v {k} {k * k} 1\nvn 0 {k + 1} 0" for k in range(count)]
    expected = []
    number = 0
    for polygon in polygons:
        words = []
        for vertex in polygon:
            style = styles[number % len(styles)]
            number += 1
            index = vertex - count if relative else vertex + 1
            words.append(style.format(v=index, n=index))
        lines.append("f " + " ".join(words))
        expected += [[[k, k * k, 1] for k in triangle] for triangle in fan(polygon)]
    lines += ["v 0 0 0", "vn 0 0 0"]
    mesh = loaded(tmp_path, "a.obj", "\n".join(lines))
    assert corners(mesh).tolist() == expected
    if mesh.vertex_normals is not None:
        rows = np.column_stack([mesh.vertices, mesh.vertex_normals])[mesh.faces.reshape(-1)]
        assert all(row[4] in (0, row[0] + 1) for row in rows)
    assert (mesh.vertex_normals is not None) == any("{n}" in styles[k % len(styles)] for k in range(number))


def test_obj_vertices_split_only_where_normals_differ(tmp_path: Path) -> None:
    head = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvn 0 0 1\nvn 0 0 -1\n"
    smooth = loaded(tmp_path, "a.obj", head + "f 1//1 2//2 3//1\nf 1//1 3//1 4//1\n")
    assert len(smooth.vertices) == 4
    assert smooth.vertex_normals is not None
    assert smooth.vertex_normals[:, 2].tolist() == [1, -1, 1, 1]
    hard = loaded(tmp_path, "b.obj", head + "f 1//1 2//1 3//1\nf 1//2 3//2 4\n")
    assert hard.vertex_normals is not None
    assert corners(hard).tolist() == corners(smooth).tolist()
    assert hard.vertex_normals[hard.faces][:, :, 2].tolist() == [[1, 1, 1], [-1, -1, 0]]


def test_obj_geometries_in_the_order_of_the_file(tmp_path: Path) -> None:
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\no none\no box\nusemtl red\nf 1 2 3\nf 1 2 3 1\n"
    text += "usemtl red\nf 1 2 3\nusemtl blue\nf 1 2\ng lid top\nf 1 2 3\no box\nf 1 2 3\ng after\n"
    mesh = loaded(tmp_path, "a.obj", text)
    assert mesh.geometry_names == ("", "box", "lid top", "box")
    assert mesh.geometry_starts.tolist() == [0, 1, 5, 6, 7]
    assert "fewer than 3 corners (1)" in mesh.warnings[0]
    assert loaded(tmp_path, "b.obj", "usemtl a\n" + TRIANGLE_OBJ).geometry_names == ("a",)


def test_obj_odds_and_ends(tmp_path: Path) -> None:
    text = "\ufeff# c\nmtllib missing.mtl\nv  0 0 0 1\nv 1 0 0 .5 .5 .5 # red\nv 0 \\\n 1 0\n"
    text += "vt 0 0\ns 1\nf 1 \\\r\n2 3 # c\nl 1 2\n"
    mesh = loaded(tmp_path, "a.obj", text)
    assert corners(mesh).tolist() == [[[0, 0, 0], [1, 0, 0], [0, 1, 0]]]
    assert mesh.warnings == (f"{tmp_path / 'a.obj'}: left out: lines (1)",)
    for encoding in ("utf-16", "utf-16-be"):
        content = TRIANGLE_OBJ.encode(encoding)
        mark = b"\xfe\xff" if encoding == "utf-16-be" else b""
        assert loaded(tmp_path, "b.obj", mark + content).triangle_count == 1


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("f 0 1 2", "line 5 names vertex 0, and OBJ counts from 1"),
        ("f 1 2 4", "vertex 4 of 3"),
        ("f 1 2 -4", "vertex -4 of 3"),
        ("f 1 2 99999999999999999999", "of 3"),
        ("f 1/1 2/1 99999999999999999999", "of 3"),
        ("f 1//1 2//1 3//1", "normal 1 of 0"),
        ("f 1//0 2//0 3//0", "normal 0"),
        ("f 1 2 x", "b'x' is no corner"),
        ("f 1 2 3.5", "b'3.5' is no corner"),
        ("f 1/2/3/4 2 3", "no corner"),
        ("f 1 2 /3", "no corner"),
        ("f 1/1 2 3//x", "no corner"),
        ("v 1 2", "line 5 has no three numbers"),
        ("v 1 2 z", "b'z'"),
        ("vn 1 2 1_0", "b'1_0'"),
    ],
)
def test_malformed_obj(tmp_path: Path, line: str, message: str) -> None:
    assert message in refused(tmp_path, "a.obj", TRIANGLE_OBJ + line + "\n")


def test_obj_index_0_is_refused_where_vertices_follow(tmp_path: Path) -> None:
    assert "line 4 names vertex 0" in refused(
        tmp_path, "a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\nv 1 1 1\n"
    )


def test_obj_corners_of_1_and_3_numbers_are_not_two_of_2(tmp_path: Path) -> None:
    mesh = loaded(tmp_path, "a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvn 0 0 1\nf 1/1 2/1/1 3\n")
    assert corners(mesh).tolist() == [[[0, 0, 0], [1, 0, 0], [0, 1, 0]]]


def test_obj_without_statements_is_refused(tmp_path: Path) -> None:
    assert "no OBJ statement" in refused(tmp_path, "a.obj", bytes(range(1, 200)))


def far_triangle(kind: str, offset: float) -> str:
    rows = [f"{offset + x!r} {y!r} 0.1" for x, y in ((0.0, 0.0), (1.1, 0.0), (0.0, 1.3))]
    if kind == "obj":
        return "v 0 0 0\n" + "".join(f"v {row}\n" for row in rows) + "f 2 3 4\n"
    if kind == "off":
        return "OFF\n4 1 0\n0 0 0\n" + "\n".join(rows) + "\n3 1 2 3\n"
    return (
        "solid\nfacet\nouter loop\n"
        + "".join(f"vertex {row}\n" for row in rows)
        + "endloop\nendfacet\nendsolid"
    )


@pytest.mark.parametrize("kind", ["obj", "off", "stl"])
def test_text_far_from_the_origin_keeps_its_doubles(tmp_path: Path, kind: str) -> None:
    """The limit is 16 times the extent of what triangles use: the unused vertex at 0 does not count."""
    assert loaded(tmp_path, f"a.{kind}", far_triangle(kind, 15.0)).vertices.dtype == np.float32
    mesh = loaded(tmp_path, f"b.{kind}", far_triangle(kind, 1e7))
    assert mesh.vertices.dtype == np.float64
    assert corners(mesh)[0].tolist() == [[1e7, 0, 0.1], [1e7 + 1.1, 0, 0.1], [1e7, 1.3, 0.1]]


def test_text_beyond_float32_keeps_its_doubles(tmp_path: Path) -> None:
    for scale in ("e39", "e-46"):
        mesh = loaded(tmp_path, "a.obj", f"v 0 0 0\nv 1{scale} 0 0\nv 0 1{scale} 0\nf 1 2 3\n")
        assert mesh.bounds[1].tolist() == [float("1" + scale), float("1" + scale), 0]


@pytest.mark.parametrize(
    "text",
    [
        "OFF 3 1\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2",
        "# c\nOFF # c\n\n3 1 0 # c\n0 0 0\n\n1 0 0\n0 1 0\n3 0 1 2 255 0 0\n",
        "COFF\n3 1 0\n0 0 0 1 0 0 1\n1 0 0 1 0 0 1\n0 1 0 1 0 0 1\n3 0 1 2 0.5 0.5 0.5\n",
        "STOFF\n3 1 0\n0 0 0 1 0\n1 0 0 1 0\n0 1 0 1 0\n3 0 1 2\n",
    ],
)
def test_off_dialects(tmp_path: Path, text: str) -> None:
    mesh = loaded(tmp_path, "a.off", text)
    assert corners(mesh).tolist() == [[[0, 0, 0], [1, 0, 0], [0, 1, 0]]]
    assert mesh.vertex_normals is None


def test_off_polygons_and_normals(tmp_path: Path) -> None:
    text = "NOFF\n4 4 0\n0 0 0 0 0 1\n1 0 0 0 0 1\n1 1 0 0 0 1\n0 1 0 0 0 2\n"
    text += "4 0 1 2 3\n2 0 1\n3 3 2 1\n4 3 2 1 0 9\n"
    mesh = loaded(tmp_path, "a.off", text)
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3], [3, 2, 1], [3, 2, 1], [3, 1, 0]]
    assert mesh.vertex_normals is not None
    assert mesh.vertex_normals[:, 2].tolist() == [1, 1, 1, 2]
    assert "fewer than 3 corners (1 of 4)" in mesh.warnings[0]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("OFF", "PFF", "does not begin with the word OFF"),
        ("OFF", "OFF BINARY", "binary OFF"),
        ("OFF", "4OFF", "another dimension"),
        ("3 1 0", "3 -1 0", "no counts"),
        ("3 1 0", "3", "no counts"),
        ("3 1 0", "3 2 0", "truncated or its header lies"),
        ("3 1 0", "2 1 0", "truncated or its header lies"),
        ("1 0 0", "1 0", "vertex 1 has no 3 numbers"),
        ("1 0 0", "1 0 x", "b'x'"),
        ("3 0 1 2", "4 0 1 2", "face 0 lacks corners"),
        ("3 0 1 2", "-3 0 1 2", "face 0 lacks corners"),
        ("3 0 1 2", "3 0 1 2.5", "no whole number"),
        ("3 0 1 2", "3 0 1 3", "vertex 3 of 3"),
        ("3 0 1 2", "3 0 1 -1", "vertex -1 of 3"),
    ],
)
def test_malformed_off(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in TRIANGLE_OFF
    assert message in refused(tmp_path, "a.off", TRIANGLE_OFF.replace(old, new, 1))


def test_off_faces_of_3_and_5_numbers_are_not_two_of_4(tmp_path: Path) -> None:
    text = "OFF\n3 2 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1\n2 3 0 1 2\n"
    assert "face 0 lacks corners" in refused(tmp_path, "a.off", text)


def binary_stl(
    triangles: npt.NDArray[np.float32], announced: int | None = None, header: bytes = b""
) -> bytes:
    count = len(triangles) if announced is None else announced
    data = header.ljust(80, b"\0") + np.array(count, "<u4").tobytes()
    for triangle in triangles:
        data += np.zeros(3, "<f4").tobytes() + triangle.astype("<f4").tobytes() + b"\1\2"
    return data


@given(
    hnp.arrays(
        np.float32, st.tuples(st.integers(1, 5), st.just(3), st.just(3)), elements=st.floats(-9, 9, width=32)
    )
)
@QUICK
def test_binary_stl_comes_back_bit_for_bit(tmp_path: Path, triangles: npt.NDArray[np.float32]) -> None:
    for header in (b"", b"solid but binary", b"solid ".ljust(80)):
        mesh = loaded(tmp_path, "a.stl", binary_stl(triangles, header=header))
        assert corners(mesh).tobytes() == triangles.tobytes()


@pytest.mark.parametrize("announced", [0, 1, 3, 2**32 - 1])
def test_stl_counts_that_lie(tmp_path: Path, announced: int) -> None:
    triangles = np.ones((2, 3, 3), np.float32)
    assert f"announces {announced} triangles, and 2" in refused(
        tmp_path, "a.stl", binary_stl(triangles, announced)
    )


def test_every_truncation_of_binary_stl_is_refused(tmp_path: Path) -> None:
    content = binary_stl(np.ones((2, 3, 3), np.float32))
    for size in range(len(content)):
        refused(tmp_path, "a.stl", content[:size])
    assert loaded(tmp_path, "a.stl", content + b"\n\0").triangle_count == 2
    mesh = loaded(tmp_path, "a.stl", binary_stl(np.ones((0, 3, 3), np.float32)))
    assert (mesh.triangle_count, len(mesh.warnings)) == (0, 1)


def test_stl_solids_become_geometries(tmp_path: Path) -> None:
    facet = TRIANGLE_STL.split("\n", 1)[1].rsplit("endsolid", 1)[0]
    text = f"solid none\nendsolid\nSOLID  First Part\n{facet.upper()}{facet}endsolid\n"
    text += f"solid b\n{facet}endsolid\nsolid\nendsolid"
    mesh = loaded(tmp_path, "a.stl", text)
    assert mesh.geometry_names == ("First Part", "b")
    assert mesh.geometry_starts.tolist() == [0, 2, 3]
    assert loaded(tmp_path, "b.stl", "solid\nendsolid\n").triangle_count == 0


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("endsolid one", "", "without 'endsolid'"),
        ("vertex 1 0 0\n", "", "line 7 ends a facet that has not 3"),
        ("vertex 1 0 0\n", "vertex 1 0\n", "line 5 is out of place"),
        ("vertex 1 0 0\n", "vertex 1 0 0\n" * 2, "not 3 vertices"),
        ("vertex 1 0 0", "vertex 1 0 O", "b'O'"),
        ("vertex 1 0 0", "vertex 1 0 inf", "vertex 1"),
        ("endfacet\n", "", "out of place"),
        ("facet normal 0 0 1\n", "", "out of place"),
    ],
)
def test_malformed_ascii_stl(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in TRIANGLE_STL
    assert message in refused(tmp_path, "a.stl", TRIANGLE_STL.replace(old, new, 1))
