"""PLY: ascii and binary of both byte orders.

Read here and not through trimesh, which takes seconds for a scanned model in text, groups polygons by their
number of corners and so loses their order, knows no triangle strips, accepts infinite coordinates, and takes
files with too small counts.
"""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from clgrid.errors import MeshError
from clgrid.mesh import FloatArray
from clgrid.meshfile.content import Content
from clgrid.meshfile.numbers import float_tokens, narrowed_exact
from clgrid.meshfile.parts import Parts, empty
from clgrid.meshfile.ply_header import Element, Header, read_header
from clgrid.meshfile.ply_tables import Table, read_binary, read_text
from clgrid.meshfile.polygons import IntArray, fans, strips

Real = TypeVar("Real", np.float32, np.float64)
INDEX_NAMES = ("vertex_indices", "vertex_index")


def parse(data: Content, path: Path) -> Parts:
    """Read a PLY file: positions, normals, faces (polygons as fans) and triangle strips.

    Raises
    ------
    MeshError
        If the file is malformed, truncated, or holds more than its header says.
    """
    header = read_header(data)
    if not header.has_faces:
        return empty("the PLY header announces no faces: 0 triangles")
    tables = read_tables(data, header)
    elements = {element.name: element for element in header.elements}
    if "vertex" not in elements:
        raise MeshError("PLY header has faces and no element 'vertex'; repair the header")
    vertices = _positions(elements["vertex"], tables["vertex"])
    normals = _normals(elements["vertex"], tables["vertex"])
    faces, warnings = _faces(elements, tables)
    return Parts(vertices, faces, normals, warnings=warnings)


def read_tables(data: Content, header: Header) -> dict[str, Table]:
    """Rows of each element by its name.

    Raises
    ------
    MeshError
        If the data is malformed, truncated, or goes on behind what the header announces.
    """
    tables: dict[str, Table] = {}
    if header.byte_order:
        end = header.body
        for element in header.elements:
            tables[element.name], end = read_binary(data, end, element, header.byte_order)
        # padding is harmless; anything else means that the counts are too small
        rest = len(data[end:].strip(b"\0 \t\r\n")) if end < len(data) else 0
        unit = "bytes"
    else:
        tokens = float_tokens(data[header.body :], "PLY data")
        end = 0
        for element in header.elements:
            tables[element.name], end = read_text(tokens, end, element)
        rest, unit = len(tokens) - end, "numbers"
    if rest:
        raise MeshError(
            f"PLY data goes on for {rest} {unit} after what its header announces; "
            "correct the counts in the header"
        )
    return tables


def _positions(element: Element, table: Table) -> FloatArray:
    """(V, 3) float32, or float64 where the properties are double and do not all fit float32."""
    types = [
        entry.type for name in "xyz" if (entry := element.find(name)) is not None and not entry.count_type
    ]
    if len(types) != 3:
        raise MeshError("PLY element 'vertex' lacks one of the properties x, y, z; repair the header")
    if all(kind in ("f4", "i1", "u1", "i2", "u2") for kind in types):
        return _columns(table, ("x", "y", "z"), element.count, np.float32)
    return narrowed_exact(
        _columns(table, ("x", "y", "z"), element.count, np.float64).astype(np.float64, copy=False)
    )


def _normals(element: Element, table: Table) -> npt.NDArray[np.float32] | None:
    names = ("nx", "ny", "nz")
    if any((entry := element.find(name)) is None or entry.count_type for name in names):
        return None
    return _columns(table, names, element.count, np.float32)


def _columns(table: Table, names: tuple[str, str, str], count: int, dtype: type[Real]) -> npt.NDArray[Real]:
    rows: npt.NDArray[Real] = np.empty((count, 3), dtype)
    if count:
        with np.errstate(over="ignore", invalid="ignore"):
            for axis, name in enumerate(names):
                rows[:, axis] = table.values[name]
    return rows


def _faces(elements: dict[str, Element], tables: dict[str, Table]) -> tuple[IntArray, tuple[str, ...]]:
    found: list[IntArray] = []
    warnings: list[str] = []
    if "face" in elements and elements["face"].count:
        flat, counts = index_lists(elements["face"], tables["face"])
        short = int((counts < 3).sum())
        if short:
            warnings.append(f"left out: faces with fewer than 3 corners ({short} of {len(counts)})")
        found.append(fans(flat, counts))
    if "tristrips" in elements and elements["tristrips"].count:
        flat, counts = index_lists(elements["tristrips"], tables["tristrips"])
        # a row is a strip of its own, as if -1 stood between the rows
        found.append(strips(np.insert(flat.astype(np.int64), np.cumsum(counts)[:-1], -1), restart=-1))
    return (found[0] if len(found) == 1 else np.concatenate(found)), tuple(warnings)


def index_lists(element: Element, table: Table) -> tuple[IntArray, npt.NDArray[np.int64]]:
    """Flat indices of an element's rows and the number of each."""
    entry = element.find(*INDEX_NAMES)
    if entry is None or entry.count_type is None:
        raise MeshError(f"PLY element {element.name!r} has no list 'vertex_indices'; repair the header")
    if entry.type.startswith("f"):
        raise MeshError(f"PLY list {entry.name!r} of {element.name!r} is of a real type; write whole numbers")
    stored, counts = table.lists[entry.name]
    if stored.dtype.kind == "f":
        return _whole_numbers(stored.reshape(-1)), counts
    # one pass into native, contiguous memory; the view of the file ends here
    return stored.astype(stored.dtype.newbyteorder("="), order="C").reshape(-1), counts


def _whole_numbers(tokens: npt.NDArray[np.generic]) -> npt.NDArray[np.int64]:
    values = tokens.astype(np.float64, copy=False)
    with np.errstate(invalid="ignore"):
        whole = values.astype(np.int64)
    if not np.array_equal(whole, values):
        first = values[np.flatnonzero(whole != values)[0]]
        raise MeshError(f"PLY faces hold {first:g} as a vertex index; write whole numbers")
    return whole
