"""How scenes look, by their files: which reader reads which; whatever fails becomes a `MeshError`."""

from __future__ import annotations

import importlib
from pathlib import Path

from clgrid.errors import MeshError
from clgrid.look import Look
from clgrid.mesh import Mesh
from clgrid.meshfile import file_format, named_errors
from clgrid.meshfile.content import content

READERS = {".ply": "ply", ".obj": "obj", ".glb": "gltf", ".gltf": "gltf"}
"""Suffix of the file (before ``.gz``) and the module here whose ``read(content, path, mesh)`` reads it."""


def read_look(path: Path, mesh: Mesh) -> Look | None:
    """Read materials, textures, colours and lights of a mesh file.

    Parameters
    ----------
    path : Path
        The file.
    mesh : Mesh
        What `clgrid.load` made of it: the look's rows are the mesh's.

    Returns
    -------
    Look or None
        None where the file says nothing of it: no textures, no colours, no lights, no material but the
        default one. `Look.warnings` says what was left out or replaced.

    Raises
    ------
    MeshError
        If the file is malformed, or holds another mesh by now, in one line that begins with its path.
    """
    with named_errors(path):
        reader = READERS.get(file_format(path))
        if reader is None:
            return None
        module = importlib.import_module(f"clgrid.lookfile.{reader}")
        look: Look | None = module.read(content(path), path, mesh)
        return look


def require_same(mesh: Mesh, vertices: int, triangles: int) -> None:
    """Refuse a file that holds another mesh than the one given.

    Raises
    ------
    MeshError
        If the numbers of vertices or triangles differ.
    """
    if (len(mesh.vertices), mesh.triangle_count) != (vertices, triangles):
        raise MeshError(
            f"holds {triangles} triangles and {vertices} vertices now, the mesh {mesh.triangle_count} and "
            f"{len(mesh.vertices)}; load it again"
        )
