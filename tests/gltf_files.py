"""Small glTF and GLB files, put together from arrays."""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from clgrid.errors import MeshError
from clgrid.mesh import Mesh, load
from clgrid.meshfile.gltf_cameras import read_cameras

COMPONENTS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


class GltfFile:
    """A document in the making: arrays become accessors of one buffer."""

    def __init__(self) -> None:
        self.data = b""
        self.json: dict[str, Any] = {"asset": {"version": "2.0"}, "accessors": [], "bufferViews": []}

    def accessor(self, array: npt.NDArray[Any], **members: Any) -> int:
        """Append an array; returns the number of its accessor."""
        rows = array.reshape(len(array), -1)
        self.data += b"\0" * (-len(self.data) % 4)
        view = {"buffer": 0, "byteOffset": len(self.data), "byteLength": rows.nbytes}
        self.data += rows.tobytes()
        self.json["bufferViews"].append(view)
        self.json["accessors"].append(
            {
                "bufferView": len(self.json["bufferViews"]) - 1,
                "componentType": COMPONENTS[array.dtype.str[1:]],
                "count": len(array),
                "type": TYPES[rows.shape[1]],
                **members,
            }
        )
        return len(self.json["accessors"]) - 1

    def mesh(self, *primitives: dict[str, Any], **members: Any) -> int:
        """Append a mesh; returns its number."""
        self.json.setdefault("meshes", []).append({"primitives": list(primitives), **members})
        return len(self.json["meshes"]) - 1

    def nodes(self, *nodes: dict[str, Any], roots: list[int] | None = None) -> None:
        """Set the nodes and a scene of ``roots``, by default all."""
        self.json["nodes"] = list(nodes)
        self.json["scenes"] = [{"nodes": list(range(len(nodes))) if roots is None else roots}]
        self.json["scene"] = 0

    def write_glb(self, path: Path) -> Path:
        self.json["buffers"] = [{"byteLength": len(self.data)}]
        text = json.dumps(self.json).encode()
        text += b" " * (-len(text) % 4)
        data = self.data + b"\0" * (-len(self.data) % 4)
        chunks = (
            struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
        )
        path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
        return path

    def write_gltf(self, path: Path, uri: str | None = None) -> Path:
        """Write JSON with the buffer inside, or beside it where ``uri`` names a file."""
        if uri is None:
            uri = "data:application/octet-stream;base64," + base64.b64encode(self.data).decode()
        else:
            (path.parent / uri.replace("%20", " ")).write_bytes(self.data)
        self.json["buffers"] = [{"byteLength": len(self.data), "uri": uri}]
        path.write_text(json.dumps(self.json))
        return path


TETRAHEDRON = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float32)
TETRAHEDRON_FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.uint16)
TETRAHEDRON_NORMALS = np.array([[-1, -1, -1], [2, -1, -1], [-1, 2, -1], [-1, -1, 2]], np.float32)


def tetrahedron(*nodes: dict[str, Any], normals: bool = True, roots: list[int] | None = None) -> GltfFile:
    """One tetrahedron as mesh 0, closed and facing outwards, drawn by the given nodes."""
    file = GltfFile()
    attributes = {"POSITION": file.accessor(TETRAHEDRON)}
    if normals:
        attributes["NORMAL"] = file.accessor(TETRAHEDRON_NORMALS)
    indices = file.accessor(TETRAHEDRON_FACES.reshape(-1))
    file.mesh({"attributes": attributes, "indices": indices}, name="tetrahedron")
    file.nodes(*(nodes or ({"mesh": 0},)), roots=roots)
    return file


def refused(path: Path) -> str:
    """Message of the one-line error that the file must cause."""
    with pytest.raises(MeshError) as caught:
        load(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    assert "cannot be read" not in message
    return message


def complaints(path: Path) -> list[str]:
    """Messages with which the file is refused as a mesh and as cameras; any other exception passes."""
    found = []
    for read in (load, read_cameras):
        try:
            read(path)
        except MeshError as error:
            found.append(str(error))
    return found


def corners(mesh: Mesh) -> npt.NDArray[np.floating]:
    return mesh.vertices[mesh.faces]


def volume(mesh: Mesh) -> float:
    """Signed volume: positive where a closed mesh faces outwards."""
    a, b, c = corners(mesh).astype(np.float64).transpose(1, 0, 2)
    return float((a * np.cross(b, c)).sum() / 6)


def translated(x: float, y: float, z: float) -> list[float]:
    return [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, x, y, z, 1]
