"""Families of rays that find what is wrong with a grid or a triangle test; all in scene units, float64."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from hypothesis import strategies as st

from clgrid.frame import LocalFrame
from clgrid.layouts.planes import plane_params
from clgrid.mesh import Mesh

F64 = npt.NDArray[np.float64]
Rays = tuple[F64, F64]

NEARLY_ZERO = (0.0, -0.0, 5e-324, -5e-324, 1e-310, 1e-46, -1e-40, 1e-30, 1e-16, -1e-16, 1e-8)
"""Components that are zero or as good as: signed zeros, denormals of both precisions, rounding dust."""


@dataclass(frozen=True)
class Surroundings:
    """What the families aim at."""

    corners: F64
    """(F, 3, 3) triangle corners."""
    low: F64
    high: F64
    planes: tuple[F64, F64, F64]
    """Scene coordinates of the grid's planes on each axis."""

    @property
    def diagonal(self) -> float:
        return float(np.linalg.norm(self.high - self.low)) or 1.0

    @property
    def centre(self) -> F64:
        return (self.low + self.high) / 2


def surroundings(mesh: Mesh, resolution: tuple[int, int, int]) -> Surroundings:
    """Of a mesh, whose diagonal's square must be a double, and the grid of that resolution over it."""
    frame = LocalFrame.of_bounds(mesh.bounds)
    params = plane_params(frame.to_local(mesh.bounds).astype(np.float64), resolution, mesh.triangle_count)
    planes = []
    for axis in range(3):
        local = params["lower"][axis] + np.arange(resolution[axis] + 1) * params["cell_size"][axis]
        planes.append(frame.offset[axis] + local * 2.0**frame.exponent)
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    return Surroundings(corners, mesh.bounds[0], mesh.bounds[1], (planes[0], planes[1], planes[2]))


def _vertices(around: Surroundings, count: int, rng: np.random.Generator) -> F64:
    return around.corners[rng.integers(len(around.corners), size=count), rng.integers(3, size=count)]


def _edge_points(around: Surroundings, count: int, rng: np.random.Generator) -> F64:
    face, first = rng.integers(len(around.corners), size=count), rng.integers(3, size=count)
    a, b = around.corners[face, first], around.corners[face, (first + 1) % 3]
    s = rng.choice([0.5, 0.25, -1.0], size=count)
    s = np.where(s < 0, rng.random(count), s)[:, None]
    return (1 - s) * a + s * b


