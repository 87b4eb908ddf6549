"""What the examples share: their command line, a colour map, points as dots, pictures."""

from __future__ import annotations

import argparse

import numpy as np
import numpy.typing as npt

import clgrid

Floats = npt.NDArray[np.floating]

# Viridis at equal steps, 8-bit sRGB.
_VIRIDIS = ((68, 1, 84), (59, 82, 139), (33, 145, 140), (94, 201, 98), (253, 231, 37))


def parser(text: str, scene: str, size: int = 512) -> argparse.ArgumentParser:
    """The command line: ``[SCENE] -o picture.png [--size N]``."""
    arguments = argparse.ArgumentParser(description=text.strip().splitlines()[0])
    arguments.add_argument("scene", nargs="?", default=scene, help="a mesh file or a built-in scene")
    arguments.add_argument("-o", "--output", required=True, help="the picture, .png or .exr")
    arguments.add_argument("--size", type=int, default=size, help="width of the picture in pixels")
    return arguments


def part(mesh: clgrid.Mesh, name: str | None) -> clgrid.Mesh:
    """The geometry of that name alone, or the whole mesh."""
    if name is None:
        return mesh
    which = mesh.geometry_names.index(name)
    first, last = mesh.geometry_starts[which : which + 2]
    return clgrid.Mesh(mesh.vertices, mesh.faces[first:last], source=f"{name} of {mesh.source}")


def colours(values: Floats, low: float, high: float) -> Floats:
    """(..., 3) linear colours, from dark blue at ``low`` to yellow at ``high``."""
    steps = np.linspace(low, high, len(_VIRIDIS))
    anchors = (np.array(_VIRIDIS) / 255).T
    srgb = np.stack([np.interp(values, steps, anchor) for anchor in anchors], -1)
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def dots(points: Floats, colour: Floats, camera: clgrid.Camera, side: int) -> Floats:
    """(side, side, 3) picture of points as dots of 2 x 2 pixels, near ones over far ones."""
    matrix = camera.world_to_camera()
    x, y, z = matrix[:3, :3] @ points.T + matrix[:3, 3:]
    scale = 0.5 * side / np.tan(np.radians(camera.fov) / 2)
    picture = np.full((side, side, 3), 0.9)
    far_first = np.argsort(-z)
    for right, down in np.ndindex(2, 2):
        column = np.floor(0.5 * side + scale * x / z).astype(int) + right
        row = np.floor(0.5 * side - scale * y / z).astype(int) + down
        seen = far_first[((column >= 0) & (column < side) & (row >= 0) & (row < side) & (z > 0))[far_first]]
        picture[row[seen], column[seen]] = colour[seen]
    return picture


def save(path: str, rgb: Floats) -> None:
    """Write linear (h, w, 3) colours."""
    rgba = np.ones((*rgb.shape[:2], 4), np.float32)
    rgba[..., :3] = rgb
    clgrid.Image(rgba).save(path)
