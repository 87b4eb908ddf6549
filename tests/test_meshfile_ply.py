"""PLY files: what they hold comes out bit for bit, whatever they are written like."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from mesh_files import (
    QUICK,
    TRIANGLE_PLY,
    binary_ply,
    fan,
    loaded,
    refused,
)


def coordinates(dtype: type) -> st.SearchStrategy[npt.NDArray[np.floating]]:
    width = np.dtype(dtype).itemsize * 8
    finite = st.floats(allow_nan=False, allow_infinity=False, width=width)  # type: ignore[arg-type]
    return hnp.arrays(dtype, st.tuples(st.integers(3, 8), st.just(3)), elements=finite)


EXTRAS = st.lists(st.sampled_from(["u1", "i2", "f4", "f8"]), max_size=3)


@given(data=st.data())
@QUICK
def test_binary_ply_comes_back_bit_for_bit(tmp_path: Path, data: st.DataObject) -> None:
    vertices = data.draw(coordinates(data.draw(st.sampled_from([np.float32, np.float64]))))
    shortest, longest = data.draw(st.sampled_from([(3, 3), (4, 4), (3, 5), (0, 6)]))
    index = st.integers(0, len(vertices) - 1)
    polygons = data.draw(
        st.lists(st.lists(index, min_size=shortest, max_size=longest), min_size=1, max_size=9)
    )

    def extra(name: str) -> tuple[tuple[str, str], ...]:
        return tuple((f"{name}{i}", kind) for i, kind in enumerate(data.draw(EXTRAS)))

    content = binary_ply(
        vertices,
        polygons,
        order=data.draw(st.sampled_from("<>")),
        count=data.draw(st.sampled_from(["u1", "i1", "i2", "u2", "i4", "u4"])),
        index=data.draw(st.sampled_from(["u1", "i1", "i2", "u2", "i4", "u4"])),
        before=extra("confidence"),
        after=extra("intensity"),
        face_extra=extra("flag"),
        newline=data.draw(st.sampled_from(["\n", "\r\n"])),
    )
    mesh = loaded(tmp_path, "a.ply", content)
    expected = [triangle for polygon in polygons for triangle in fan(polygon)]
    assert mesh.faces.tolist() == expected
    assert mesh.vertices.astype(vertices.dtype).tobytes() == vertices.tobytes()
    assert mesh.vertices.dtype == np.float32 or vertices.dtype == np.float64
    assert bool(mesh.warnings) == any(len(polygon) < 3 for polygon in polygons)


@given(data=st.data())
@QUICK
def test_ascii_ply_comes_back_bit_for_bit(tmp_path: Path, data: st.DataObject) -> None:
    dtype = data.draw(st.sampled_from([np.float32, np.float64]))
    vertices = data.draw(coordinates(dtype))
    shortest, longest = data.draw(st.sampled_from([(3, 3), (0, 6)]))
    index = st.integers(0, len(vertices) - 1)
    polygons = data.draw(
        st.lists(st.lists(index, min_size=shortest, max_size=longest), min_size=1, max_size=9)
    )
    name = "float" if dtype == np.float32 else "double"
    lines = [
        "ply",
        "format ascii 1.0",
        "element note 2",
        "property list uchar int n",
        f"element vertex {len(vertices)}",
    ]
    lines += [
        "property uchar red",
        *(f"property {name} {axis}" for axis in "xyz"),
        f"element face {len(polygons)}",
    ]
    lines += ["property list uchar int vertex_index", "property uchar flag", "end_header", "2 5 6", "0"]
    lines += ["8 " + " ".join(str(value) for value in row) for row in vertices]
    lines += [" ".join(map(str, [len(polygon), *polygon, 9])) for polygon in polygons]
    mesh = loaded(tmp_path, "a.ply", "\n".join(lines))
    assert mesh.faces.tolist() == [triangle for polygon in polygons for triangle in fan(polygon)]
    assert mesh.vertices.astype(dtype).tobytes() == vertices.tobytes()


def test_ply_doubles_stay_only_where_they_say_more(tmp_path: Path) -> None:
    exact = np.array([[0, 0, 0], [0.5, 0, 0], [0, 2.0**-140, 0]], np.float64)
    assert loaded(tmp_path, "a.ply", binary_ply(exact, [[0, 1, 2]])).vertices.dtype == np.float32
    for value in (0.1, 1e300, 2.0**-150):
        exact[1, 0] = value
        mesh = loaded(tmp_path, "b.ply", binary_ply(exact, [[0, 1, 2]]))
        assert mesh.vertices.dtype == np.float64
        assert mesh.vertices.tobytes() == exact.tobytes()


def test_ply_normals(tmp_path: Path) -> None:
    vertices = np.eye(3, dtype=np.float32)
    names = (("nx", "f4"), ("ny", "f8"), ("nz", "f4"))
    mesh = loaded(tmp_path, "a.ply", binary_ply(vertices, [[0, 1, 2]], after=names))
    assert mesh.vertex_normals is not None
    assert mesh.vertex_normals.dtype == np.float32
    assert mesh.vertex_normals.tolist() == [[7, 7, 7]] * 3
    assert (
        loaded(tmp_path, "b.ply", binary_ply(vertices, [[0, 1, 2]], after=names[:2])).vertex_normals is None
    )


def test_ply_normals_that_are_no_numbers_are_left_out(tmp_path: Path) -> None:
    text = TRIANGLE_PLY.replace(
        "float z\n", "float z\nproperty float nx\nproperty float ny\nproperty float nz\n"
    )
    text = (
        text.replace("0 0 0\n", "0 0 0 0 0 1\n")
        .replace("1 0 0\n", "1 0 0 nan 0 1\n")
        .replace("0 1 0\n", "0 1 0 0 2 0\n")
    )
    mesh = loaded(tmp_path, "a.ply", text)
    assert mesh.vertex_normals is not None
    assert mesh.vertex_normals.tolist() == [[0, 0, 1], [0, 0, 0], [0, 2, 0]]
    assert "NaN or infinite (1)" in mesh.warnings[0]


def test_ply_strips(tmp_path: Path) -> None:
    text = TRIANGLE_PLY.replace("vertex 3", "vertex 4").replace("element face 1", "element tristrips 2")
    text = text.replace("3 0 1 2\n", "1 1 0\n7 0 1 2 3 -1 2 1\n3 3 1 0\n")
    assert loaded(tmp_path, "a.ply", text).faces.tolist() == [[0, 1, 2], [2, 1, 3], [3, 1, 0]]


def test_ply_body_may_begin_like_a_line_end(tmp_path: Path) -> None:
    vertices = np.eye(3, dtype="<f4")
    vertices[0, 0] = np.frombuffer(b"\n\n\r\n", "<f4")[0]
    for newline in ("\n", "\r\n", "\r"):
        mesh = loaded(tmp_path, "a.ply", binary_ply(vertices, [[0, 1, 2]], newline=newline))
        assert mesh.vertices.tobytes() == vertices.tobytes()


@pytest.mark.parametrize(
    "polygons", [[[0, 1, 2], [2, 1, 0]], [[0, 1, 2], [0, 1, 2, 0]], [[0, 1, 2, 1], [2, 1, 0, 0]]]
)
@pytest.mark.parametrize("count", ["u1", "i4"])
def test_every_truncation_of_binary_ply_is_refused(
    tmp_path: Path, polygons: list[list[int]], count: str
) -> None:
    content = binary_ply(np.eye(3, dtype=np.float32), polygons, count=count, face_extra=(("flag", "u1"),))
    assert loaded(tmp_path, "a.ply", content).triangle_count == sum(len(polygon) - 2 for polygon in polygons)
    for size in range(len(content)):
        refused(tmp_path, "a.ply", content[:size])


@pytest.mark.parametrize("name", ["vertex", "face"])
@pytest.mark.parametrize("count", [5, 10**6, 2**31 - 1, 2**32, 10**18])
@pytest.mark.parametrize("binary", [False, True])
def test_ply_counts_that_promise_too_much(tmp_path: Path, name: str, count: int, binary: bool) -> None:
    content = binary_ply(np.eye(3, dtype=np.float32), [[0, 1, 2]]) if binary else TRIANGLE_PLY.encode()
    content = re.sub(rf"element {name} \d+".encode(), f"element {name} {count}".encode(), content)
    message = refused(tmp_path, "a.ply", content)
    assert f"announces {count} rows" in message or count == 5


def test_ply_counts_that_promise_too_little(tmp_path: Path) -> None:
    content = binary_ply(np.eye(3, dtype=np.float32), [[0, 1, 2], [2, 1, 0]])
    assert "correct the counts" in refused(tmp_path, "a.ply", content.replace(b"face 2", b"face 1"))
    assert "correct the counts" in refused(tmp_path, "a.ply", TRIANGLE_PLY + "3 0 1 2\n")
    assert loaded(tmp_path, "a.ply", content + b"\n\0\0").triangle_count == 2


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("ply\n", "plx\n", "does not begin"),
        ("end_header", "", "no line 'end_header'"),
        ("format ascii 1.0\n", "", "no line 'format"),
        ("format ascii", "format text", "line 2"),
        ("vertex 3", "vertex three", "line 3"),
        ("vertex 3", "vertex -3", "line 3"),
        ("property float x", "property real x", "line 4"),
        ("property float x", "property float y", "twice"),
        ("property float x", "property float u", "lacks one of"),
        ("element vertex", "element point", "no element 'vertex'"),
        ("list uchar int vertex_indices", "list float int vertex_indices", "list length"),
        ("list uchar int vertex_indices", "list uchar float vertex_indices", "real type"),
        ("list uchar int vertex_indices", "list uchar int texcoords", "no list 'vertex_indices'"),
        ("3 0 1 2", "3 0 1 3", "vertex 3 of 3"),
        ("3 0 1 2", "3 0 1 -1", "vertex -1 of 3"),
        ("3 0 1 2", "3 0 1 1.5", "1.5 as a vertex index"),
        ("3 0 1 2", "3 0 1 nan", "vertex index"),
        ("3 0 1 2", "3 0 1 4294967297", "vertex 4294967297 of 3"),
        ("3 0 1 2", "-3 0 1 2", "length of 'vertex_indices' is -3"),
        ("3 0 1 2", "1e300 0 1 2", "truncated"),
        ("1 0 0", "1 0 1,5", "b'1,5'"),
        ("1 0 0", "1 0 nan", "vertex 1"),
        ("1 0 0", "1 0 1e39", "vertex 1"),
    ],
)
def test_malformed_ply(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in TRIANGLE_PLY
    assert message in refused(tmp_path, "a.ply", TRIANGLE_PLY.replace(old, new, 1))


def test_ply_without_faces_is_empty(tmp_path: Path) -> None:
    text = TRIANGLE_PLY.replace("face 1", "face 0").replace("3 0 1 2\n", "")
    mesh = loaded(tmp_path, "a.ply", text)
    assert mesh.triangle_count == 0
    assert "0 triangles" in mesh.warnings[0]
