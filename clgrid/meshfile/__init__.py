"""Mesh files: which reader reads which, and the one place where their failures become a `MeshError`."""

from __future__ import annotations

import importlib
from pathlib import Path

import numpy as np

from clgrid.errors import MeshError
from clgrid.mesh import MAX_COUNT, Mesh
from clgrid.meshfile.content import content
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
    ``double`` float64 unless all values fit float32 exactly. Text without a type (OBJ, OFF, ascii STL) is parsed
    as float64 and kept so only where rounding would cost shape (`clgrid.meshfile.numbers.narrowed_text`), as are
    the transformed vertices of glTF.

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
    try:
        parts = _parse(path)
        faces = _narrow_indices(parts)
    except MeshError as error:
        raise MeshError(one_line(f"{path}: {error}")) from error
    except MemoryError as error:
        raise MeshError(one_line(f"{path}: needs more memory than there is; use a smaller mesh")) from error
    except Exception as error:  # whatever a parser trips over is an error of the file, said in one line
        reason = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        raise MeshError(one_line(f"{path}: cannot be read ({reason}); repair or re-export it")) from error
    starts = parts.geometry_starts
    warnings = parts.warnings
    if not len(faces) and not warnings:
        warnings = ("holds no triangles",)
    return Mesh(
        vertices=np.ascontiguousarray(parts.vertices),
        faces=faces,
        vertex_normals=parts.vertex_normals,
        geometry_starts=np.array([0, len(faces)], np.int64) if starts is None else starts,
        geometry_names=tuple(one_line(name) for name in parts.geometry_names),
        source=one_line(str(path)),
        warnings=tuple(one_line(f"{path}: {warning}") for warning in warnings),
    )


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


def _narrow_indices(parts: Parts) -> np.ndarray[tuple[int, ...], np.dtype[np.uint32]]:
    """Faces as uint32, refused where that would change an index."""
    faces = parts.faces
    for name, array in (("triangles", faces), ("vertices", parts.vertices)):
        if len(array) > MAX_COUNT:
            raise MeshError(f"holds {len(array)} {name}, at most {MAX_COUNT} fit; split the mesh")
    if faces.dtype != np.uint32 and len(faces):
        low, high = int(faces.min()), int(faces.max())
        if low < 0 or high > MAX_COUNT:
            bad = np.flatnonzero(((faces < 0) | (faces > MAX_COUNT)).any(axis=1))
            raise MeshError(
                f"{len(bad)} triangles name a missing vertex, first triangle {bad[0]}: "
                f"vertex {low if low < 0 else high} of {len(parts.vertices)}; repair or re-export the mesh"
            )
    if faces.dtype.itemsize == 4 and faces.dtype.isnative:
        return np.ascontiguousarray(faces).view(np.uint32)
    return np.ascontiguousarray(faces, np.uint32)
