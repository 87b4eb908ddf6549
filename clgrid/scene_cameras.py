"""Cameras that files hold: those of glTF scenes by name or number, and camera files of JSON."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from clgrid.camera import DEFAULT_FOV, Camera, FovAxis
from clgrid.errors import InputError

if TYPE_CHECKING:
    from clgrid.meshfile.gltf_cameras import GltfCamera


def camera_among(cameras: Sequence[GltfCamera | Camera], selector: str, where: str) -> Camera:
    """Find a camera by name or index.

    Raises
    ------
    InputError
        If there is no such camera; the message lists those there are.
    """
    chosen = [camera for camera in cameras if camera.name == selector]
    if selector.isdecimal() and int(selector) < len(cameras):
        chosen = [cameras[int(selector)]]
    if not chosen:
        known = ", ".join(f"{k} {camera.name!r}" for k, camera in enumerate(cameras)) or "none"
        raise InputError(f"camera {selector!r}: not in {where}, which has {known}; or give a .json file")
    return chosen[0] if isinstance(chosen[0], Camera) else camera_of(chosen[0])


def camera_of(camera: GltfCamera) -> Camera:
    """Make a camera of one in a glTF file; the scale of its node is dropped.

    Raises
    ------
    InputError
        If its lens or place is none.
    """
    height = None if camera.ymag is None else 2.0 * abs(camera.ymag)
    fov = DEFAULT_FOV if camera.yfov is None else float(np.degrees(camera.yfov))
    return Camera.from_matrix(camera.matrix, fov, name=camera.name, orthographic_height=height)


class _MatrixCamera(msgspec.Struct):
    """What converters of Mitsuba and pbrt scenes write beside a mesh."""

    fov: float | str | list[float | str] = DEFAULT_FOV
    toWorld: list[list[float]] | None = None  # noqa: N815
    worldToCam: list[list[float]] | None = None  # noqa: N815


class _CameraFile(msgspec.Struct):
    """A camera file: a matrix under ``camera``, or the command line's own words."""

    camera: _MatrixCamera | None = None
    eye: tuple[float, float, float] | None = None
    look_at: tuple[float, float, float] | None = None
    up: tuple[float, float, float] = (0.0, 1.0, 0.0)
    fov: float = DEFAULT_FOV


def camera_file(path: Path) -> Camera:
    """Read a camera from JSON.

    Either ``{"eye": [..], "look_at": [..], "up": [..], "fov": degrees}`` or ``{"camera": {..}}`` with
    ``toWorld`` (Mitsuba: camera to world, x to the left, z into the picture, fov along the width) or
    ``worldToCam`` (pbrt: world to camera, x to the right, z into the picture, fov along the shorter side).

    Raises
    ------
    InputError
        If the file is missing or holds neither.
    """
    try:
        content = msgspec.json.decode(path.read_bytes(), type=_CameraFile)
    except OSError as error:
        raise InputError(f"camera {path}: cannot be read ({error.strerror})") from error
    except msgspec.MsgspecError as error:
        raise InputError(f"camera {path}: not a camera file ({error})") from error
    given = content.camera
    if content.eye is not None and content.look_at is not None:
        return Camera.look_at(content.eye, content.look_at, content.up, content.fov)
    if given is None or (given.toWorld is None and given.worldToCam is None):
        raise InputError(f"camera {path}: give eye and look_at, or camera with toWorld or worldToCam")
    axis: FovAxis = "smaller" if given.toWorld is None else "x"
    right = 1 if given.toWorld is None else -1
    matrix = _inverse(given.worldToCam, path) if given.toWorld is None else given.toWorld
    return Camera.from_matrix(matrix, _degrees(given.fov, path), axis, right=right, forward=1, name=path.name)


def _inverse(matrix: Any, path: Path) -> Any:
    try:
        return np.linalg.inv(np.asarray(matrix, np.float64))
    except (np.linalg.LinAlgError, ValueError) as error:
        raise InputError(f"camera {path}: its matrix has no inverse ({error})") from error


def _degrees(value: float | str | list[float | str], path: Path) -> float:
    """Read the angle, which converters write as a number, a text or a list of one text."""
    first = value[0] if isinstance(value, list) and value else value
    try:
        return float(first)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        raise InputError(f"camera {path}: fov {value!r} is not a number of degrees") from None
