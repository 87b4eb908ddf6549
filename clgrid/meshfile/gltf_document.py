"""A glTF or GLB file taken apart: the decoded JSON and its binary chunk, both checked."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import msgspec

from clgrid.errors import MeshError
from clgrid.meshfile import file_format
from clgrid.meshfile.content import Content
from clgrid.meshfile.gltf_schema import Gltf

MAGIC = b"glTF"
UNREADABLE = frozenset(
    {
        "KHR_draco_mesh_compression",
        "EXT_meshopt_compression",
        "KHR_meshopt_compression",
        "EXT_mesh_gpu_instancing",
    }
)
"""Extensions without which the geometry would be wrong or missing."""


@dataclass(frozen=True)
class Document:
    """One file.

    Attributes
    ----------
    gltf : Gltf
        The decoded JSON; indices in it are not negative, but may name what is not there.
    chunk : memoryview or None
        Binary chunk of a GLB.
    path : Path
        Of the file: other files are named relative to it.
    """

    gltf: Gltf
    chunk: memoryview | None
    path: Path


def open_document(data: Content, path: Path) -> Document:
    """Decode a file.

    Raises
    ------
    MeshError
        If the container is damaged, the JSON malformed or of wrong types, the version not 2, or an extension
        required that holds geometry and is not read.
    """
    text: bytes | memoryview
    if data[:4] == MAGIC:
        text, chunk = _chunks(data)
    elif file_format(path) == ".glb":
        raise MeshError(f"is no GLB file: it begins with {data[:4]!r} and not with {MAGIC!r}")
    else:
        text, chunk = data[:].removeprefix(b"\xef\xbb\xbf"), None
    try:
        gltf = msgspec.json.decode(text, type=Gltf)
    except msgspec.ValidationError as error:
        raise MeshError(f"glTF has a member of the wrong type: {error}; repair the file") from error
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise MeshError(f"glTF is not valid JSON: {error}; repair the file") from error
    if not gltf.asset.version.startswith("2."):
        raise MeshError(f"is glTF version {gltf.asset.version[:20]!r}; convert it to version 2.0")
    blocked = sorted(UNREADABLE.intersection(gltf.extensions_required))
    if blocked:
        raise MeshError(f"needs the glTF extension {blocked[0]}, which is not read; export it without")
    return Document(gltf, chunk, path)


def _chunks(data: Content) -> tuple[memoryview, memoryview | None]:
    """JSON text and binary chunk of a GLB whose lengths all fit."""
    if len(data) < 20:
        raise MeshError(f"GLB header is incomplete ({len(data)} bytes); the file is truncated")
    version, length = _uint32(data, 4), _uint32(data, 8)
    if version != 2:
        raise MeshError(f"is GLB version {version}; convert it to version 2")
    if length != len(data):
        raise MeshError(f"GLB header announces {length} bytes and the file has {len(data)}; export it again")
    view = memoryview(data)
    chunks: dict[bytes, memoryview] = {}
    offset = 12
    first = True
    while offset < length:
        size = _uint32(data, offset) if offset + 8 <= length else length
        if offset + 8 + size > length:
            raise MeshError(
                f"GLB chunk at byte {offset} does not fit in the file; it is truncated: export it again"
            )
        kind = data[offset + 4 : offset + 8]
        if first and kind != b"JSON":
            raise MeshError(f"GLB begins with a chunk of type {kind!r} and not with JSON; export it again")
        chunks.setdefault(kind, view[offset + 8 : offset + 8 + size])
        offset += 8 + size
        first = False
    return chunks[b"JSON"], chunks.get(b"BIN\0")


def _uint32(data: Content, offset: int) -> int:
    return int.from_bytes(data[offset : offset + 4], "little")
