"""Rays that go where ray casters go wrong: at vertices and edges, along planes, from afar, from inside.

In scene units and float64. An origin has few digits where it may, so that the difference to what it is aimed
at is a double, and the ray goes exactly there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgrid.frame import LocalFrame
from clgrid.layouts.planes import plane_params
from clgrid.mesh import Mesh

F64 = npt.NDArray[np.float64]
Rays = tuple[F64, F64]

_DUST = (0.0, -0.0, 5e-324, -1e-310, 1e-46, -1e-30, 1e-16, -1e-16)
# Points are kept this far inside, in sizes of the mesh. The rung robust rounds mesh and ray to float32, and
# its t may be off by T_SLACK: 2**-19 of a local unit, which is at most four sizes.
_CLEARANCE = 2.0**-15
_CANDIDATES, _ATTEMPTS = 4096, 6


@dataclass(frozen=True)
class Aim:
    """A mesh that has triangles, and the grid over it, as rays are aimed at them.

    Attributes
    ----------
    mesh : Mesh
    low, high : (3,) float64
        Bounds.
    size : float
        The largest extent; 1 for a point.
    planes : three (M + 1,) float64
        Where the grid's planes are on each axis.
    """

    mesh: Mesh
    low: F64
    high: F64
    size: float
    planes: tuple[F64, F64, F64]

    @classmethod
    def at(cls, mesh: Mesh, resolution: tuple[int, int, int]) -> Aim:
        """At a mesh and the grid of this resolution over all of it."""
        frame = LocalFrame.of_bounds(mesh.bounds)
        local = frame.to_local(mesh.bounds).astype(np.float64)
        params = plane_params(local, resolution, mesh.triangle_count)
        x, y, z = (
            frame.offset[a]
            + np.ldexp(params["lower"][a] + np.arange(cells + 1) * params["cell_size"][a], frame.exponent)
            for a, cells in enumerate(resolution)
        )
        low, high = mesh.bounds
        return cls(mesh, low, high, float((high - low).max()) or 1.0, (x, y, z))

    def corners(self, count: int, rng: np.random.Generator) -> tuple[F64, F64, F64]:
        """Corners a, b, c, (N, 3) each, of random triangles, beginning with any."""
        faces = self.mesh.faces[rng.integers(self.mesh.triangle_count, size=count)]
        first = rng.integers(3, size=count)
        a, b, c = (
            self.mesh.vertices[faces[np.arange(count), (first + k) % 3]].astype(np.float64) for k in range(3)
        )
        return a, b, c

    def anywhere(self, count: int, rng: np.random.Generator) -> F64:
        """(N, 3) points in the bounds."""
        points: F64 = self.low + _short(rng.random((count, 3)) * (self.high - self.low))
        return points

    def away(self, count: int, rng: np.random.Generator, low: float, high: float) -> F64:
        """(N, 3) points 10**low to 10**high sizes from the middle."""
        way = rng.normal(size=(count, 3))
        way /= np.linalg.norm(way, axis=1, keepdims=True)
        middle = self.low + (self.high - self.low) / 2
        points: F64 = middle + _short(self.size * 10.0 ** rng.uniform(low, high, (count, 1)) * way)
        return points

    def targets(self, count: int, rng: np.random.Generator) -> F64:
        """(N, 3) vertices, points of edges and points of faces."""
        a, b, c = self.corners(count, rng)
        s = rng.random((count, 1))
        choices = [a, a, a / 2 + b / 2, (1 - s) * a + s * b, a / 2 + b / 4 + c / 4]
        points: F64 = np.choose(rng.integers(len(choices), size=(count, 1)), choices)
        return points

    def on_planes(self, count: int, rng: np.random.Generator) -> F64:
        """(N, 3) corners of cells."""
        return np.stack([rng.choice(planes, size=count) for planes in self.planes], axis=-1)


def _short(values: F64) -> F64:
    """The values rounded to 24 binary digits."""
    share, exponent = np.frexp(values)
    rounded: F64 = np.ldexp(np.round(np.ldexp(share, 24)), exponent - 24)
    return rounded


def _axis_ways(count: int, rng: np.random.Generator) -> tuple[F64, F64]:
    """(N, 3) directions along axes and diagonals, and the same with zeros of all kinds."""
    way = rng.choice((-1.0, 0.0, 0.0, 1.0), size=(count, 3))
    none = ~(way != 0).any(axis=1)
    way[none, rng.integers(3, size=int(none.sum()))] = 1.0
    return way, np.where(way == 0, rng.choice(_DUST, size=way.shape), way)


def _vertices(aim: Aim, count: int, rng: np.random.Generator) -> Rays:
    origins = aim.away(count, rng, -1, 0.5)
    return origins, aim.corners(count, rng)[0] - origins


def _edges(aim: Aim, count: int, rng: np.random.Generator) -> Rays:
    origins, (a, b, _) = aim.away(count, rng, -1, 0.5), aim.corners(count, rng)
    s = np.where(rng.random((count, 1)) < 0.5, 0.5, rng.random((count, 1)))
    return origins, (1 - s) * a + s * b - origins


def _faces(aim: Aim, count: int, rng: np.random.Generator) -> Rays:
    origins, (a, b, c) = aim.away(count, rng, -1, 0.5), aim.corners(count, rng)
    return origins, (a / 2 + b / 4) + c / 4 - origins


def _along_edges(aim: Aim, count: int, rng: np.random.Generator) -> Rays:
    a, b, _ = aim.corners(count, rng)
    return a - rng.choice((-2.0, -0.5, 0.0, 1.0, 16.0), size=(count, 1)) * (b - a), b - a


def _in_faces(aim: Aim, count: int, rng: np.random.Generator) -> Rays:
    a, b, c = aim.corners(count, rng)
    steps = rng.integers(-2, 3, (count, 2)).astype(np.float64)
    way = steps[:, :1] * (b - a) + steps[:, 1:] * (c - a)
    return b / 2 + c / 2 - rng.choice((0.0, 0.5, 4.0), size=(count, 1)) * way, way


def _from_surface(aim: Aim, count: int, rng: np.random.Generator) -> Rays:
    origins = aim.targets(count, rng)
    return origins, aim.targets(count, rng) - origins


def _axes(aim: Aim, count: int, rng: np.random.Generator) -> Rays:
    way, dusty = _axis_ways(count, rng)
    # A power of two, so that the other coordinates stay what they are.
    step = 2.0 ** np.ceil(np.log2(aim.size))
    origins = aim.targets(count, rng) - rng.choice((0.0, 1.0, 1.0), size=(count, 1)) * step * way
    return origins, dusty


def _grid_planes(aim: Aim, count: int, rng: np.random.Generator) -> Rays:
    origins = aim.away(count, rng, -0.5, 0.2)
    ways = aim.targets(count, rng) - origins
    rows, axis = np.arange(count), rng.integers(3, size=count)
    origins[rows, axis] = aim.on_planes(count, rng)[rows, axis]
    ways[rows, axis] = rng.choice((0.0, -0.0), size=count)
    return origins, ways


def _cell_edges(aim: Aim, count: int, rng: np.random.Generator) -> Rays:
    origins, ways = aim.on_planes(count, rng), rng.choice(_DUST, size=(count, 3))
    rows, axis = np.arange(count), rng.integers(3, size=count)
    sign = rng.choice((-1.0, 1.0), size=count)
    ways[rows, axis] = sign
    origins[rows, axis] = aim.anywhere(count, rng)[rows, axis] - sign * aim.size
    near = np.nextafter(origins, rng.choice((-np.inf, np.inf), size=origins.shape))
    return np.where(rng.random((count, 1)) < 0.25, near, origins), ways


def _cell_corners(aim: Aim, count: int, rng: np.random.Generator) -> Rays:
    start = aim.on_planes(count, rng)
    ways = aim.on_planes(count, rng) - start
    return start - ways, ways


def _far(aim: Aim, count: int, rng: np.random.Generator) -> Rays:
    origins = aim.away(count, rng, 2, 6)
    return origins, aim.targets(count, rng) - origins


def _random(aim: Aim, count: int, rng: np.random.Generator) -> Rays:
    origins = aim.away(count, rng, -1, 0.5)
    return origins, rng.normal(size=(count, 3)) * 10.0 ** rng.uniform(-30, 30, (count, 1))


FAMILIES: dict[str, Callable[[Aim, int, np.random.Generator], Rays]] = {
    "at vertices": _vertices,
    "at edges": _edges,
    "at faces": _faces,
    "along edges": _along_edges,
    "within faces": _in_faces,
    "from the surface": _from_surface,
    "along axes": _axes,
    "in planes of the grid": _grid_planes,
    "along edges of cells": _cell_edges,
    "at corners of cells": _cell_corners,
    "from afar": _far,
    "at random": _random,
}
INSIDE = "from inside"


@dataclass(frozen=True)
class Batch:
    """Rays of all kinds.

    Attributes
    ----------
    origins, directions : (N, 3) float64
    kinds : (N,) of indices into ``KINDS``
    """

    origins: F64
    directions: F64
    kinds: npt.NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.origins)

    @property
    def inside(self) -> npt.NDArray[np.bool_]:
        """(N,): whether the ray starts inside of a closed mesh."""
        inside: npt.NDArray[np.bool_] = self.kinds == KINDS.index(INSIDE)
        return inside


KINDS = (*FAMILIES, INSIDE)
_INSIDE_SHARE = 0.25


def structured(aim: Aim, count: int, points: F64, seed: tuple[int, ...]) -> Batch:
    """``count`` rays in random order: a quarter from the points, if there are any, the rest of all families.

    Parameters
    ----------
    aim : Aim
    count : int
    points : (P, 3) float64
        Inside of the mesh.
    seed : tuple of int
        The same seed makes the same rays.
    """
    rng = np.random.default_rng(seed)
    inside = round(count * _INSIDE_SHARE) if len(points) else 0
    ends = np.linspace(0, count - inside, len(FAMILIES) + 1).astype(np.int64)
    sizes = [*np.diff(ends).tolist(), inside]
    parts = [family(aim, size, rng) for family, size in zip(FAMILIES.values(), sizes, strict=False)]
    parts.append(_from_inside(aim, points, inside, rng))
    origins, directions = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    lost = ~(directions != 0).any(axis=1)
    directions[lost] = rng.normal(size=(int(lost.sum()), 3))
    kinds, order = np.repeat(np.arange(len(KINDS)), sizes), rng.permutation(count)
    return Batch(origins[order], directions[order], kinds[order])


def _from_inside(aim: Aim, points: F64, count: int, rng: np.random.Generator) -> Rays:
    """At vertices, edges and faces above all; along axes, and anywhere."""
    if not count:
        return np.zeros((0, 3)), np.zeros((0, 3))
    origins = points[rng.integers(len(points), size=count)]
    aimed = aim.targets(count, rng) - origins
    kind = np.maximum(rng.integers(8, size=(count, 1)) - 5, 0)
    return origins, np.choose(kind, [aimed, _axis_ways(count, rng)[1], rng.normal(size=(count, 3))])


def inside_points(
    aim: Aim,
    contains: Callable[[F64], npt.NDArray[np.bool_]],
    distances: Callable[[F64, F64], F64],
    seed: tuple[int, ...],
    wanted: int = 1024,
) -> F64:
    """(P, 3) points well inside of a closed mesh, at most ``wanted``; none where they are hard to find.

    Parameters
    ----------
    aim : Aim
    contains : callable
        Whether each point, (N, 3), is inside.
    distances : callable
        t of the nearest hit of each ray, inf on a miss: no point is taken from which one of 26 rays around
        hits within 2**-15 sizes of the mesh.
    seed : tuple of int
    wanted : int
    """
    rng = np.random.default_rng(seed)
    around = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3, indexing="ij"), -1).reshape(-1, 3)
    around = around[(around != 0).any(axis=1)] * aim.size
    found, count = [np.zeros((0, 3))], 0
    for _ in range(_ATTEMPTS):
        points = _candidates(aim, rng)
        points = points[contains(points)][:wanted]
        at = np.repeat(points, len(around), axis=0), np.tile(around, (len(points), 1))
        clear = (distances(*at).reshape(-1, len(around)) > _CLEARANCE).all(axis=1)
        found.append(points[clear])
        count += int(clear.sum())
        if count >= wanted:
            break
    return np.concatenate(found)[:wanted]


def _candidates(aim: Aim, rng: np.random.Generator) -> F64:
    """Half anywhere in the bounds; half a little below the surface, where thin meshes have their inside."""
    a, b, c = aim.corners(_CANDIDATES // 2, rng)
    normal = np.cross((b - a) / aim.size, (c - a) / aim.size)
    with np.errstate(all="ignore"):
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    depth = aim.size * 10.0 ** rng.uniform(-5, -1, (len(a), 1))
    below = (a / 2 + b / 4) + c / 4 - depth * np.where(np.isfinite(normal), normal, 0.0)
    return np.concatenate([aim.anywhere(_CANDIDATES // 2, rng), below])
