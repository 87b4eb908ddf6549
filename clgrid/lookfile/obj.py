"""The look of OBJ files: materials by ``usemtl``, texture coordinates with indices of their own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from clgrid.look import Look, Material
from clgrid.lookfile import require_same
from clgrid.lookfile.mtl import Statement, material_of, read_statements
from clgrid.lookfile.names import find_beside
from clgrid.lookfile.shelf import Shelf
from clgrid.mesh import Mesh
from clgrid.meshfile.content import Content
from clgrid.meshfile.obj import Rows, Scan, plain_text
from clgrid.meshfile.polygons import fans


def read(data: Content, path: Path, mesh: Mesh) -> Look | None:
    """Read the look of the file that `clgrid.meshfile.obj` makes a mesh of.

    Materials have two sides. A missing material file is a warning, its materials are white.

    Raises
    ------
    MeshError
        If the file is malformed, or holds another mesh by now.
    """
    scan = _LookScan()
    scan.read(plain_text(data))
    faces = scan.corners.resolved(scan.positions.count, scan.normals.count)
    triangles = np.maximum(faces.counts - 2, 0)
    require_same(mesh, len(mesh.vertices), int(triangles.sum()))
    shelf = Shelf(path)
    statements = _statements(scan.libraries, path.parent, shelf)
    names, numbers = scan.materials(len(faces.counts))
    materials = [_material(name, statements, path.parent, shelf) for name in names]
    uvs: list[npt.NDArray[np.float32]] = []
    uv_faces: list[npt.NDArray[np.uint32] | None] = []
    if any(material.base_texture or material.emissive_texture for material in materials):
        uv, of_corners = _coordinates(scan, faces.counts, shelf)
        shared = len(uv) == len(mesh.vertices) and np.array_equal(of_corners, mesh.faces)
        uvs, uv_faces = [uv], [None if shared else of_corners]
    if all(material == Material(name=material.name) for material in materials) and not shelf.has_warnings:
        return None
    return shelf.look(materials or [Material()], np.repeat(numbers, triangles), uvs, uv_faces, None)


class _LookScan(Scan):
    """What else a look needs of the statements."""

    def __init__(self) -> None:
        super().__init__()
        self.uv = Rows("texture coordinates", 2)
        self.libraries: list[str] = []
        self._uses: list[tuple[int, str]] = []

    def other(self, key: bytes, words: list[bytes], line: bytes, number: int) -> None:
        """Keep texture coordinates, names of material files, and which face begins which material."""
        super().other(key, words, line, number)
        if key == b"vt":
            # v may be left out, what follows it is for volumes
            pair = words[1:3] if len(words) > 2 else [*words[1:2], b"0", b"0"][:2]
            self.uv.words += pair if _are_numbers(pair) else [b"nan", b"nan"]
            self.uv.count += 1
            self.coordinates = self.uv.count
        elif key == b"mtllib":
            self.libraries.append(b" ".join(words[1:]).decode("utf-8", "replace"))
        elif key == b"usemtl":
            self._uses.append((self.corners.count, b" ".join(words[1:]).decode("utf-8", "replace")))

    def materials(self, polygons: int) -> tuple[list[str], npt.NDArray[np.int64]]:
        """Names of the materials that faces have, in the order of their first face, and which each has."""
        uses = [(0, ""), *self._uses]
        ends = [*(begin for begin, _ in uses[1:]), polygons]
        numbers = np.zeros(polygons, np.int64)
        known: dict[str, int] = {}
        for (begin, name), end in zip(uses, ends, strict=True):
            if end > begin:
                numbers[begin:end] = known.setdefault(name, len(known))
        return list(known), numbers


def _are_numbers(words: list[bytes]) -> bool:
    try:
        return all(float(word) == float(word) and b"_" not in word for word in words)
    except ValueError:
        return False


def _statements(libraries: list[str], folder: Path, shelf: Shelf) -> dict[str, Statement]:
    """Materials of all files named; a line names one file with spaces in its name, or several."""
    found: dict[str, Statement] = {}
    for line in dict.fromkeys(libraries):
        whole = find_beside(folder, line)
        for name in [line] if whole is not None else line.split():
            path = find_beside(folder, name)
            if path is None:
                shelf.warn(f"material file {name!r} is missing")
            else:
                found = {**read_statements(path, shelf), **found}
    return found


def _material(name: str, statements: dict[str, Statement], folder: Path, shelf: Shelf) -> Material:
    if name in statements:
        return material_of(statements[name], folder, shelf)
    if name and statements:
        shelf.warn(f"material {name[:60]!r} is in no material file, drawn white")
    return Material(name=name)


def _coordinates(
    scan: _LookScan, counts: npt.NDArray[np.int64], shelf: Shelf
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.uint32]]:
    """(U, 2) from the top left corner, and the rows of each triangle's corners."""
    stored = scan.uv.array()
    of_corners, missing = scan.corners.coordinates(len(stored))
    if missing:
        shelf.warn(f"{missing} corners name missing texture coordinates, taken as 0")
    absent = bool((of_corners == len(stored)).any())
    rows = np.concatenate([stored, [[0.0, 1.0]]]) if absent else stored
    with np.errstate(over="ignore"):
        # OBJ has v upwards from the bottom, pictures begin on top
        uv = np.stack([rows[:, 0], 1.0 - rows[:, 1]], axis=1).astype(np.float32)
    return shelf.finite(uv, "texture coordinates"), fans(of_corners, counts).astype(np.uint32)
