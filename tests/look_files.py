"""Small glTF scenes with a look, and the texel that a triangle's point shows."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from gltf_files import GltfFile
from pictures import CORNERS, png

from clgrid.animation import Frames
from clgrid.look import Look
from clgrid.lookfile import read_look
from clgrid.mesh import Mesh, load
from clgrid.scene import Scene, load_scene

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
SQUARE_FACES = np.array([0, 1, 2, 0, 2, 3], np.uint16)
# from the top left corner: the vertex at (0, 1) is on top
SQUARE_UV = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32)


def data_uri(data: bytes) -> str:
    return "data:image/png;base64," + base64.b64encode(data).decode()


def square(material: dict[str, Any] | None = None, *nodes: dict[str, Any], **attributes: Any) -> GltfFile:
    """A square from (0, 0) to (1, 1) with TEXCOORD_0 and more attributes, drawn by the nodes given."""
    file = GltfFile()
    named = {"POSITION": SQUARE, "TEXCOORD_0": SQUARE_UV, **attributes}
    numbers = {
        name: file.accessor(array) if isinstance(array, np.ndarray) else file.accessor(array[0], **array[1])
        for name, array in named.items()
        if array is not None
    }
    primitive: dict[str, Any] = {"attributes": numbers, "indices": file.accessor(SQUARE_FACES)}
    if material is not None:
        file.json["materials"] = [material]
        primitive["material"] = 0
    file.mesh(primitive)
    file.nodes(*(nodes or ({"mesh": 0},)))
    return file


def textured(file: GltfFile, *uris: str, samplers: list[dict[str, int]] | None = None) -> GltfFile:
    """Add images and a texture for each, all with sampler 0 if there are samplers."""
    file.json["images"] = [{"uri": uri} for uri in uris or (data_uri(png(CORNERS)),)]
    file.json["textures"] = [{"source": k} for k in range(len(file.json["images"]))]
    if samplers:
        file.json["samplers"] = samplers
        for texture in file.json["textures"]:
            texture["sampler"] = 0
    return file


BASE = {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}


def both(path: Path) -> tuple[Mesh, Look]:
    """The mesh and the look of a file that must have one."""
    mesh = load(path)
    look = read_look(path, mesh)
    assert look is not None
    check_shapes(mesh, look)
    return mesh, look


def check_shapes(mesh: Mesh, look: Look) -> None:
    """All that the docstring of Look promises of shapes, types and numbers."""
    assert look.materials
    assert look.material_ids.shape == (mesh.triangle_count,)
    assert look.material_ids.dtype in (np.uint16, np.uint32)
    if mesh.triangle_count:
        assert int(look.material_ids.max()) < len(look.materials)
    assert len(look.uvs) == len(look.uv_faces)
    for uv, faces in zip(look.uvs, look.uv_faces, strict=True):
        assert uv.dtype == np.float32
        assert np.isfinite(uv).all()
        if faces is None:
            assert uv.shape == (len(mesh.vertices), 2)
        else:
            assert faces.shape == mesh.faces.shape
            assert faces.dtype == np.uint32
            assert not faces.size or int(faces.max()) < len(uv)
    if look.colours is not None:
        assert look.colours.shape == (len(mesh.vertices), 4)
        assert look.colours.dtype == np.float32
        assert np.isfinite(look.colours).all()
        assert look.colours.min() >= 0
    for texture in look.textures:
        assert texture.pixels.dtype == np.uint8
        assert texture.pixels.ndim == 3
        assert texture.pixels.shape[2] == 4
    for material in look.materials:
        for use in (material.base_texture, material.emissive_texture):
            if use is not None:
                assert 0 <= use.texture < len(look.textures)
                assert 0 <= use.uv_set < len(look.uvs)
                assert use.transform is None or use.transform.shape == (2, 3)
    for line in look.warnings:
        assert "\n" not in line


def texel(mesh: Mesh, look: Look, face: int, weights: npt.ArrayLike = (1 / 3, 1 / 3, 1 / 3)) -> list[int]:
    """Texel of the base texture at a point of a triangle, by the nearest one, repeated."""
    use = look.materials[look.material_ids[face]].base_texture
    assert use is not None
    rows = look.uv_faces[use.uv_set]
    corners = (mesh.faces if rows is None else rows)[face]
    u, v = np.asarray(weights, np.float64) @ look.uvs[use.uv_set][corners].astype(np.float64)
    if use.transform is not None:
        u, v = use.transform @ [u, v, 1]
    pixels = look.textures[use.texture].pixels
    height, width = pixels.shape[:2]
    found: list[int] = pixels[int(np.floor(v * height)) % height, int(np.floor(u * width)) % width].tolist()
    return found


def animate(file: GltfFile, *channels: Any, name: str = "", **members: Any) -> GltfFile:
    """Add an animation of (node, path, times, values, interpolation)."""
    animation: dict[str, Any] = {"name": name, "channels": [], "samplers": [], **members}
    for node, path, times, values, interpolation in channels:
        animation["samplers"].append(
            {
                "input": file.accessor(np.array(times, np.float32)),
                "output": file.accessor(np.array(values, np.float32)),
                "interpolation": interpolation,
            }
        )
        sampler = len(animation["samplers"]) - 1
        animation["channels"].append({"sampler": sampler, "target": {"node": node, "path": path}})
    file.json.setdefault("animations", []).append(animation)
    return file


def frames_of(file: GltfFile, path: Path, **options: Any) -> tuple[Scene, Frames]:
    """The scene of a file that moves, and its frames."""
    scene = load_scene(file.write_glb(path), **options)
    assert scene.frames is not None
    return scene, scene.frames
