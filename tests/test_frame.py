"""The local frame: unit size, exact for float32, one rounding for float64."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clgrid.errors import MeshError
from clgrid.frame import LocalFrame
from clgrid.mesh import Mesh

TRIANGLE = np.array([[0, 1, 2]], np.uint32)
plain_float32 = st.floats(width=32, allow_nan=False, allow_infinity=False, allow_subnormal=False)


def mesh_of(vertices: object, dtype: type = np.float32) -> Mesh:
    return Mesh(np.array(vertices, dtype), TRIANGLE)


def frame_of(mesh: Mesh) -> LocalFrame:
    return LocalFrame.of_bounds(mesh.bounds)


@given(st.lists(st.tuples(*[plain_float32] * 3), min_size=3, max_size=3))
def test_local_vertices_lie_within_one_and_keep_their_order(
    vertices: list[tuple[float, float, float]],
) -> None:
    mesh = mesh_of(vertices)
    local = frame_of(mesh).to_local(mesh.vertices)
    assert local.dtype == np.float32
    assert np.abs(local).max() <= 1
    for axis in range(3):
        order = np.argsort(mesh.vertices[:, axis], kind="stable")
        assert (np.diff(local[order, axis]) >= 0).all()


@given(st.lists(st.tuples(*[plain_float32] * 3), min_size=3, max_size=3))
def test_float32_is_exact_unless_it_underflows(vertices: list[tuple[float, float, float]]) -> None:
    mesh = mesh_of(vertices)
    frame = frame_of(mesh)
    local = frame.to_local(mesh.vertices)
    for axis in range(3):
        offset = Fraction(float(frame.offset[axis]))
        for stored, found in zip(mesh.vertices[:, axis], local[:, axis], strict=True):
            exact = (Fraction(float(stored)) - offset) / Fraction(2) ** frame.exponent
            # Below 2^-126 a float32 has a fixed step.
            assert abs(Fraction(float(found)) - exact) <= (
                0 if abs(exact) >= 2.0**-126 else Fraction(2) ** -150
            )


def test_an_axis_far_away_is_moved_and_the_others_are_not() -> None:
    far = mesh_of([[1e7, 0, -5], [1e7 + 8, 1, 5], [1e7 + 4, 3, 2]])
    frame = frame_of(far)
    assert frame.offset[0] == pytest.approx(1e7, rel=1e-6)
    assert (frame.offset[1:] == 0).all()
    assert frame.exponent == 3
    assert frame.max_rounding(far) == 0


def test_float64_far_from_the_origin_loses_one_local_rounding() -> None:
    rng = np.random.default_rng(0)
    far = Mesh(1e6 + rng.random((300, 3)), np.arange(300, dtype=np.uint32).reshape(-1, 3))
    frame = frame_of(far)
    # One unit of extent: half an ulp of a local coordinate below 1 is 2^-25.
    assert 0 < frame.max_rounding(far) <= 2.0**-25 * 2.0**frame.exponent
    assert frame.exponent <= 0
    back = np.ldexp(frame.to_local(far.vertices).astype(np.float64), frame.exponent) + frame.offset
    assert np.abs(back - far.vertices).max() < 2.0**-24


def test_rounding_counts_only_vertices_in_use() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [np.nan, np.inf, 1 / 3]])
    mesh = Mesh(vertices, TRIANGLE)
    assert frame_of(mesh).max_rounding(mesh) == 0


@pytest.mark.parametrize("exponent", [-140, -60, 0, 60, 120])
def test_powers_of_two_change_nothing_local(exponent: int) -> None:
    vertices = np.random.default_rng(1).uniform(-1, 1, (3, 3)).astype(np.float32)
    small = np.abs(vertices) < 2.0**-8  # keeps the smallest scale above float32's underflow
    vertices[small] = 0.5
    plain = frame_of(mesh_of(vertices)).to_local(vertices)
    scaled = np.ldexp(vertices.astype(np.float64), exponent)
    moved = frame_of(mesh_of(scaled, np.float64)).to_local(scaled)
    np.testing.assert_array_equal(plain, moved)


def test_a_single_point_has_a_frame() -> None:
    for value in (0.0, 3.0, -1e-40, 1e30):
        mesh = mesh_of([[value] * 3] * 3)
        local = frame_of(mesh).to_local(mesh.vertices)
        assert np.abs(local).max() <= 1


def test_coordinates_beyond_the_largest_exponent_are_refused() -> None:
    assert frame_of(mesh_of([[-(2.0**899)] * 3, [0] * 3, [1] * 3], np.float64)).exponent == 900
    with pytest.raises(MeshError, match=r"scale the mesh below 2\^900"):
        frame_of(mesh_of([[-(2.0**900)] * 3, [0] * 3, [1] * 3], np.float64))
    with pytest.raises(MeshError, match="coordinates reach"):
        frame_of(mesh_of([[-1.7e308] * 3, [1.7e308] * 3, [1] * 3], np.float64))


def test_params_are_exact_inverses() -> None:
    params = LocalFrame(np.array([1.0, 2.0, 3.0]), 900).params()
    assert params["scale"] * params["inverse_scale"] == 1
    np.testing.assert_array_equal(params["offset"], [1, 2, 3])


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("exponent", [-140, -126, -3, 0, 5, 100, 127])
@pytest.mark.parametrize("offset", [0.0, 0.75])
def test_every_coordinate_is_rounded_once(dtype: type, exponent: int, offset: float) -> None:
    """Against numpy's own ldexp, over several chunks and into a given array."""
    rng = np.random.default_rng(7)
    with np.errstate(under="ignore", over="ignore"):
        unit = rng.uniform(-1, 1, (20_000, 3)) * 10.0 ** rng.integers(-20, 1, (20_000, 3))
        vertices = np.ldexp(unit, min(exponent, 126)).astype(dtype)
        moved = np.array([0.0, np.ldexp(offset, min(exponent, 126)), 0.0])
        expected = np.ldexp(vertices.astype(np.float64) - moved, -exponent).astype(np.float32)
    out = np.full((20_000, 3), np.nan, np.float32)
    assert LocalFrame(moved, exponent).to_local(vertices, out) is out
    np.testing.assert_array_equal(out.view(np.uint32), expected.view(np.uint32))
