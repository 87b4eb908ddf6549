"""Rays that were once answered wrongly, and what was wrong."""

from __future__ import annotations

import numpy as np
from meshes import soup

from clgrid import procedural
from clgrid.brute import brute_force, brute_force_count
from clgrid.device import Device
from clgrid.grid import build
from clgrid.mesh import Mesh
from clgrid.rungs import LOSSLESS


def test_a_denormal_component_overflowed_its_inverse(device: Device) -> None:
    """The walk then crossed planes at NaN: the ray left a closed box unseen."""
    box = procedural.cube()
    for accuracy in LOSSLESS:
        grid = build(box, resolution=(4, 4, 4), accuracy=accuracy, device=device)
        assert grid.cast([0.3, 0.6, 0.1], [0.7, 1e-310, 0.2]).mask
        assert grid.count([0.3, 0.6, 0.1], [0.7, 1e-310, 0.2]) > 0


def test_a_triangle_seen_flat_lost_the_digits_of_its_weights(device: Device) -> None:
    """Products of 1 and 1e-323 had no digits to weigh with: t named a point beside the triangle."""
    mesh = soup(
        np.array([[[-2, -4, 0], [-4, 3, 0], [-1, 2, 0]], [[-4, -4, 0], [4, -4, 0], [4, 4, 0]]], np.float32)
    )
    ray = [-1.0000000000000002, 2.0, 0.0], [-9.0, -10.0, -5e-323]
    for accuracy in LOSSLESS:
        counts = {
            int(build(mesh, resolution=cells, accuracy=accuracy, device=device).count(*ray, t_min=-np.inf))
            for cells in ((1, 1, 1), (5, 4, 1), (20, 20, 1))
        }
        assert counts == {int(brute_force_count(mesh, *ray, -np.inf, device=device, accuracy=accuracy))}


def test_local_t_that_are_reported_as_equal_went_by_the_smaller(device: Device) -> None:
    """Then the nearest hit was not the first of all hits, which go by the reported t and the lowest id."""
    corners = np.random.default_rng(0).integers(-4, 5, (40, 3, 3)).astype(np.float32)
    corners[..., 2] = 0
    ray = [1.0, 2.0, 20.0], [-0.5, -1.0, -20.0]
    for accuracy in LOSSLESS:
        grid = build(soup(corners), density=4, accuracy=accuracy, device=device)
        hit, every = grid.cast(*ray), grid.cast_all(*ray)
        truth = brute_force(grid.mesh, *ray, device=device, accuracy=accuracy)
        assert hit.primitive_ids == every.primitive_ids[0] == truth.primitive_ids
        assert (np.diff(every.t_hit) >= 0).all()


def test_a_ray_within_many_needles_took_seconds(device: Device) -> None:
    """Each was decided by integers in each of thousands of cells; now so many times that it costs a cast."""
    angle = np.linspace(0, 2 * np.pi, 301)[:-1, None]
    rim = np.concatenate([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1) * 1e-3
    fan = Mesh(
        np.concatenate([[[0, 0, -1], [0, 0, 1]], rim]),
        np.array([[0, 1, 2 + k] for k in range(300)], np.uint32),
    )
    grid = build(fan, resolution=(1, 1, 2000), accuracy="exact", device=device)
    ray = [0.0, 0.0, -3.0], [0.0, 1e-7, 1.0]
    hits = grid.cast(*ray, fields=("tests",))
    assert hits.tests < 300 * 100
    assert grid.count(*ray) == brute_force_count(fan, *ray, device=device, accuracy="exact")
    assert hits.primitive_ids == brute_force(fan, *ray, device=device, accuracy="exact").primitive_ids
