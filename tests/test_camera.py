from __future__ import annotations

import math

import numpy as np
import pyopencl as cl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clgrid import procedural, structs
from clgrid.camera import Camera
from clgrid.device import Device
from clgrid.errors import InputError
from clgrid.grid import build
from clgrid.program import include_folder, source_folder

RAYS = """
#include "camera.h"
__kernel void rays(__constant const CameraParams *camera, __global double *directions)
{
    double d[3];
    camera_direction(camera, get_global_id(0), get_global_id(1), d);
    for (int a = 0; a < 3; ++a)
        directions[3 * (get_global_id(1) * camera->width + get_global_id(0)) + a] = d[a];
}
"""
BOXES = [
    ([[-1, -1, -1], [1, 1, 1]], (0, 1, 0)),
    ([[0, 0, 682], [9780, 13950, 2543]], (0, 0, 1)),
    ([[1e6, 2e6, -3e6], [1e6 + 1, 2e6 + 30, -3e6 + 2]], (0, 1, 0)),
    ([[-1e-30, 0, 0], [1e-30, 2e-30, 5e-31]], (1, 0, 0)),
    ([[-3e38, -3e38, -1e38], [3e38, 3e38, 1e38]], (0, -1, 0)),
]


def device_directions(device: Device, camera: Camera, width: int, height: int) -> np.ndarray:
    source = structs.declarations() + RAYS
    program = cl.Program(device.context, source).build(["-I", str(include_folder(source_folder()))])
    params = camera.params(width, height)
    flags = cl.mem_flags
    buffer = cl.Buffer(device.context, flags.READ_ONLY | flags.COPY_HOST_PTR, hostbuf=params)
    directions = np.zeros((height, width, 3))
    out = cl.Buffer(device.context, flags.WRITE_ONLY, directions.nbytes)
    cl.Kernel(program, "rays")(device.queue, (width, height), None, buffer, out)
    cl.enqueue_copy(device.queue, directions, out)
    return directions


@pytest.mark.filterwarnings("ignore::pyopencl.CompilerWarning")
@pytest.mark.parametrize(
    "camera",
    [
        Camera.look_at((3.1, 2.7, -1.3), (0.1, 0.2, 0.3), fov=37.7),
        Camera.look_at((1e8, -3e-7, 12345.678), (1e8 + 1, 5, 7), (0.3, 0.9, 0.1), 120),
        Camera.framing([[-1, -2, -3], [4, 5, 6]], aspect=1.7),
    ],
)
@pytest.mark.parametrize(("width", "height"), [(37, 23), (64, 1), (1, 5)])
def test_device_makes_the_same_rays_bit_for_bit(device, camera, width, height):
    _, expected = camera.rays(width, height)
    found = device_directions(device, camera, width, height)
    assert (found.view(np.uint64) == expected.view(np.uint64)).all()


def test_rays_go_through_pixel_centres_row_zero_on_top():
    camera = Camera.look_at((0, 0, 5), (0, 0, 0), fov=90)
    origins, directions = camera.rays(4, 2)
    assert origins.shape == directions.shape == (2, 4, 3)
    assert (origins == [0, 0, 5]).all()
    # fov 90: the picture's half height is 1 at depth 1; pixels are 1 high.
    expected_x = np.array([-1.5, -0.5, 0.5, 1.5])
    np.testing.assert_allclose(directions[..., 0], [expected_x, expected_x], rtol=1e-15)
    np.testing.assert_allclose(directions[..., 1], [[0.5] * 4, [-0.5] * 4], rtol=1e-15)
    np.testing.assert_allclose(directions[..., 2], -1)


def test_rays_mirror_exactly():
    _, directions = Camera.look_at((0, 0, 5), (0, 0, 0), fov=33.3).rays(7, 5)
    assert (directions[:, ::-1, 0] == -directions[..., 0]).all()
    assert (directions[::-1, :, 1] == -directions[..., 1]).all()


unit = st.floats(-1, 1)


@settings(max_examples=50, deadline=None)
@given(st.tuples(unit, unit, unit), st.tuples(unit, unit, unit), st.floats(1, 170))
def test_t_is_planar_depth(eye, target, fov):
    forward = np.array(target) - np.array(eye)
    if np.linalg.norm(forward) < 1e-3 or np.linalg.norm(np.cross(forward, [0, 1, 0])) < 1e-3:
        return
    camera = Camera.look_at(eye, target, fov=fov)
    _, directions = camera.rays(9, 6)
    bound = 1e-14 * (1 + math.tan(math.radians(fov / 2)) * 2)
    np.testing.assert_allclose(directions @ camera.forward, 1, rtol=0, atol=bound)


@pytest.mark.parametrize(("bounds", "up"), BOXES)
@pytest.mark.parametrize("aspect", [0.5, 1.0, 16 / 9])
def test_framing_shows_the_whole_box_and_fills_the_picture(bounds, up, aspect):
    camera = Camera.framing(bounds, up, 40, aspect)
    low, high = np.array(bounds, float)
    corners = np.array([[low, high][k][a] for k in (0, 1) for a in range(3)]).reshape(2, 3)
    box = np.stack(np.meshgrid(*corners.T), -1).reshape(8, 3) - camera.eye
    depth = box @ camera.forward
    assert (depth > 0).all()
    tan = math.tan(math.radians(20))
    x, y = box @ camera.right / depth / (tan * aspect), box @ camera.up / depth / tan
    assert max(np.abs(x).max(), np.abs(y).max()) <= 1.0
    assert max(np.abs(x).max(), np.abs(y).max()) >= 0.95
    # As far from the left border as from the right one, as far from the top as from the bottom.
    assert x.max() + x.min() == pytest.approx(0, abs=1e-6)
    assert y.max() + y.min() == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize(("bounds", "up"), BOXES)
