"""Meshes that strain a ray caster: closed ones, slivers, stacks, flat and far ones, at all scales."""

from __future__ import annotations

import numpy as np

from clgrid import procedural
from clgrid.mesh import Mesh


def soup(corners: np.ndarray, dtype: type = np.float32) -> Mesh:
    flat = np.ascontiguousarray(corners.reshape(-1, 3), dtype)
    return Mesh(flat, np.arange(len(flat), dtype=np.uint32).reshape(-1, 3))


def torus(rings: int = 24, around: int = 16) -> Mesh:
    """Closed, with a hole."""
    a, b = np.meshgrid(
        np.arange(rings) * 2 * np.pi / rings, np.arange(around) * 2 * np.pi / around, indexing="ij"
    )
    radius = 1 + 0.4 * np.cos(b)
    points = np.stack([radius * np.cos(a), radius * np.sin(a), 0.4 * np.sin(b)], -1).reshape(-1, 3)
    r, c = np.meshgrid(np.arange(rings), np.arange(around), indexing="ij")
    r1, c1 = (r + 1) % rings, (c + 1) % around
    p, q, s, t = (i * around + j for i, j in ((r, c), (r1, c), (r1, c1), (r, c1)))
    faces = np.concatenate([np.stack([p, q, s], -1).reshape(-1, 3), np.stack([p, s, t], -1).reshape(-1, 3)])
    return Mesh(points.astype(np.float32), faces.astype(np.uint32))


def lattice_box(n: int = 8) -> Mesh:
    """A closed box of squares; at n x n x n cells its faces' edges lie in the planes between cells."""
    cube = procedural.cube()
    u, v = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    low = np.stack([u, v], -1).reshape(-1, 2)
    corners = []
    for axis in range(3):
        for side in (0, n):
            for ends in (((0, 0), (1, 0), (1, 1)), ((0, 0), (1, 1), (0, 1))):
                flat = low[:, None, :] + np.array(ends)[None]
                corners.append(np.insert(flat, axis, side, axis=2))
    points, faces = np.unique(np.concatenate(corners).reshape(-1, 3), axis=0, return_inverse=True)
    assert len(cube.faces) * n * n == len(faces.reshape(-1, 3))
    return Mesh((points * (2.0 / n) - 1).astype(np.float32), faces.reshape(-1, 3).astype(np.uint32))


def needle_fan(count: int = 60) -> Mesh:
    """A closed double cone of needles around a thin axis."""
    angle = np.arange(count) * 2 * np.pi / count
    rim = np.stack([1e-4 * np.cos(angle), 1e-4 * np.sin(angle), np.zeros(count)], -1)
    points = np.concatenate([rim, [[0, 0, 1]], [[0, 0, -1]]])
    i, j = np.arange(count), (np.arange(count) + 1) % count
    top, bottom = np.full(count, count), np.full(count, count + 1)
    faces = np.concatenate([np.stack([i, j, top], -1), np.stack([j, i, bottom], -1)])
    return Mesh(points.astype(np.float32), faces.astype(np.uint32))


def scaled(mesh: Mesh, by: float, dtype: type = np.float32) -> Mesh:
    return Mesh((mesh.vertices.astype(np.float64) * by).astype(dtype), mesh.faces)


def moved(mesh: Mesh, by: float, dtype: type) -> Mesh:
    return Mesh((mesh.vertices.astype(np.float64) + by * np.array([1, -0.7, 0.3])).astype(dtype), mesh.faces)


def edge_on_slivers(rng: np.random.Generator, count: int = 120) -> Mesh:
    """Long triangles a few roundings wide, all nearly within planes through one point at (0, 0, 3)."""
    eye = np.array([0.0, 0.0, 3.0])
    a, b = rng.uniform(-1, 1, (2, count, 3))
    thin = 10.0 ** rng.uniform(-8, -5, (count, 1)) * rng.normal(size=(count, 3))
    towards = a + rng.uniform(-0.6, 0.6, (count, 1)) * (a - eye) / 3
    return soup(
        np.stack([a, np.where(rng.random((count, 1)) < 0.7, towards, b), a + 0.5 * (b - a) + thin], 1)
    )


def stacks(rng: np.random.Generator) -> Mesh:
    """Triangles in a few planes, repeated, with some of no area."""
    corners = rng.integers(-3, 4, (60, 3, 3)).astype(float)
    corners[:20, :, 2] = rng.integers(-1, 2, (20, 1))
    corners[20:30, 2] = (corners[20:30, 0] + corners[20:30, 1]) / 2
    return soup(np.concatenate([corners, corners[10:40][:, [1, 2, 0]], corners[5:15]]))


def meshes() -> dict[str, Mesh]:
    rng = np.random.default_rng(5)
    sizes = 10.0 ** rng.uniform(-6, 0, (300, 1, 1))
    ball = procedural.icosphere(2)
    return {
        "ball": ball,
        "torus": torus(),
        "lattice_box": lattice_box(),
        "needle_fan": needle_fan(),
        "terrain": procedural.terrain(16),
        "stacks": stacks(rng),
        "edge_on_slivers": edge_on_slivers(rng),
        "soup": soup(rng.uniform(-1, 1, (300, 1, 3)) + sizes * rng.normal(size=(300, 3, 3))),
        "flat": soup(rng.integers(-4, 5, (60, 3, 3)) * (1.0, 1.0, 0.0)),
        "line": soup(rng.integers(-4, 5, (20, 3, 1)) * np.array([1.0, 0.5, -0.25])),
        "one": soup(np.eye(3)[None]),
        "far_float32": moved(ball, 1e7, np.float32),
        "far_float64": moved(ball, 1e9, np.float64),
        "times_2^60": scaled(ball, 2.0**60),
        "times_2^-60": scaled(ball, 2.0**-60),
        "times_1e20": scaled(ball, 1e20),
        "times_1e-20": scaled(ball, 1e-20),
        "times_1e30": scaled(ball, 1e30),
        "times_1e-30": scaled(ball, 1e-30),
        "float64_times_1e100": scaled(ball, 1e100, np.float64),
    }  # fmt: skip


MESHES = meshes()
CLOSED = [
    name for name in MESHES if name.startswith(("ball", "far", "times", "float64", "lattice", "needle"))
]
