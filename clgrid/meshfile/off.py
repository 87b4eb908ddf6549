"""OFF (text): vertices, polygons, and normals of NOFF; colours and texture coordinates are skipped.

Read here and not through trimesh, which groups polygons by their number of corners and so loses their order,
reads half of a malformed file as an empty mesh, and knows no normals.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import numpy.typing as npt

from clgrid.errors import MeshError
from clgrid.meshfile.content import Content
from clgrid.meshfile.numbers import float_tokens, int_tokens
from clgrid.meshfile.parts import Parts, empty
from clgrid.meshfile.polygons import IntArray, fans

Lines = list[bytes]


def parse(data: Content, path: Path) -> Parts:
    """Read an OFF file: one vertex or polygon a line, polygons as fans.

    Raises
    ------
    MeshError
        If the file is malformed, shorter or longer than its counts, binary, or not three-dimensional.
    """
    lines, has_normals = _content_lines(data[:])
    vertex_count, face_count = _counts(lines)
    left = len(lines) - 1
    if vertex_count + face_count != left:
        raise MeshError(
            f"OFF header announces {vertex_count} vertices and {face_count} faces and {left} lines follow; "
            "the file is truncated or its header lies: export it again"
        )
    rows = _vertex_rows(lines[1 : 1 + vertex_count], 6 if has_normals else 3)
    if face_count == 0:
        return empty(f"holds {vertex_count} vertices and no faces: 0 triangles")
    flat, counts = _polygons(lines[1 + vertex_count :])
    short = int((counts < 3).sum())
    warnings = (f"left out: faces with fewer than 3 corners ({short} of {face_count})",) if short else ()
    with np.errstate(over="ignore"):
        normals = rows[:, 3:].astype(np.float32) if has_normals else None
    return Parts(
        np.ascontiguousarray(rows[:, :3]), fans(flat, counts), normals, warnings=warnings, untyped=True
    )


def _content_lines(text: bytes) -> tuple[Lines, bool]:
    """Lines without comments, the keyword taken off; and whether vertices carry normals."""
    text = text.removeprefix(b"\xef\xbb\xbf")
    if b"#" in text:
        text = re.sub(rb"#[^\r\n]*", b"", text)
    keyword = re.match(rb"\s*(ST)?(C)?(N)?(4)?(n)?OFF\b([ \t]*BINARY\b)?", text)
    if keyword is None:
        raise MeshError("does not begin with the word OFF; it is no OFF file")
    if keyword.group(6):
        raise MeshError("is a binary OFF file, which is not read; convert it to text or to PLY")
    if keyword.group(4) or keyword.group(5):
        raise MeshError("is an OFF file of another dimension than 3, which is not read; convert it")
    lines = [line for line in text[keyword.end() :].splitlines() if line and not line.isspace()]
    return lines, keyword.group(3) is not None


def _counts(lines: Lines) -> tuple[int, int]:
    words = lines[0].split() if lines else []
    if len(words) not in (2, 3) or not all(word.isdigit() for word in words):
        given = lines[0][:60] if lines else b""
        raise MeshError(
            f"OFF header has no counts of vertices, faces and edges: {given!r}; repair the header"
        )
    return int(words[0]), int(words[1])


def _vertex_rows(lines: Lines, width: int) -> npt.NDArray[np.float64]:
    """(V, width) float64: the first numbers of each line."""
    if not lines:
        return np.zeros((0, width), np.float64)
    fields = [line.split(None, width) for line in lines]
    for number, words in enumerate(fields):
        if len(words) < width:
            raise MeshError(f"OFF vertex {number} has no {width} numbers: {lines[number][:60]!r}; correct it")
    text = b" ".join([word for words in fields for word in words[:width]])
    return float_tokens(text, "OFF vertices", width * len(lines)).reshape(-1, width)


def _polygons(lines: Lines) -> tuple[IntArray, npt.NDArray[np.int64]]:
    """Corners of all faces, one after the other, and the number of each; what follows on a line is colour."""
    numbers = int_tokens(b" ".join(lines))
    triangles = numbers is not None and len(numbers) == 4 * len(lines) and (numbers[::4] == 3).all()
    # lines of 3 and 5 numbers could pass for two of 4: each line must hold its own
    if numbers is not None and triangles and all(len(line.split()) == 4 for line in lines):
        return numbers.reshape(-1, 4)[:, 1:].reshape(-1), np.full(len(lines), 3, np.int64)
    corners: list[bytes] = []
    counts: list[int] = []
    for number, line in enumerate(lines):
        words = line.split()
        length = int(words[0]) if words[0].isdigit() else -1
        if not 0 <= length < len(words):
            raise MeshError(
                f"OFF face {number} lacks corners: {line[:60]!r}; the file is truncated or malformed"
            )
        corners += words[1 : 1 + length]
        counts.append(length)
    flat = int_tokens(b" ".join(corners))
    if flat is None or len(flat) != len(corners):
        raise MeshError(
            "OFF faces hold a vertex index that is no whole number; correct or re-export the file"
        )
    return flat, np.array(counts, np.int64)
