"""Compact uniform grids for ray tracing on OpenCL devices, with answers you can trust.

``mesh = clgrid.load(path)``, ``grid = clgrid.build(mesh)``, ``hits = grid.cast(origins, directions)``,
``image = clgrid.render(mesh)``. Names are imported at first use, so that ``import clgrid`` costs nothing.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from clgrid import open3d as open3d
    from clgrid import trimesh as trimesh
    from clgrid.brute import brute_force
    from clgrid.camera import Camera
    from clgrid.device import Device
    from clgrid.device import describe_all as devices
    from clgrid.errors import (
        ClgridError,
        DeviceError,
        GridFileError,
        GridTooLargeError,
        ImageError,
        InputError,
        MeshError,
        UnsupportedError,
    )
    from clgrid.grid import Grid, build
    from clgrid.hits import AllHits, Hits
    from clgrid.image import Image, read_image
    from clgrid.mesh import Mesh, load
    from clgrid.prediction import predict
    from clgrid.renderer import render, warm_up
    from clgrid.saved import open_grid
    from clgrid.scene import Scene, default_camera, load_scene

__version__ = "0.1.0"

__all__ = [
    "AllHits",
    "Camera",
    "ClgridError",
    "Device",
    "DeviceError",
    "Grid",
    "GridFileError",
    "GridTooLargeError",
    "Hits",
    "Image",
    "ImageError",
    "InputError",
    "Mesh",
    "MeshError",
    "Scene",
    "UnsupportedError",
    "__version__",
    "brute_force",
    "build",
    "default_camera",
    "devices",
    "load",
    "load_scene",
    "open_grid",
    "predict",
    "read_image",
    "render",
    "warm_up",
]

# Where each public name lives, and under which name.
_HOMES = {
    "Camera": ("camera", "Camera"),
    "Device": ("device", "Device"),
    "Grid": ("grid", "Grid"),
    "AllHits": ("hits", "AllHits"),
    "Hits": ("hits", "Hits"),
    "Image": ("image", "Image"),
    "Mesh": ("mesh", "Mesh"),
    "Scene": ("scene", "Scene"),
    "brute_force": ("brute", "brute_force"),
    "build": ("grid", "build"),
    "default_camera": ("scene", "default_camera"),
    "devices": ("device", "describe_all"),
    "load": ("mesh", "load"),
    "load_scene": ("scene", "load_scene"),
    "open_grid": ("saved", "open_grid"),
    "predict": ("prediction", "predict"),
    "read_image": ("image", "read_image"),
    "render": ("renderer", "render"),
    "warm_up": ("renderer", "warm_up"),
    **{
        name: ("errors", name)
        for name in (
            "ClgridError",
            "DeviceError",
            "GridFileError",
            "GridTooLargeError",
            "ImageError",
            "InputError",
            "MeshError",
            "UnsupportedError",
        )
    },
}


# Modules that are public by themselves.
_MODULES = ("open3d", "trimesh")


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return importlib.import_module(f"clgrid.{name}")
    if name not in _HOMES:
        raise AttributeError(f"module 'clgrid' has no attribute {name!r}")
    module, attribute = _HOMES[name]
    value = getattr(importlib.import_module(f"clgrid.{module}"), attribute)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, *_MODULES})
