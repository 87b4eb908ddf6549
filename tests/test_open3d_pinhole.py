"""Rays of a pinhole camera as Open3D makes them, by an independent projection; what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from clgrid.errors import InputError
from clgrid.open3d import RaycastingScene

pytestmark = pytest.mark.host


def a_pinhole() -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Matrices of a camera turned about two axes and off its picture's middle."""
    a, b = 0.3, -0.7
    about_z = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    about_x = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
    to_camera = np.eye(4)
    to_camera[:3, :3] = about_x @ about_z
    to_camera[:3, 3] = [0.25, -2, 5]
    return np.array([[70, 0.5, 31], [0, 90, 22], [0, 0, 1]]), to_camera


def test_rays_of_matrices_project_onto_their_pixels() -> None:
    to_pixels, to_camera = a_pinhole()
    rays = RaycastingScene.create_rays_pinhole(to_pixels, to_camera, 8, 5).astype(np.float64)
    assert rays.shape == (5, 8, 6)
    for depth in (0.5, 30.0):
        points = rays[..., :3] + depth * rays[..., 3:]
        seen = points @ to_camera[:3, :3].T + to_camera[:3, 3]
        np.testing.assert_allclose(seen[..., 2], depth, rtol=1e-5)
        pixels = seen @ to_pixels.T / seen[..., 2:]
        np.testing.assert_allclose(pixels[..., 0], np.tile(np.arange(8) + 0.5, (5, 1)), rtol=1e-4)
        np.testing.assert_allclose(pixels[..., 1], np.tile(np.arange(5)[:, None] + 0.5, (1, 8)), rtol=1e-4)


def test_rays_of_a_view_are_those_of_its_matrices() -> None:
    """The angle spans the width; columns go to the left and rows up, as from Open3D."""
    eye, centre, up = np.array([1.0, -2, 3]), np.array([0.5, 0.25, -1]), np.array([0, 2, 0.5])
    view = RaycastingScene.create_rays_pinhole(60, centre, eye, up, 12, 7)
    again = RaycastingScene.create_rays_pinhole(
        height_px=7, width_px=12, up=up.tolist(), eye=eye, center=centre, fov_deg=60.0
    )
    assert view.dtype == np.float32
    np.testing.assert_array_equal(view, again)
    ahead = (centre - eye) / np.linalg.norm(centre - eye)
    across = np.cross(up, ahead) / np.linalg.norm(np.cross(up, ahead))
    to_camera = np.eye(4)
    to_camera[:3, :3] = [across, np.cross(ahead, across), ahead]
    to_camera[:3, 3] = -to_camera[:3, :3] @ eye
    focal = 6 / np.tan(np.radians(30))
    to_pixels = np.array([[focal, 0, 6], [0, focal, 3.5], [0, 0, 1]])
    rays = RaycastingScene().create_rays_pinhole(
        intrinsic_matrix=to_pixels, extrinsic_matrix=to_camera, width_px=12, height_px=7
    )
    np.testing.assert_allclose(rays, view, rtol=1e-5, atol=1e-6)
    assert (view[0, 0, 3:] @ up) < (view[-1, 0, 3:] @ up)


BAD_PINHOLES = [
    ((np.eye(4), np.eye(4), 4, 4), r"intrinsic_matrix has shape \(4, 4\)"),
    ((np.eye(3), np.eye(3), 4, 4), r"extrinsic_matrix has shape \(3, 3\)"),
    ((np.zeros((3, 3)), np.eye(4), 4, 4), "intrinsic_matrix has no inverse"),
    ((np.eye(3), np.zeros((4, 4)), 4, 4), "extrinsic_matrix has no inverse"),
    ((np.eye(3), np.full((4, 4), np.inf), 4, 4), "extrinsic_matrix .* finite"),
    ((np.eye(3), np.eye(4), 0, 4), "width_px is 0"),
    ((np.eye(3), np.eye(4), 4, 2.5), "height_px is 2.5"),
    ((60, [0, 0, 0], [0, 0, 1], [0, 1, 0], 4, -1), "height_px is -1"),
    ((180, [0, 0, 0], [0, 0, 1], [0, 1, 0], 4, 4), "field of view 180"),
    (("wide", [0, 0, 0], [0, 0, 1], [0, 1, 0], 4, 4), "fov_deg"),
    ((60, [0, 0], [0, 0, 1], [0, 1, 0], 4, 4), r"center has shape \(2,\)"),
    ((60, [0, 0, 1], [0, 0, 1], [0, 1, 0], 4, 4), "coincide"),
    ((60, [0, 0, 0], [0, 0, 1], [0, 0, 1], 4, 4), "view axis"),
]


@pytest.mark.parametrize(("args", "message"), BAD_PINHOLES)
def test_bad_pinholes_are_one_clear_error(args: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        RaycastingScene.create_rays_pinhole(*args)
