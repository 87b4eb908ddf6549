"""Small mesh files in every format, and how tests load or expect to have them refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import HealthCheck, settings

from clgrid.errors import MeshError
from clgrid.mesh import Mesh, load

QUICK = settings(
    max_examples=60,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
PLY_NAMES = {"i1": "char", "u1": "uchar", "i2": "short", "u2": "ushort", "i4": "int", "u4": "uint"}
PLY_NAMES |= {"f4": "float", "f8": "double"}

TRIANGLE_PLY = """ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
0 1 0
3 0 1 2
"""
TRIANGLE_OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
TRIANGLE_OFF = "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
TRIANGLE_STL = """solid one
facet normal 0 0 1
outer loop
vertex 0 0 0
vertex 1 0 0
vertex 0 1 0
endloop
endfacet
endsolid one
"""
TEXTS = {"ply": TRIANGLE_PLY, "obj": TRIANGLE_OBJ, "off": TRIANGLE_OFF, "stl": TRIANGLE_STL}


def loaded(folder: Path, name: str, content: str | bytes) -> Mesh:
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return load(path)


def refused(folder: Path, name: str, content: str | bytes) -> str:
    """Message of the one-line error that the file must cause."""
    with pytest.raises(MeshError) as caught:
        loaded(folder, name, content)
    message = str(caught.value)
    assert message.startswith(f"{folder / name}: ")
    assert "\n" not in message
    # the word for failures that no reader foresaw
    assert "cannot be read" not in message
    return message


def outcome(path: Path) -> int | str:
    """Number of triangles, or the message with which the file is refused; any other exception passes."""
    try:
        return load(path).triangle_count
    except MeshError as error:
        return str(error)


def corners(mesh: Mesh) -> npt.NDArray[np.floating]:
    """(F, 3, 3) corner positions."""
    return mesh.vertices[mesh.faces]


def binary_ply(
    vertices: npt.NDArray[np.floating],
    polygons: list[list[int]],
    *,
    order: str = "<",
    count: str = "u1",
    index: str = "i4",
    before: tuple[tuple[str, str], ...] = (),
    after: tuple[tuple[str, str], ...] = (),
    face_extra: tuple[tuple[str, str], ...] = (),
    newline: str = "\n",
) -> bytes:
    """PLY written value by value, independent of the reader's record types."""
    kind = vertices.dtype.str[1:]
    fields = [*before, *((axis, kind) for axis in "xyz"), *after]
    lines = [
        "ply",
        f"format binary_{'little' if order == '<' else 'big'}_endian 1.0",
        "comment end_header is near",
    ]
    lines += [f"element vertex {len(vertices)}", *(f"property {PLY_NAMES[t]} {name}" for name, t in fields)]
    lines += [
        f"element face {len(polygons)}",
        f"property list {PLY_NAMES[count]} {PLY_NAMES[index]} vertex_indices",
    ]
    lines += [f"property {PLY_NAMES[t]} {name}" for name, t in face_extra]
    data = [newline.join([*lines, "end_header", ""]).encode()]
    for row in vertices:
        for name, t in fields:
            value = row["xyz".index(name)] if name in "xyz" else 7
            data.append(np.array(value, order + t).tobytes())
    for polygon in polygons:
        data.append(np.array(len(polygon), order + count).tobytes())
        data.append(np.array(polygon, order + index).tobytes())
        data += [np.array(9, order + t).tobytes() for _, t in face_extra]
    return b"".join(data)


def fan(polygon: list[int]) -> list[list[int]]:
    return [[polygon[0], polygon[k], polygon[k + 1]] for k in range(1, len(polygon) - 1)]
