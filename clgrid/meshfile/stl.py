"""STL, binary and ascii: three vertices a triangle, nothing shared.

Read here and not through trimesh, which takes a truncated binary file for an ascii one without solids and
loads nothing, and skips solids that do not end.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import numpy.typing as npt

from clgrid.errors import MeshError
from clgrid.mesh import MAX_COUNT
from clgrid.meshfile.content import Content
from clgrid.meshfile.numbers import float_tokens
from clgrid.meshfile.parts import Parts, empty

HEADER = 84
FACET = np.dtype([("normal", "<f4", (3,)), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def parse(data: Content, path: Path) -> Parts:
    """Read an STL file; facet normals are not shading normals and are skipped.

    Raises
    ------
    MeshError
        If the file is shorter or longer than its facets, or neither binary nor ascii STL.
    """
    announced = int.from_bytes(data[80:HEADER], "little")
    if len(data) >= HEADER and len(data) == HEADER + announced * FACET.itemsize:
        return _binary(data, announced)
    if re.match(rb"(\xef\xbb\xbf)?\s*solid\b", data, re.IGNORECASE) and b"\0" not in data[:HEADER]:
        return _ascii(data[:])
    if len(data) < HEADER:
        raise MeshError(f"has {len(data)} bytes, less than the header of a binary STL file; it is truncated")
    held, rest = divmod(len(data) - HEADER, FACET.itemsize)
    if held >= announced and not data[HEADER + announced * FACET.itemsize :].strip(b"\0 \t\r\n"):
        return _binary(data, announced)
    raise MeshError(
        f"STL header announces {announced} triangles, and {held} and {rest} bytes follow; "
        "the file is truncated or its header lies: export it again"
    )


def _binary(data: Content, count: int) -> Parts:
    if count == 0:
        return empty("is an STL file without facets: 0 triangles")
    corners = np.empty((3 * count, 3), np.float32)
    corners.reshape(count, 3, 3)[:] = np.frombuffer(data, FACET, count, HEADER)["corners"]
    return Parts(corners, _sequence(count))


def _sequence(count: int) -> npt.NDArray[np.uint32]:
    """(count, 3): every triangle has vertices of its own."""
    if 3 * count > MAX_COUNT:
        raise MeshError(f"holds {3 * count} vertices, at most {MAX_COUNT} fit; split the mesh")
    return np.arange(3 * count, dtype=np.uint32).reshape(-1, 3)


def _ascii(text: bytes) -> Parts:
    """Solids become geometries; one without facets is left out."""
    text = text.removeprefix(b"\xef\xbb\xbf")
    coordinates: list[bytes] = []
    starts: list[int] = []
    names: list[str] = []
    inside = in_facet = False
    facets = 0
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split()
        if not words:
            continue
        key = words[0].lower()
        if key == b"vertex" and in_facet and len(words) == 4:
            coordinates += words[1:]
        elif key == b"facet" and inside and not in_facet:
            in_facet = True
        elif key == b"endfacet" and in_facet:
            in_facet = False
            facets += 1
            if len(coordinates) != 9 * facets:
                raise MeshError(
                    f"STL line {number} ends a facet that has not 3 vertices; repair or re-export the file"
                )
        elif key == b"solid" and not inside:
            inside = True
            if not starts or starts[-1] != facets:
                starts.append(facets)
                names.append("")
            names[-1] = b" ".join(words[1:]).decode("utf-8", "replace")
        elif key == b"endsolid" and inside and not in_facet:
            inside = False
        elif key not in (b"outer", b"endloop"):
            raise MeshError(f"STL line {number} is out of place: {line[:60]!r}; repair or re-export the file")
    if inside:
        raise MeshError(f"STL text ends after {facets} facets without 'endsolid'; the file is truncated")
    if not facets:
        return empty("is an STL file without facets: 0 triangles")
    if starts[-1] == facets:
        del starts[-1], names[-1]
    vertices = float_tokens(b" ".join(coordinates), "STL vertices", len(coordinates)).reshape(-1, 3)
    return Parts(
        vertices,
        _sequence(facets),
        geometry_starts=np.array([*starts, facets], np.int64),
        geometry_names=tuple(names),
        untyped=True,
    )