def _outside(around: Surroundings, count: int, rng: np.random.Generator, diagonals: float) -> F64:
    way = rng.normal(size=(count, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    return around.centre + diagonals * around.diagonal * way


def _inside(around: Surroundings, count: int, rng: np.random.Generator) -> F64:
    return around.low + rng.random((count, 3)) * (around.high - around.low)


def _axis_directions(count: int, rng: np.random.Generator) -> F64:
    """The 26 axis and diagonal directions, zeros replaced by zeros of all kinds."""
    signs = np.array([d for d in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(d)])
    direction = signs[rng.integers(len(signs), size=count)]
    return np.where(direction == 0, rng.choice(NEARLY_ZERO, size=(count, 3)), direction)


def random(around: Surroundings, count: int, rng: np.random.Generator) -> Rays:
    """Anywhere around, in any direction of any length."""
    origins = around.centre + rng.uniform(-1.5, 1.5, (count, 3)) * around.diagonal
    return origins, rng.normal(size=(count, 3)) * 10.0 ** rng.uniform(-6, 6, (count, 1))


def at_vertices(around: Surroundings, count: int, rng: np.random.Generator) -> Rays:
    """From outside, at vertices."""
    origins = _outside(around, count, rng, 1.2)
    return origins, _vertices(around, count, rng) - origins


def at_edges(around: Surroundings, count: int, rng: np.random.Generator) -> Rays:
    """From outside, at points of edges."""
    origins = _outside(around, count, rng, 1.2)
    return origins, _edge_points(around, count, rng) - origins


def along_axes(around: Surroundings, count: int, rng: np.random.Generator) -> Rays:
    """Along axes and diagonals, with zeros of all kinds, from anywhere."""
    directions = _axis_directions(count, rng)
    back = rng.uniform(0, 2, (count, 1)) * around.diagonal * np.sign(np.round(directions))
    return _inside(around, count, rng) - back, directions


def axes_through_vertices(around: Surroundings, count: int, rng: np.random.Generator) -> Rays:
    """Along axes and diagonals, exactly through vertices where these are axis-parallel."""
    directions = _axis_directions(count, rng)
    exact = np.sign(np.round(directions))
    # A power of two, so that origin + t * direction meets the vertex where the floats allow it.
    step = 2.0 ** np.ceil(np.log2(around.diagonal))
    return _vertices(around, count, rng) - step * exact, directions


def in_grid_planes(around: Surroundings, count: int, rng: np.random.Generator) -> Rays:
    """Lying in planes of the grid."""
    origins, directions = _outside(around, count, rng, 0.8), rng.normal(size=(count, 3))
    directions = _edge_points(around, count, rng) - origins
    axis = rng.integers(3, size=count)
    for a in range(3):
        rows = axis == a
        origins[rows, a] = rng.choice(around.planes[a], size=int(rows.sum()))
        directions[rows, a] = rng.choice((0.0, -0.0), size=int(rows.sum()))
    return origins, directions


def along_cell_edges(around: Surroundings, count: int, rng: np.random.Generator) -> Rays:
    """Along the edges of cells; some off by a rounding."""
    origins, directions = np.empty((count, 3)), rng.choice(NEARLY_ZERO[:6], size=(count, 3))
    along = rng.integers(3, size=count)
    for a in range(3):
        origins[:, a] = rng.choice(around.planes[a], size=count)
        rows = along == a
        sign = rng.choice((-1.0, 1.0), size=int(rows.sum()))
        directions[rows, a] = sign
        origins[rows, a] = around.centre[a] - sign * around.diagonal * rng.random(len(sign))
    nudged = np.nextafter(origins, rng.choice((-np.inf, np.inf), size=(count, 3)))
    return np.where(rng.random((count, 3)) < 0.25, nudged, origins), directions


def through_cell_corners(around: Surroundings, count: int, rng: np.random.Generator) -> Rays:
    """From corners of cells to corners of cells."""
    ends = np.stack(
        [[rng.choice(around.planes[a], size=count) for a in range(3)] for _ in range(2)], axis=0
    ).transpose(0, 2, 1)
    away = ends[1] - ends[0]
    away[(away == 0).all(axis=1)] = (1.0, -0.0, 0.0)
    return ends[0] - away, away


def from_100_diagonals(around: Surroundings, count: int, rng: np.random.Generator) -> Rays:
    """From 100 diagonals away, at vertices and edges."""
    origins = _outside(around, count, rng, 100.0)
    targets = np.where(
        rng.random((count, 1)) < 0.5, _vertices(around, count, rng), _edge_points(around, count, rng)
    )
    return origins, targets - origins


def from_1e6_diagonals(around: Surroundings, count: int, rng: np.random.Generator) -> Rays:
    """From a million diagonals away, at edges."""
    origins = _outside(around, count, rng, 1e6)
    return origins, _edge_points(around, count, rng) - origins


def from_inside(around: Surroundings, count: int, rng: np.random.Generator) -> Rays:
    """From within the bounds, at vertices and edges."""
    origins = _inside(around, count, rng)
    targets = np.where(
        rng.random((count, 1)) < 0.5, _vertices(around, count, rng), _edge_points(around, count, rng)
    )
    return origins, targets - origins


def from_surface(around: Surroundings, count: int, rng: np.random.Generator) -> Rays:
    """From points of the surface, where t = 0 is a hit or not by a rounding."""
    origins = _edge_points(around, count, rng)
    return origins, rng.normal(size=(count, 3))


def grazing(around: Surroundings, count: int, rng: np.random.Generator) -> Rays:
    """Nearly within the plane of a triangle: along an edge, off by a few roundings of the mesh's size."""
    face = rng.integers(len(around.corners), size=count)
    a, b, c = (around.corners[face, i] for i in range(3))
    point = a + rng.random((count, 1)) * (b - a)
    along = (b - a) + rng.choice((0.0, 0.5, 1.0), size=(count, 1)) * (c - a)
    along[(along == 0).all(axis=1)] = (0.0, 1.0, 0.0)
    along *= around.diagonal / np.linalg.norm(along, axis=1, keepdims=True)
    off = rng.choice((0.0, 1e-9, 6e-8, 1e-6), size=(count, 1)) * around.diagonal * rng.normal(size=(count, 3))
    tilt = (
        rng.choice((0.0, 1e-9, 6e-8, 1e-6), size=(count, 1)) * around.diagonal * rng.normal(size=(count, 3))
    )
    return point - 0.7 * along + off, along + tilt


FAMILIES: dict[str, Callable[[Surroundings, int, np.random.Generator], Rays]] = {
    family.__name__: family
    for family in (
        random, at_vertices, at_edges, along_axes, axes_through_vertices, in_grid_planes, along_cell_edges,
        through_cell_corners, from_100_diagonals, from_1e6_diagonals, from_inside, from_surface, grazing,
    )
}  # fmt: skip


def mixed(mesh: Mesh, resolution: tuple[int, int, int], count: int, seed: int = 0) -> Rays:
    """About ``count`` rays, split evenly over all families."""
    around = surroundings(mesh, resolution)
    share = -(-count // len(FAMILIES))
    parts = [
        family(around, share, np.random.default_rng([seed, number]))
        for number, family in enumerate(FAMILIES.values())
    ]
    return np.concatenate([o for o, _ in parts]), np.concatenate([d for _, d in parts])


lattice_values = st.sampled_from([-1.0, -0.75, -0.5, -0.25, 0.0, 0.25, 0.5, 0.75, 1.0])
lattice_points = st.tuples(lattice_values, lattice_values, lattice_values)


@st.composite
def lattice_meshes(draw: st.DrawFn) -> Mesh:
    """Small meshes on a coarse lattice: duplicates, coplanar stacks, degenerate triangles, shared edges."""
    vertices = draw(st.lists(lattice_points, min_size=3, max_size=12))
    index = st.integers(0, len(vertices) - 1)
    faces = draw(st.lists(st.tuples(index, index, index), min_size=1, max_size=20))
    scale = 2.0 ** draw(st.integers(-3, 3))
    return Mesh(np.array(vertices, np.float32) * np.float32(scale), np.array(faces, np.uint32))


@st.composite
def lattice_rays(draw: st.DrawFn, scale: float = 1.0) -> Rays:
    """Rays from lattice point to lattice point (or along an axis), some off by a denormal."""
    starts = draw(st.lists(lattice_points, min_size=1, max_size=24))
    origins = np.array(starts) * scale * draw(st.sampled_from([1.0, 2.0, 3.0, 150.0]))
    ends = np.array([draw(lattice_points) for _ in starts]) * scale
    directions = ends - origins
    zero = (directions == 0).all(axis=1)
    directions[zero] = draw(st.sampled_from([(1.0, 0.0, -0.0), (0.0, -1.0, 0.0), (-0.0, 0.0, 1.0)]))
    dust = draw(st.sampled_from(NEARLY_ZERO[:6]))
    return origins, np.where(directions == 0, dust, directions)
