"""Textures on the device against a twin in numpy that does the same float64 operations."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from shaded import COORDINATES, quad, scene_of

from clgrid.camera import Camera
from clgrid.grid import build
from clgrid.look import Material, Texture, TextureUse
from clgrid.renderer import render
from clgrid.shading.surfaces import decoded_srgb

pytestmark = pytest.mark.host

WRAPS = ("repeat", "mirror", "clamp")
SIZE = 120


def texel_numbers(i: np.ndarray, size: int, wrap: str) -> np.ndarray:
    if wrap == "repeat":
        return np.mod(i, size).astype(int)
    if wrap == "mirror":
        within = np.mod(i, 2 * size)
        return np.where(within < size, within, 2 * size - 1 - within).astype(int)
    return np.clip(i, 0, size - 1).astype(int)


def looked_up(texture: Texture, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """(N, 4) float64: linear colour and alpha."""
    height, width = texture.pixels.shape[:2]
    values = np.concatenate([decoded_srgb()[texture.pixels[..., :3]], texture.pixels[..., 3:] / 255.0], -1)
    x, y = (np.where(np.abs(a) < 2.0**31, a, 0.0) for a in (u * width, v * height))
    if not texture.smooth:
        return values[
            texel_numbers(np.floor(y), height, texture.wrap[1]),
            texel_numbers(np.floor(x), width, texture.wrap[0]),
        ]
    left, top = np.floor(x - 0.5), np.floor(y - 0.5)
    columns = [texel_numbers(left + k, width, texture.wrap[0]) for k in (0, 1)]
    rows = [texel_numbers(top + k, height, texture.wrap[1]) for k in (0, 1)]
    across, down = ((x - 0.5) - left)[:, None], ((y - 0.5) - top)[:, None]
    upper, lower = (
        values[row, columns[0]] + across * (values[row, columns[1]] - values[row, columns[0]]) for row in rows
    )
    return upper + down * (lower - upper)


def test_every_byte_is_decoded(device):
    """A row of all bytes, a pixel each: the linear values of IEC 61966-2-1, rounded once."""
    ramp = np.repeat(np.arange(256, dtype=np.uint8)[None, :, None], 4, axis=2)
    material = Material(base_texture=TextureUse(0))
    mesh, look = scene_of([quad()], [material], [Texture(ramp, smooth=False)])
    camera = Camera.look_at((0, 0, 3), (0, 0, 0), (0, 1, 0), orthographic_height=2)
    picture = render(mesh, camera, 256, 256, ("albedo", "uv", "P"), look=look, device=device, density=4)
    byte = np.arange(256) / 255
    linear = np.where(byte <= 0.04045, byte / 12.92, ((byte + 0.055) / 1.055) ** 2.4).astype(np.float32)
    np.testing.assert_array_equal(picture.albedo, np.broadcast_to(linear[None, :, None], (256, 256, 3)))
    middles = (np.arange(256) + 0.5) / 256
    np.testing.assert_allclose(picture.uv[7, :, 0], middles, atol=2e-7)
    np.testing.assert_allclose(picture.uv[:, 9, 1], middles, atol=2e-7)
    np.testing.assert_allclose(picture.position[30, :, 0], 2 * middles - 1, atol=2e-7)
    assert (picture.position[..., 2] == 0).all()


def test_look_ups_are_those_of_the_twin(device):
    """All wraps along both axes, smooth or not, moved by a transform or not, two sets, vertex colours."""
    rng = np.random.default_rng(5)
    turned = np.array([[0.8, -0.6, 3.25], [0.6, 0.8, -1.5]])
    kinds = list(itertools.product(WRAPS, WRAPS, (True, False), (None, turned)))
    textures = [
        Texture(
            rng.integers(0, 256, (int(rng.integers(1, 9)), int(rng.integers(1, 9)), 4), dtype=np.uint8),
            (a, b),
            s,
        )
        for a, b, s, _ in kinds
    ]
    factors = rng.random((len(kinds), 4))
    materials = [
        Material(base_colour=tuple(factors[k]), base_texture=TextureUse(k, k % 2, kinds[k][3]))
        for k in range(len(kinds))
    ]
    quads = [quad(0, 0.5, (k % 6 + 0.5 - 3, k // 6 + 0.5 - 3)) for k in range(len(kinds))]
    uvs = [(6 * COORDINATES - 2.5 + k / 7).astype(np.float32) for k in range(len(kinds))]
    mesh, look = scene_of(quads, materials, textures, uvs=uvs)
    second = rng.normal(0, 3, (7, 2)).astype(np.float32)
    second[0] = [3e9, np.inf]  # beyond all sense, but no harm
    rows = rng.integers(0, 7, mesh.faces.shape).astype(np.uint32)
    colours = rng.random((len(mesh.vertices), 4)).astype(np.float32)
    look = type(look)(
        look.materials, look.material_ids, look.textures, (look.uvs[0], second), (None, rows), colours=colours
    )
    camera = Camera.look_at((0, 0, 3), (0, 0, 0), (0, 1, 0), orthographic_height=6.1)
    grid = build(mesh, device=device, density=4)
    picture = render(mesh, camera, SIZE, SIZE, ("albedo", "uv"), look=look, grid=grid)
    hits = grid.cast(*camera.rays(SIZE, SIZE))
    ids = hits.primitive_ids[hits.mask]
    u, v = np.moveaxis(hits.primitive_uvs[hits.mask].astype(np.float64), -1, 0)
    weights = [(1.0 - u) - v, u, v]
    expected = np.zeros((len(ids), 3), np.float32)
    first = np.zeros((len(ids), 2))
    for k in range(3):
        first += weights[k][:, None] * look.uvs[0][mesh.faces[ids, k]].astype(np.float64)
    for k, material in enumerate(materials):
        mine = ids // 2 == k
        faces = (mesh.faces, rows)[k % 2][ids[mine]]
        at = np.zeros((mine.sum(), 2))
        with np.errstate(all="ignore"):
            for corner in range(3):
                at = at + weights[corner][mine, None] * look.uvs[k % 2][faces[:, corner]].astype(np.float64)
            m = np.eye(2, 3) if kinds[k][3] is None else kinds[k][3]
            x, y = ((m[a, 0] * at[:, 0] + m[a, 1] * at[:, 1]) + m[a, 2] for a in (0, 1))
            found = looked_up(textures[k], x, y)
        corners = colours[mesh.faces[ids[mine]]].astype(np.float64)
        share = (weights[0][mine, None] * corners[:, 0] + u[mine, None] * corners[:, 1]) + v[
            mine, None
        ] * corners[:, 2]
        expected[mine] = ((np.array(material.base_colour) * found) * share)[:, :3].astype(np.float32)
    assert len(set(ids.tolist())) == 2 * len(kinds)
    np.testing.assert_array_equal(picture.albedo[hits.mask], expected)
    np.testing.assert_array_equal(picture.uv[hits.mask], first.astype(np.float32))
    assert (picture.albedo[~hits.mask] == 0).all()
