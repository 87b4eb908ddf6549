"""Rays of a pinhole camera, as Open3D makes them: by matrices, or by a view."""

from __future__ import annotations

from dataclasses import replace
from operator import index
from typing import Any

import numpy as np
import numpy.typing as npt

from clgrid.camera import Camera
from clgrid.errors import InputError
from clgrid.foreign import on_host

Singles = npt.NDArray[np.float32]


def rays_of_matrices(intrinsic_matrix: Any, extrinsic_matrix: Any, width_px: Any, height_px: Any) -> Singles:
    """(height, width, 6) float32, by the matrices of ``RaycastingScene.create_rays_pinhole``."""
    to_pixels = _finite(intrinsic_matrix, (3, 3), "intrinsic_matrix")
    to_camera = _finite(extrinsic_matrix, (4, 4), "extrinsic_matrix")
    width, height = _size(width_px, "width_px"), _size(height_px, "height_px")
    to_scene = _inverse(to_camera[:3, :3], "extrinsic_matrix")
    right, down, corner = (to_scene @ _inverse(to_pixels, "intrinsic_matrix")).T
    x = (np.arange(width) + 0.5)[None, :, None]
    y = (np.arange(height) + 0.5)[:, None, None]
    return _joined_rays(-(to_scene @ to_camera[:3, 3]), corner + x * right + y * down)


def rays_of_view(fov_deg: Any, center: Any, eye: Any, up: Any, width_px: Any, height_px: Any) -> Singles:
    """(height, width, 6) float32, by the view of ``RaycastingScene.create_rays_pinhole``."""
    target, start, upwards = (
        _finite(values, (3,), name) for values, name in ((center, "center"), (eye, "eye"), (up, "up"))
    )
    width, height = _size(width_px, "width_px"), _size(height_px, "height_px")
    fov = float(_finite(fov_deg, (), "fov_deg"))
    camera = replace(Camera.look_at(start, target, upwards, fov), fov_axis="x")
    origins, directions = camera.rays(width, height)
    return _joined_rays(origins, directions[::-1, ::-1])


def _joined_rays(origins: npt.NDArray[np.float64], directions: npt.NDArray[np.float64]) -> Singles:
    rays = np.empty((*directions.shape[:2], 6), np.float32)
    rays[..., :3], rays[..., 3:] = origins, directions
    return rays


def _finite(values: Any, shape: tuple[int, ...], name: str) -> npt.NDArray[np.float64]:
    try:
        array = np.asarray(on_host(values), np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} is no array of numbers: {error}") from None
    if array.shape != shape or not np.isfinite(array).all():
        raise InputError(f"{name} has shape {array.shape}; give finite numbers of shape {shape}")
    return array


def _size(value: Any, name: str) -> int:
    try:
        size = index(value)
    except TypeError:
        size = 0
    if size < 1:
        raise InputError(f"{name} is {value!r}; give a whole number of pixels, at least 1")
    return size


def _inverse(matrix: npt.NDArray[np.float64], name: str) -> npt.NDArray[np.float64]:
    try:
        return np.asarray(np.linalg.inv(matrix), np.float64)
    except np.linalg.LinAlgError:
        raise InputError(f"{name} has no inverse; give one of a camera") from None
