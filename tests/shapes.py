"""Shapes that issues of other ray casters are about."""

from __future__ import annotations

import itertools

import numpy as np
import numpy.typing as npt

from clgrid import procedural
from clgrid.mesh import Mesh

F64 = npt.NDArray[np.float64]

WAYS = np.array([way for way in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(way)])
"""The 26 directions along axes and diagonals."""


def box(low: npt.ArrayLike, high: npt.ArrayLike, dtype: type = np.float32) -> Mesh:
    cube = procedural.cube()
    low, high = np.asarray(low, np.float64), np.asarray(high, np.float64)
    return Mesh(np.where(cube.vertices > 0, high, low).astype(dtype), cube.faces)


def joined(*parts: Mesh) -> Mesh:
    """One geometry each."""
    first = np.cumsum([0, *(len(part.vertices) for part in parts)])[:-1]
    faces = [part.faces + np.uint32(start) for part, start in zip(parts, first, strict=True)]
    starts = np.cumsum([0, *(len(part.faces) for part in parts)]).astype(np.int64)
    names = tuple(str(number) for number in range(len(parts)))
    vertices = np.concatenate([part.vertices for part in parts])
    return Mesh(vertices, np.concatenate(faces), geometry_starts=starts, geometry_names=names)


def uv_sphere(radius: float, across: int, down: int) -> Mesh:
    """Rings of quads between two poles, as most toolkits make them: symmetric, with vertices on the axes."""
    down_angle, angle = np.pi * np.arange(1, down) / down, 2 * np.pi * np.arange(across) / across
    ring = np.stack([np.cos(angle), np.zeros(across), np.sin(angle)], -1)
    points = np.sin(down_angle)[:, None, None] * ring + np.cos(down_angle)[:, None, None] * np.array(
        [0, 1, 0]
    )
    poles = np.array([[0.0, 1, 0], [0, -1, 0]])
    vertices = radius * np.concatenate([points.reshape(-1, 3), poles])
    top, bottom = len(vertices) - 2, len(vertices) - 1
    r, c = np.meshgrid(np.arange(down - 2), np.arange(across), indexing="ij")
    a, b = r * across + c, r * across + (c + 1) % across
    quads = np.stack([a, b, b + across, a, b + across, a + across], -1).reshape(-1, 3)
    c = np.arange(across)
    n, last = (c + 1) % across, (down - 2) * across
    caps = [
        np.stack([np.full(across, top), n, c], -1),
        np.stack([np.full(across, bottom), last + c, last + n], -1),
    ]
    return Mesh(vertices.astype(np.float32), np.concatenate([quads, *caps]).astype(np.uint32))


def edge_middles(mesh: Mesh) -> F64:
    """(E, 3) middles of all edges, in float64."""
    ends = np.unique(np.sort(mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    return mesh.vertices[ends].astype(np.float64).mean(axis=1)


def cylinder(radius: float, sides: int = 24) -> Mesh:
    """Closed, from z = -10 to 10."""
    angle = 2 * np.pi * np.arange(sides) / sides
    rim = radius * np.stack([np.cos(angle), np.sin(angle)], -1)
    ends = [np.concatenate([rim, np.full((sides, 1), z)], axis=1) for z in (-10.0, 10.0)]
    vertices = np.concatenate([*ends, [[0, 0, -10], [0, 0, 10]]])
    i, j = np.arange(sides), (np.arange(sides) + 1) % sides
    low, high = np.full(sides, 2 * sides), np.full(sides, 2 * sides + 1)
    parts = [(i, j, j + sides), (i, j + sides, i + sides), (j, i, low), (i + sides, j + sides, high)]
    return Mesh(
        vertices.astype(np.float32), np.concatenate([np.stack(p, -1) for p in parts]).astype(np.uint32)
    )