def test_framing_looks_down_from_the_side(bounds, up):
    camera = Camera.framing(bounds, up)
    assert camera.up @ np.array(up) > 0.5
    assert -0.6 < camera.forward @ np.array(up) < -0.2


def test_framing_a_point_moves_the_eye_off_it():
    camera = Camera.framing([[5e5, 1, 1], [5e5, 1, 1]])
    assert (camera.eye != [5e5, 1, 1]).any()


def test_gltf_matrix_looks_along_minus_z():
    camera = Camera.from_matrix(np.diag([2.0, 2.0, 2.0, 1.0]), 50)
    assert (camera.right == [1, 0, 0]).all()
    assert (camera.up == [0, 1, 0]).all()
    assert (camera.forward == [0, 0, -1]).all()


def test_world_to_camera_takes_the_eye_to_the_origin_and_the_target_ahead():
    camera = Camera.look_at((1, 2, 3), (4, -2, 3))
    matrix = camera.world_to_camera()
    np.testing.assert_allclose(matrix @ [1, 2, 3, 1], [0, 0, 0, 1], atol=1e-15)
    np.testing.assert_allclose(matrix @ [4, -2, 3, 1], [0, 0, 5, 1], atol=1e-15)


@pytest.mark.parametrize(
    ("axis", "size", "half_width"),
    [
        ("x", (200, 100), 1.0),
        ("y", (200, 100), 2.0),
        ("smaller", (200, 100), 2.0),
        ("smaller", (100, 200), 1.0),
    ],
)
def test_fov_spans_the_side_it_is_given_for(axis, size, half_width):
    camera = Camera.from_matrix(np.eye(4), 90, axis)
    step_x, step_y = camera.steps(*size)
    assert np.linalg.norm(step_x) * size[0] / 2 == pytest.approx(half_width)
    assert np.linalg.norm(step_x) == np.linalg.norm(step_y)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Camera.look_at((0, 0, 0), (0, 0, 0)), "coincide"),
        (lambda: Camera.look_at((0, 0, 0), (0, 1, 0)), "up"),
        (lambda: Camera.look_at((0, 0, 0), (0, 0, 1), (0, 0, 0)), "up"),
        (lambda: Camera.look_at((0, math.nan, 0), (0, 0, 1)), "eye"),
        (lambda: Camera.look_at((0, 0), (0, 0, 1)), "eye"),
        (lambda: Camera.look_at((0, 0, 0), (0, 0, 1), fov=180), "field of view"),
        (lambda: Camera.look_at((0, 0, 0), (0, 0, 1), fov=math.nan), "field of view"),
        (lambda: Camera.from_matrix(np.zeros((4, 4)), 40), "length zero"),
        (lambda: Camera.from_matrix(np.eye(3), 40), "4x4"),
    ],
)
def test_impossible_cameras_are_refused_by_name(make, message):
    with pytest.raises(InputError, match=message):
        make()


def test_orthographic_rays_are_parallel_through_pixel_centres() -> None:
    camera = Camera.look_at((1, 2, 5), (1, 2, 0), orthographic_height=4)
    origins, directions = camera.rays(6, 2)
    assert origins.shape == directions.shape == (2, 6, 3)
    assert (directions == [0, 0, -1]).all()
    np.testing.assert_array_equal(origins[..., 0], np.tile(1 + 2.0 * np.arange(-2.5, 3), (2, 1)))
    np.testing.assert_array_equal(origins[..., 1], np.tile([[3.0], [1.0]], (1, 6)))
    np.testing.assert_array_equal(origins[..., 2], 5)


def test_orthographic_rays_keep_their_axes() -> None:
    camera = Camera.look_at((1, -2, 3), (0.5, 0, 0), (0, 0, 1), orthographic_height=3)
    origins, directions = camera.rays(8, 6)
    away = (origins - camera.eye) @ np.stack([camera.right, camera.up, camera.forward], 1)
    x, y = (np.arange(8) - 3.5) / 2, (2.5 - np.arange(6)) / 2
    np.testing.assert_allclose(away[..., 0], np.tile(x, (6, 1)), atol=1e-15)
    np.testing.assert_allclose(away[..., 1], np.tile(y[:, None], (1, 8)), atol=1e-15)
    np.testing.assert_allclose(away[..., 2], 0, atol=1e-15)
    assert (directions == camera.forward).all()


def test_an_orthographic_depth_is_the_distance_to_the_plane(device: Device) -> None:
    ball, camera = procedural.icosphere(3), Camera.look_at((0, 0, 5), (0, 0, 0), orthographic_height=3)
    hits = build(ball, device=device, view=camera).cast(*camera.rays(31, 31))
    assert abs(hits.t_hit[15, 15] - 4) < 0.01
    radii = np.linalg.norm(hits.origins[..., :2], axis=-1)
    assert hits.mask[radii < 0.98].all()
    assert not hits.mask[radii > 1].any()


@pytest.mark.parametrize("height", [0.0, -1.0, math.inf, math.nan])
def test_an_orthographic_height_is_above_zero(height: float) -> None:
    with pytest.raises(InputError, match="orthographic height"):
        Camera.look_at((0, 0, 5), (0, 0, 0), orthographic_height=height)
