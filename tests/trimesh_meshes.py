"""Meshes of trimesh, intersectors of them, and where rays meet them in exact arithmetic."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from clgrid.device import Device
from clgrid.mesh import Mesh
from clgrid.trimesh import RayMeshIntersector

trimesh = pytest.importorskip("trimesh")

Points = npt.NDArray[np.float64]


def theirs(mesh: Mesh) -> Any:
    return trimesh.Trimesh(mesh.vertices.astype(np.float64), mesh.faces.astype(np.int64), process=False)


def intersector(mesh: Any, device: Device, **options: Any) -> RayMeshIntersector:
    return RayMeshIntersector(theirs(mesh) if isinstance(mesh, Mesh) else mesh, device=device, **options)


def around(mesh: Any, count: int, seed: int) -> tuple[Points, Points]:
    """Rays from around a mesh to points within its bounds: in general position."""
    rng = np.random.default_rng(seed)
    low, high = mesh.bounds
    starts = rng.uniform(low - (high - low), high + (high - low), (count, 3))
    return starts, rng.uniform(low, high, (count, 3)) - starts


def bumpy() -> Any:
    ball = trimesh.creation.icosphere(subdivisions=3)
    shape = 1 + 0.4 * np.sin(7 * ball.vertices).sum(axis=1)
    ball.vertices *= shape[:, None]
    return ball


def places(mesh: Any, origin: Points, direction: Points) -> list[Fraction]:
    """Exact t at which the ray meets closed triangles, each once."""
    o, d = ([Fraction(float(x)) for x in side] for side in (origin, direction))
    found = set()
    for corners in mesh.vertices[mesh.faces]:
        points = [[Fraction(float(x)) - y for x, y in zip(corner, o, strict=True)] for corner in corners]
        sides = [det(d, points[i], points[(i + 1) % 3]) for i in range(3)]
        edges = [[x - y for x, y in zip(points[i], points[0], strict=True)] for i in (1, 2)]
        slope = det(d, *edges)
        if slope and (min(sides) >= 0 or max(sides) <= 0):
            found.add(det(points[0], *edges) / slope)
    return sorted(t for t in found if t >= 0)


def det(a: Any, b: Any, c: Any) -> Fraction:
    return sum(
        (a[i] * (b[(i + 1) % 3] * c[(i + 2) % 3] - b[(i + 2) % 3] * c[(i + 1) % 3]) for i in range(3)),
        Fraction(0),
    )


def by_ray(rays: Any, values: Any, count: int) -> list[list[Any]]:
    lists: list[list[Any]] = [[] for _ in range(count)]
    for ray, value in zip(rays.tolist(), values.tolist(), strict=True):
        lists[ray].append(value)
    return lists
