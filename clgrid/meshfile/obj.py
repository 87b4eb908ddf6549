"""Wavefront OBJ: polygons with their objects, groups, material names and normals.

Read here and not through trimesh, which reorders triangles by material, takes index 0 for the last vertex,
and drops faces it does not understand without a word.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from clgrid.errors import MeshError
from clgrid.meshfile.content import Content
from clgrid.meshfile.numbers import float_tokens
from clgrid.meshfile.obj_corners import NO_NORMAL, Corners
from clgrid.meshfile.parts import Parts, empty
from clgrid.meshfile.polygons import fans

IGNORED = frozenset(
    b"vt vp s mtllib usemap maplib shadow_obj trace_obj lod bevel c_interp d_interp mg cstype deg bmat step "
    b"parm trim hole scrv sp end con ctech stech call csh".split()
)
LEFT_OUT = {
    b"l": "lines",
    b"p": "points",
    b"curv": "curves",
    b"curv2": "curves",
    b"surf": "free-form surfaces",
}
FLUSH = 1 << 20
"""Words kept as Python objects before they become numbers: bounds the scratch memory."""


def parse(data: Content, path: Path) -> Parts:
    """Read an OBJ file: faces as fans, vertices split only where one carries several normals.

    A new geometry begins where object, group or material change. Faces of fewer than three corners, lines and
    points are left out with a warning.

    Raises
    ------
    MeshError
        For anything that is no number, an index that is 0 or beyond the vertices, or no OBJ statement at all.
    """
    scan = Scan()
    scan.read(plain_text(data))
    positions, normals = scan.positions.array(), scan.normals.array()
    faces = scan.corners.resolved(len(positions), len(normals))
    warnings = scan.warnings()
    if not len(faces.counts):
        return empty(f"holds {len(positions)} vertices and no faces: 0 triangles", *warnings)
    starts, names = scan.geometries(faces.counts)
    position_of, normal_of = faces.positions, faces.normals
    vertex_normals: npt.NDArray[np.float32] | None = None
    if (normal_of != NO_NORMAL).any():
        position_of, positions, vertex_normals = _with_normals(positions, normals, position_of, normal_of)
    triangles = fans(position_of, faces.counts)
    return Parts(positions, triangles, vertex_normals, starts, names, warnings, untyped=True)


def plain_text(data: Content) -> bytes:
    """Bytes of an ASCII superset without byte-order mark and with continued lines joined."""
    text = data[:]
    if text[:2] in (b"\xff\xfe", b"\xfe\xff"):
        try:
            text = text.decode("utf-16").encode()
        except UnicodeDecodeError as error:
            raise MeshError(
                f"is not the UTF-16 its first bytes promise ({error.reason}); save it as UTF-8"
            ) from error
    text = text.removeprefix(b"\xef\xbb\xbf")
    if b"\\" in text:
        text = text.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ")
    return text


class Rows:
    """Rows of numbers, turned from words into an array now and then."""

    def __init__(self, what: str, width: int = 3) -> None:
        self.width = width
        self.words: list[bytes] = []
        self.done: list[npt.NDArray[np.float64]] = []
        self.what = what
        self.count = 0

    def flush(self) -> None:
        """Turn the words into numbers."""
        if self.words:
            self.done.append(
                float_tokens(b" ".join(self.words), f"OBJ {self.what}", len(self.words)).reshape(
                    -1, self.width
                )
            )
            self.words.clear()

    def array(self) -> npt.NDArray[np.float64]:
        """(N, width) of all rows."""
        self.flush()
        return np.concatenate(self.done) if self.done else np.zeros((0, self.width), np.float64)


class Scan:
    """The statements of a file that make geometry."""

    def __init__(self) -> None:
        self.positions = Rows("vertex coordinates")
        self.normals = Rows("vertex normals")
        self.corners = Corners()
        self.runs: list[tuple[int, str]] = []
        self.left_out: dict[str, int] = {}
        self.group = b""
        self.material = b""
        self.known = False
        # texture coordinates read so far, where somebody reads them
        self.coordinates = 0

    def read(self, text: bytes) -> None:
        """Take in all lines."""
        positions, normals, corners = self.positions, self.normals, self.corners
        for number, line in enumerate(text.splitlines(), 1):
            words = line.split()
            if not words:
                continue
            key = words[0]
            if key == b"v" or key == b"vn":
                rows = positions if key == b"v" else normals
                if len(words) < 4:
                    raise MeshError(f"OBJ line {number} has no three numbers: {line[:60]!r}; correct it")
                rows.words += words[1:4]
                rows.count += 1
                if len(rows.words) > FLUSH:
                    rows.flush()
            elif key == b"f":
                if b"#" in line:
                    words = line.split(b"#", 1)[0].split()
                if len(words) < 4:
                    self._leave_out("faces with fewer than 3 corners")
                else:
                    corners.add(words[1:], number, positions.count, normals.count, self.coordinates)
            elif not key.startswith(b"#"):
                self.other(key, words, line, number)
        if not self.known and not positions.count and not corners.count:
            raise MeshError("holds no OBJ statement; it is no OBJ file or has no geometry")

    def other(self, key: bytes, words: list[bytes], line: bytes, number: int) -> None:
        """Take in a statement that is neither vertex, normal nor face."""
        if key in (b"o", b"g", b"usemtl"):
            self.begin(key, b" ".join(words[1:]))
        elif key in LEFT_OUT:
            self._leave_out(LEFT_OUT[key])
        elif key not in IGNORED:
            self._leave_out("unknown statements")
            return
        self.known = True

    def _leave_out(self, what: str) -> None:
        self.left_out[what] = self.left_out.get(what, 0) + 1

    def begin(self, key: bytes, name: bytes) -> None:
        """Begin a new geometry with the next face, unless nothing changed."""
        before = (self.group, self.material)
        if key == b"usemtl":
            self.material = name
        else:
            self.group = name
        if (self.group, self.material) != before:
            label = (self.group or self.material).decode("utf-8", "replace")
            if self.runs and self.runs[-1][0] == self.corners.count:
                self.runs.pop()
            self.runs.append((self.corners.count, label))

    def warnings(self) -> tuple[str, ...]:
        """One line for each kind of statement that was left out."""
        return tuple(f"left out: {what} ({count})" for what, count in self.left_out.items())

    def geometries(self, counts: npt.NDArray[np.int64]) -> tuple[npt.NDArray[np.int64], tuple[str, ...]]:
        """First triangle of each geometry and their names, from the polygons at which they begin."""
        runs = [run for run in self.runs if run[0] < len(counts)]
        if not runs or runs[0][0] > 0:
            runs.insert(0, (0, ""))
        before = np.concatenate([[0], np.cumsum(counts - 2)])
        starts = before[[run[0] for run in runs] + [len(counts)]].astype(np.int64)
        return starts, tuple(run[1] for run in runs)


def _with_normals(
    positions: npt.NDArray[np.float64],
    normals: npt.NDArray[np.float64],
    position_of: npt.NDArray[np.int64],
    normal_of: npt.NDArray[np.int64],
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64], npt.NDArray[np.float32]]:
    """One normal a vertex: vertices as they are if each has only one, else a copy for each normal."""
    with np.errstate(over="ignore"):
        # the last row stands for NO_NORMAL, which is -1
        rows = np.concatenate([normals, np.zeros((1, 3))]).astype(np.float32)
    chosen = np.full(len(positions), NO_NORMAL, np.int64)
    chosen[position_of] = normal_of
    if np.array_equal(chosen[position_of], normal_of):
        return position_of, positions, rows[chosen]
    pairs, corner = np.unique(position_of * len(rows) + (normal_of + 1), return_inverse=True)
    split_positions, split_normals = np.divmod(pairs, len(rows))
    return corner.reshape(-1), positions[split_positions], rows[split_normals - 1]
