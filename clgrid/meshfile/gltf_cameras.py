"""Cameras of glTF files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from clgrid.errors import MeshError
from clgrid.meshfile import file_format, named_errors
from clgrid.meshfile.content import content
from clgrid.meshfile.gltf_accessors import at
from clgrid.meshfile.gltf_document import open_document
from clgrid.meshfile.gltf_nodes import Placed, placed_nodes
from clgrid.meshfile.gltf_schema import Camera, Gltf


@dataclass(frozen=True)
class GltfCamera:
    """A camera as it stands in the scene.

    Attributes
    ----------
    name : str
        Of the node, or else of the camera; may be empty.
    matrix : (4, 4) float64
        Camera to world, for column vectors; the camera looks along its -Z with +Y up. May hold a scale.
    yfov : float or None
        Vertical field of view in radians of a perspective camera.
    ymag : float or None
        Half the height in scene units of an orthographic camera.
    aspect : float or None
        Width by height, where the file says.
    znear : float
        Distance of the near plane in scene units.
    """

    name: str
    matrix: npt.NDArray[np.float64]
    yfov: float | None
    ymag: float | None
    aspect: float | None
    znear: float


def read_cameras(path: Path) -> tuple[GltfCamera, ...]:
    """Cameras of the default scene in depth-first order; none for formats other than glTF and GLB.

    Raises
    ------
    MeshError
        If the file is malformed, in one line that begins with its path.
    """
    with named_errors(path):
        if file_format(path) not in (".gltf", ".glb"):
            return ()
        gltf = open_document(content(path), path).gltf
        return cameras_of(gltf, placed_nodes(gltf))


def cameras_of(gltf: Gltf, placed: list[Placed]) -> tuple[GltfCamera, ...]:
    """Cameras of the nodes given, in their order.

    Raises
    ------
    MeshError
        If one is missing or malformed.
    """
    return tuple(
        _camera(each, at(gltf.cameras, each.node.camera, "camera", f"node {each.number}"))
        for each in placed
        if each.node.camera is not None
    )


def _camera(placed: Placed, camera: Camera) -> GltfCamera:
    name = placed.node.name or camera.name
    if camera.type == "perspective" and camera.perspective is not None:
        lens = camera.perspective
        return GltfCamera(name, placed.world, lens.yfov, None, lens.aspect_ratio, lens.znear)
    if camera.type == "orthographic" and camera.orthographic is not None:
        box = camera.orthographic
        aspect = abs(box.xmag / box.ymag) if box.ymag else None
        return GltfCamera(name, placed.world, None, box.ymag, aspect, box.znear)
    raise MeshError(f"glTF camera {name!r} is of type {camera.type[:20]!r} without its lens; repair the file")
