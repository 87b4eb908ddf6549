"""Which other files a scene's file names: found by the very rules by which they are read."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import unquote

from clgrid.errors import MeshError
from clgrid.lookfile.mtl import read_statements
from clgrid.lookfile.names import find_beside
from clgrid.lookfile.ply import picture_name
from clgrid.lookfile.shelf import Shelf
from clgrid.meshfile import file_format, named_errors
from clgrid.meshfile.content import Content, content
from clgrid.meshfile.gltf_document import open_document
from clgrid.meshfile.ply_header import read_header

_LIBRARY = re.compile(rb"^[ \t]*mtllib[ \t]+([^\r\n]+)", re.MULTILINE)


def companions(path: Path) -> list[tuple[str, Path | None]]:
    """Files that a mesh file depends on: buffers, images, materials and their textures.

    Parameters
    ----------
    path : Path
        Of a mesh file; of one that is missing or damaged there are none.

    Returns
    -------
    list of (str, Path or None)
        Each name as it is written, once, and the file that it means; None where there is none.
    """
    try:
        with named_errors(path):
            finders = {".obj": _of_obj, ".ply": _of_ply, ".gltf": _of_gltf, ".glb": _of_gltf}
            find = finders.get(file_format(path))
            return [] if find is None else list(dict.fromkeys(find(content(path), path)))
    except MeshError:
        # What is wrong is said by whoever reads the scene.
        return []


def _of_obj(data: Content, path: Path) -> Iterator[tuple[str, Path | None]]:
    folder = path.parent
    for match in _LIBRARY.finditer(data):
        line = " ".join(match[1].decode("utf-8", "replace").split())
        whole = find_beside(folder, line)
        for name in [line] if whole is not None else line.split():
            material = find_beside(folder, name)
            yield name, material
            if material is not None:
                yield from _of_mtl(material, folder)


def _of_mtl(path: Path, folder: Path) -> Iterator[tuple[str, Path | None]]:
    for statement in read_statements(path, Shelf(path)).values():
        for use in (statement.colour_map, statement.emissive_map, statement.alpha_map):
            if use is not None:
                yield use.name, find_beside(folder, use.name)


def _of_ply(data: Content, path: Path) -> Iterator[tuple[str, Path | None]]:
    name = picture_name(read_header(data))
    if name:
        yield name, find_beside(path.parent, name)


def _of_gltf(data: Content, path: Path) -> Iterator[tuple[str, Path | None]]:
    gltf = open_document(data, path).gltf
    for buffer in gltf.buffers:
        if buffer.uri is not None and not buffer.uri.startswith("data:"):
            yield buffer.uri, path.parent / unquote(buffer.uri)
    for image in gltf.images:
        if image.uri is not None and not image.uri.startswith("data:"):
            yield image.uri, find_beside(path.parent, unquote(image.uri))
