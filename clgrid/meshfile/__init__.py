"""Mesh files: which reader reads which, and the one place where their failures become a `MeshError`."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import numpy.typing as npt

from clgrid.errors import MeshError
from clgrid.mesh import MAX_COUNT, Mesh
from clgrid.meshfile.content import content
from clgrid.meshfile.numbers import narrowed_text
from clgrid.meshfile.parts import Parts

READERS = {
    ".ply": "ply",
    ".obj": "obj",
    ".stl": "stl",
    ".off": "off",
    ".glb": "gltf",
    ".gltf": "gltf",
}
"""Suffix of the file (before ``.gz``) and the module here whose ``parse(content, path)`` reads it."""


def read(path: Path) -> Mesh:
    """Read a mesh file; the suffix names the format, ``.gz`` after it a gzipped one.

    Numbers keep the type the file gives them. A PLY property decides for itself: ``float`` gives float32,
    ``double`` float64 unless all values fit float32 exactly. Text without a type (OBJ, OFF, ascii STL) is
    parsed as float64 and kept so only where rounding would cost shape: where the mesh is farther from the
    origin than 16 times its size (`clgrid.meshfile.numbers.narrowed_text`). The same goes for the vertices
    that glTF nodes move.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    Mesh
        Triangles in the order of the file; polygons as fans; nothing merged, nothing dropped but what
        `Mesh.warnings` names.

    Raises
    ------
    MeshError
        Whatever is wrong with the file, in one line that begins with its path.
    """
    with named_errors(path):
        parts = _parse(path)
        faces = _narrow_indices(parts)
        vertices = parts.vertices
        if parts.untyped and vertices.dtype == np.float64:
            vertices = narrowed_text(vertices.astype(np.float64, copy=False), faces)
        normals, warnings = _usable_normals(parts)
        if not len(faces) and not warnings:
            warnings = ("holds no triangles",)
        starts = parts.geometry_starts
        return Mesh(
            vertices=vertices,
            faces=faces,
            vertex_normals=normals,
            geometry_starts=np.array([0, len(faces)], np.int64) if starts is None else starts,
            geometry_names=tuple(one_line(name) for name in parts.geometry_names),
            source=one_line(str(path)),
            warnings=tuple(one_line(f"{path}: {warning}") for warning in warnings),
        )


@contextmanager
def named_errors(path: Path) -> Iterator[None]:
    """Turn every failure inside into a one-line `MeshError` that begins with the path."""
    try:
        yield
    except MeshError as error:
        message = one_line(str(error))
        prefix = one_line(f"{path}: ")
        raise MeshError(message if message.startswith(prefix) else prefix + message) from error
    except MemoryError as error:
        raise MeshError(one_line(f"{path}: needs more memory than there is; use a smaller mesh")) from error
    except Exception as error:  # whatever a parser trips over is an error of the file, said in one line
        reason = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        raise MeshError(one_line(f"{path}: cannot be read ({reason}); repair or re-export it")) from error


def file_format(path: Path) -> str:
    """Suffix that names the format of a file, without a final ``.gz``, in lower case.

    Raises
    ------
    MeshError
        If no reader knows it.
    """
    name = path.with_suffix("") if path.suffix.lower() == ".gz" else path
    suffix = name.suffix.lower()
    if suffix not in READERS:
        known = ", ".join(READERS)
        raise MeshError(f"has the suffix {suffix!r}; give one of {known}, each also with .gz")
    return suffix


def one_line(text: str) -> str:
    """Escape whatever would break a message into lines or garble a terminal, and cap its length."""
    clean = "".join(char if char.isprintable() else char.encode("unicode_escape").decode() for char in text)
    return clean if len(clean) <= 600 else clean[:600] + "..."


def _parse(path: Path) -> Parts:
    module = importlib.import_module(f"clgrid.meshfile.{READERS[file_format(path)]}")
    parts: Parts = module.parse(content(path), path)
    return parts


def _narrow_indices(parts: Parts) -> npt.NDArray[np.uint32]:
    """Faces as uint32, all below the number of vertices."""
    faces, count = parts.faces, len(parts.vertices)
    for name, rows in (("triangles", len(faces)), ("vertices", count)):
        if rows > MAX_COUNT:
            raise MeshError(f"holds {rows} {name}, at most {MAX_COUNT} fit; split the mesh")
    if len(faces) and (int(faces.min()) < 0 or int(faces.max()) >= count):
        outside: npt.NDArray[np.bool_] = np.logical_or(faces < 0, faces >= count)
        bad = np.flatnonzero(outside.any(axis=1))
        raise MeshError(
            f"{len(bad)} of {len(faces)} triangles name a missing vertex, first triangle {bad[0]}: "
            f"vertex {faces[bad[0]][outside[bad[0]]][0]} of {count}; repair or re-export the mesh"
        )
    if faces.dtype.itemsize == 4 and faces.dtype.isnative:
        return np.ascontiguousarray(faces).view(np.uint32)
    return np.ascontiguousarray(faces, np.uint32)


def _usable_normals(parts: Parts) -> tuple[npt.NDArray[np.float32] | None, tuple[str, ...]]:
    """Normals with those that are not finite set to zero, which means none; and the warnings with that."""
    normals = parts.vertex_normals
    if normals is None or not normals.size or np.isfinite([normals.min(), normals.max()]).all():
        return normals, parts.warnings
    bad: npt.NDArray[np.bool_] = np.logical_not(np.isfinite(normals).all(axis=1))
    warning = f"left out: vertex normals that are NaN or infinite ({int(bad.sum())})"
    return np.where(bad[:, None], np.float32(0), normals), (*parts.warnings, warning)
