"""Scenes that are crowded here and empty there, at which equal cells are bad; and rays at the crowds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from agreement import Query
from bundles import bundles
from meshes import edge_on_slivers, lattice_box, moved, scaled, soup
from rays import FAMILIES, Surroundings, mixed
from shapes import box, joined

from clgrid import procedural
from clgrid.frame import LocalFrame
from clgrid.layouts.nested import top_resolution
from clgrid.layouts.planes import plane_params
from clgrid.mesh import Mesh

F64 = npt.NDArray[np.float64]
Rays = tuple[F64, F64]
Resolution = tuple[int, int, int]

FINEST = 10
"""Halvings of a cell of the top grid that make the finest there can be, as in cl/config.h."""


def placed(mesh: Mesh, scale: float, at: npt.ArrayLike) -> Mesh:
    return Mesh((mesh.vertices.astype(np.float64) * scale + np.asarray(at)).astype(np.float32), mesh.faces)


def default_top(mesh: Mesh) -> Resolution:
    """Cells of the top grid where nothing else is asked for."""
    bounds = LocalFrame.of_bounds(mesh.bounds).to_local(mesh.bounds).astype(np.float64)
    return top_resolution(bounds[1] - bounds[0], mesh.triangle_count)


def plane_of(mesh: Mesh, resolution: Resolution, number: F64) -> F64:
    """Where planes of such (also broken) numbers are, in the scene."""
    frame = LocalFrame.of_bounds(mesh.bounds)
    params = plane_params(frame.to_local(mesh.bounds).astype(np.float64), resolution, 1)
    local = params["lower"] + number * params["cell_size"]
    return np.asarray(frame.offset + local * 2.0**frame.exponent)


HALL = box((-1, -1, -1), (1, 1, 1))


def teapot(at: npt.ArrayLike, level: int = 4, scale: float = 1 / 500) -> Mesh:
    """In a stadium."""
    return joined(HALL, placed(procedural.icosphere(level), scale, at))


def in_planes(resolution: Resolution, cells: float) -> Mesh:
    """A box of squares, of so many cells or parts of one: all its edges lie in planes of cells."""
    low = plane_of(HALL, resolution, np.array([resolution]) // 2)
    high = plane_of(HALL, resolution, np.array([resolution]) // 2 + cells)
    small = lattice_box(8)
    vertices = np.where(small.vertices == 1, high, low + (small.vertices + 1.0) / 2 * (high - low))
    return joined(HALL, Mesh(vertices.astype(np.float32), small.faces))


def clusters(rng: np.random.Generator, sizes: tuple[float, ...], each: int, triangles: int) -> Mesh:
    """Clusters of clusters of triangles."""
    points = np.zeros((1, 3))
    for size in sizes[:-1]:
        points = (points[:, None] + size * rng.uniform(-1, 1, (len(points), each, 3))).reshape(-1, 3)
    points = np.repeat(points, triangles, axis=0)
    return soup(points[:, None] + sizes[-1] * rng.normal(size=(len(points), 3, 3)))


def crowds(rng: np.random.Generator) -> dict[str, Mesh]:
    huge = rng.uniform(-1, 1, (60, 3, 3))
    tiny = rng.uniform(-1, 1, (1200, 1, 3)) + 1e-3 * rng.normal(size=(1200, 3, 3))
    dust = (
        np.array([0.31, -0.4, 0.57])
        + 1e-3 * rng.normal(size=(2000, 1, 3))
        + 2e-5 * rng.normal(size=(2000, 3, 3))
    )
    ends = np.array([[[-1.0] * 3] * 3, [[1.0] * 3] * 3])
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    in_corners = (corners[:, None] * (1 - 1e-3 * rng.random((8, 300, 3))))[:, :, None]
    needles = rng.uniform(-1, 1, (2, 30, 1, 3)) * np.array([1.0, 0.0, -1.0])[None, None, :, None]
    needles = needles[0] + np.array([0.31, -0.4, 0.57]) + 1e-5 * rng.normal(size=(30, 3, 3))
    return {
        "huge_and_tiny": soup(np.concatenate([huge, tiny, dust])),
        "dust_alone": soup(dust),
        "a_point": soup(np.concatenate([ends, np.full((200, 3, 3), 0.125)])),
        "copies": soup(np.concatenate([ends, np.tile(0.2 + 1e-3 * np.eye(3)[None], (200, 1, 1))])),
        "in_the_corners": soup((in_corners * (1 - 1e-4 * rng.random((8, 300, 3, 3)))).reshape(-1, 3, 3)),
        "needles_through_dust": soup(np.concatenate([dust, needles])),
        "flat": soup(np.concatenate([huge, dust[:400]]) * (1.0, 1.0, 0.0)),
        "line": soup(np.concatenate([huge[:5], dust[:200]])[:, :, :1] * np.array([1.0, 0.5, -0.25])),
    }  # fmt: skip


def meshes() -> dict[str, Mesh]:
    rng = np.random.default_rng(70)
    slivers, ball, bowl = edge_on_slivers(rng), teapot((0.3, -0.2, 0.1)), procedural.icosphere(3)
    return {
        "teapot": ball,
        "teapot_at_a_side": teapot((-1.0, 0.998, 0.0)),
        "teapot_on_planes": teapot(plane_of(HALL, (7, 4, 3), np.array([3.0, 1.0, 2.0]))),
        "two_teapots": joined(teapot((0.9, 0.9, 0.9), 4, 1 / 3000), placed(bowl, 0.05, (0, 0, 0))),
        "box_in_planes": in_planes((7, 4, 3), 1.0),
        "box_in_finer_planes": in_planes((7, 4, 3), 0.125),
        "clusters": clusters(rng, (1.0, 0.02, 4e-4, 2e-5), 5, 20),
        "thick_clusters": clusters(rng, (1.0, 0.1, 0.03), 6, 60),
        "slivers": joined(slivers, placed(slivers, 0.01, (0.4, 0, 0.4)), placed(bowl, 1e-3, (0, 0, 0.2))),
        "one": soup(np.eye(3)[None]),
        **crowds(rng),
        "far": moved(ball, 1e9, np.float64),
        "large": scaled(ball, 1e20),
        "small": scaled(ball, 1e-20),
    }  # fmt: skip


MESHES = meshes()
WITHOUT_AREA = ("a_point", "line")


@dataclass(frozen=True)
class Crowd:
    """Where many triangles are: a box around some of them."""

    low: F64
    high: F64


def crowd_of(mesh: Mesh) -> Crowd:
    """Around the middle half of the triangles, by the median of their corners."""
    points = mesh.vertices[mesh.faces[:, 0]].astype(np.float64)
    middle = np.median(points, axis=0)
    near = points[np.argsort(np.abs(points - middle).max(axis=1), kind="stable")[: max(1, len(points) // 2)]]
    return Crowd(near.min(axis=0), near.max(axis=0))


def close_up(mesh: Mesh, resolution: Resolution, crowd: Crowd) -> Surroundings:
    """What families of rays aim at to meet the crowd: planes of cells of all sizes there can be."""
    frame = LocalFrame.of_bounds(mesh.bounds)
    params = plane_params(frame.to_local(mesh.bounds).astype(np.float64), resolution, 1)
    size = params["cell_size"] * 2.0**frame.exponent
    lower = frame.offset + params["lower"] * 2.0**frame.exponent
    planes: list[F64] = []
    for axis in range(3):
        found: list[F64] = []
        for halvings in range(FINEST + 1):
            step = size[axis] / 2**halvings
            first = max(0, int((crowd.low[axis] - lower[axis]) / step))
            last = min(resolution[axis] << halvings, int((crowd.high[axis] - lower[axis]) / step) + 1)
            # As many of each size of cells; lower + (k * step) as the kernels' planes are.
            numbers = np.unique(np.linspace(first, max(first, last), 9).astype(np.int64))
            found.append(lower[axis] + numbers * step)
        planes.append(np.concatenate(found))
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    inside = ((corners >= crowd.low) & (corners <= crowd.high)).all(axis=(1, 2))
    own = corners[inside] if inside.any() else corners
    return Surroundings(own, crowd.low, crowd.high, (planes[0], planes[1], planes[2]))


def aimed(mesh: Mesh, resolution: Resolution, count: int, seed: int) -> Rays:
    """About ``count`` rays: a third of them around all of the mesh, the others at its crowd."""
    around = close_up(mesh, resolution, crowd_of(mesh))
    share = -(-2 * count // (3 * len(FAMILIES)))
    parts = [mixed(mesh, resolution, count // 3, seed)]
    for number, family in enumerate(FAMILIES.values()):
        parts.append(family(around, share, np.random.default_rng([seed, number, 7])))
    return np.concatenate([o for o, _ in parts]), np.concatenate([d for _, d in parts])


def tiles_at(mesh: Mesh, resolution: Resolution, count: int, seed: int) -> Query:
    """So many tiles at the crowd."""
    return bundles(close_up(mesh, resolution, crowd_of(mesh)), count, np.random.default_rng([seed, 71]))
