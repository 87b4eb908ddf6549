"""Small scenes with a look: quads of one material each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from clgrid.look import Light, Look, Material, Texture
from clgrid.mesh import Mesh

WHITE = Material("white")
# Corners of a quad, and texture coordinates that put (0, 0) at its upper left.
CORNERS = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], np.float64)
COORDINATES = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32)


def quad(
    z: float = 0.0, half: float = 1.0, centre: Sequence[float] = (0.0, 0.0), *, up: bool = True
) -> np.ndarray:
    """(4, 3) float32: a square at height z, wound to be seen from above or from below."""
    flat = CORNERS * half + np.asarray(centre)
    corners = np.column_stack([flat, np.full(4, z)])
    return (corners if up else corners[::-1]).astype(np.float32)


def scene_of(
    quads: Sequence[np.ndarray],
    materials: Sequence[Material],
    textures: Sequence[Texture] = (),
    lights: Sequence[Light] = (),
    uvs: Sequence[np.ndarray] | None = None,
    **more: Any,
) -> tuple[Mesh, Look]:
    """A mesh of quads, two triangles each, and its look, a material each."""
    faces = np.concatenate([4 * k + np.array([[0, 1, 2], [0, 2, 3]]) for k in range(len(quads))])
    mesh = Mesh(np.concatenate(quads), faces.astype(np.uint32))
    own = np.concatenate([COORDINATES] * len(quads) if uvs is None else list(uvs)).astype(np.float32)
    look = Look(
        tuple(materials),
        np.repeat(np.arange(len(quads)), 2).astype(np.uint16),
        tuple(textures),
        (own,),
        (None,),
        lights=tuple(lights),
    )
    return mesh, replace(look, **more)


def plain_look(mesh: Mesh, *lights: Light, **material: Any) -> Look:
    """One material all over, white unless said otherwise."""
    return Look((replace(WHITE, **material),), np.zeros(mesh.triangle_count, np.uint32), lights=lights)
