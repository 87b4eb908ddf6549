"""Rung ``precise`` against its numpy twin, in every bit: without the filter, and without a device."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import precise_twin
import pytest
from adversarial import structured
from hypothesis import given
from hypothesis import strategies as st
from meshes import MESHES
from precise_twin import difference_of_products

from clgrid.brute import brute_force
from clgrid.device import Device
from clgrid.mesh import Mesh

EXPONENTS = (-1074, -1000, -600, -300, -60, -20, -3, 0)


def doubles() -> st.SearchStrategy[float]:
    """Zero, and few or many digits at any exponent up to 8."""
    digits = st.one_of(st.integers(-9, 9), st.integers(-(2**53), 2**53).map(lambda n: n * 2.0**-51))
    return st.builds(lambda d, e: float(d) * 2.0**e, digits, st.sampled_from(EXPONENTS))


@given(st.tuples(doubles(), doubles(), doubles(), doubles()), st.booleans())
def test_the_sign_of_a_difference_of_products_is_exact(values: tuple[float, ...], near: bool) -> None:
    p, q, r, s = values
    if near and p:
        # As good as equal products.
        r, s = q, float(np.nextafter(p, 9))
    exact = Fraction(p) * Fraction(q) - Fraction(r) * Fraction(s)
    with np.errstate(all="ignore"):
        found = difference_of_products(*(np.array([x]) for x in (p, q, r, s)))[0]
    assert np.sign(found) == (exact > 0) - (exact < 0)


def check(mesh: Mesh, device: Device, count: int, seed: int) -> None:
    rays = structured(mesh, count, seed)
    hits = brute_force(mesh, *rays, device=device, accuracy="precise")
    twin = precise_twin.closest(mesh, *rays)
    np.testing.assert_array_equal(hits.primitive_ids, twin.ids)
    np.testing.assert_array_equal(hits.t_hit.view(np.uint64), twin.t_hit.view(np.uint64))
    np.testing.assert_array_equal(hits.primitive_uvs.view(np.uint64), twin.uvs.view(np.uint64))


@pytest.mark.parametrize("name", ["ball", "edge_on_slivers", "stacks"])
def test_brute_force_equals_the_twin(name: str, device: Device) -> None:
    check(MESHES[name], device, 400, 1)


@pytest.mark.slow
@pytest.mark.parametrize("name", MESHES)
def test_brute_force_equals_the_twin_on_every_mesh(name: str, device: Device) -> None:
    check(MESHES[name], device, 1500, 2)


def test_tiny_triangles_beside_large_ones(device: Device) -> None:
    """Sheared coordinates whose products underflow."""
    rng = np.random.default_rng(3)
    tiny = rng.integers(-4, 5, (200, 3, 3)) * 2.0 ** -rng.integers(500, 1000, (200, 1, 1)).astype(float)
    corners = np.concatenate([tiny, rng.uniform(-1, 1, (20, 3, 3))])
    mesh = Mesh(corners.reshape(-1, 3), np.arange(660, dtype=np.uint32).reshape(-1, 3))
    directions = rng.integers(-2, 3, (300, 3)).astype(float)
    origins = rng.integers(-4, 5, (300, 3)) * 2.0 ** -rng.integers(500, 1000, (300, 1)).astype(float)
    hits = brute_force(mesh, origins, directions, device=device, accuracy="precise")
    twin = precise_twin.closest(mesh, origins, directions)
    np.testing.assert_array_equal(hits.primitive_ids, twin.ids)
    np.testing.assert_array_equal(hits.t_hit, twin.t_hit)
    assert (hits.primitive_ids[hits.mask] < 200).any()
