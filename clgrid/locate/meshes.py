"""Meshes in files that replay a difference: whole, or the triangles that a ray was tested against."""

from __future__ import annotations

import base64
import io
import zipfile
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from clgrid.errors import InputError
from clgrid.mesh import FloatArray, Mesh
from clgrid.repro_record import ReproMesh, hex_of

# Triangles beyond which arrays stand in the file as such, not as lists.
_MOST_LISTED = 512
_DTYPES = ("float32", "float64")


def whole_of(mesh: Mesh) -> ReproMesh:
    """The whole mesh."""
    return _record(mesh, mesh.vertices, mesh.faces, None)


def some_of(mesh: Mesh, triangles: Sequence[int]) -> ReproMesh | None:
    """Triangles of a mesh, and two at the corners of its bounds that no ray meets; None if these are all.

    Frame and planes, which follow from the bounds, stay as they are, and so does the order of the triangles.
    """
    if len(triangles) + 2 >= mesh.triangle_count:
        return None
    used, faces = np.unique(mesh.faces[list(triangles)], return_inverse=True)
    corners = mesh.bounds.astype(mesh.vertices.dtype)
    vertices = np.concatenate([mesh.vertices[used], corners])
    low, high = len(used), len(used) + 1
    every = np.concatenate([faces.reshape(-1, 3), [[low] * 3, [high] * 3]]).astype(np.uint32)
    return _record(mesh, vertices, every, [*triangles, mesh.triangle_count, mesh.triangle_count])


def _record(
    mesh: Mesh, vertices: FloatArray, faces: npt.NDArray[np.uint32], ids: list[int] | None
) -> ReproMesh:
    listed = len(faces) <= _MOST_LISTED
    rows = vertices.astype(np.float64) if listed else np.zeros((0, 3))
    return ReproMesh(
        source=mesh.source,
        dtype=str(vertices.dtype),
        whole=ids is None,
        triangles=mesh.triangle_count,
        vertices=[hex_of(row) for row in rows],
        faces=[(a, b, c) for a, b, c in faces.tolist()] if listed else [],
        triangle_ids=ids or [],
        npz="" if listed else _packed(vertices, faces),
    )


def _packed(vertices: FloatArray, faces: npt.NDArray[np.uint32]) -> str:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, vertices=vertices, faces=faces)
    return base64.b64encode(buffer.getvalue()).decode("ascii")


def mesh_of(record: ReproMesh) -> Mesh:
    """The mesh of a record.

    Raises
    ------
    InputError, MeshError
        If the record is damaged.
    """
    if record.dtype not in _DTYPES:
        raise InputError(f"mesh.dtype is {record.dtype!r}")
    if record.npz:
        vertices, faces = _unpacked(record)
    else:
        rows = [[float.fromhex(x) for x in row] for row in record.vertices]
        vertices = np.array(rows, record.dtype).reshape(-1, 3)
        faces = np.array(record.faces, np.int64).reshape(-1, 3)
    if len(faces) == 0:
        raise InputError("the mesh has no triangles")
    if record.triangle_ids and len(record.triangle_ids) != len(faces):
        raise InputError(f"{len(record.triangle_ids)} triangle_ids are not those of {len(faces)} triangles")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise InputError(f"a triangle names a vertex that is none of {len(vertices)}")
    return Mesh(vertices, faces.astype(np.uint32), source=record.source)


def _unpacked(record: ReproMesh) -> tuple[FloatArray, npt.NDArray[np.int64]]:
    try:
        with np.load(io.BytesIO(base64.b64decode(record.npz, validate=True)), allow_pickle=False) as arrays:
            vertices, faces = arrays["vertices"], arrays["faces"]
    except (ValueError, KeyError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(f"mesh.npz is no such file: {error}") from error
    if vertices.dtype != record.dtype or vertices.ndim != 2 or faces.dtype != np.uint32 or faces.ndim != 2:
        raise InputError("mesh.npz holds other arrays")
    return vertices, faces.astype(np.int64)
