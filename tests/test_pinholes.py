"""Tiles of rays from one point, whose triangles are chosen by their edges (cl/pinhole.h), change no bit."""

from __future__ import annotations

import itertools

import numpy as np
import numpy.typing as npt
import pytest
from agreement import Query
from bundles import TILE, assert_brute, shaped, tiles_as_given
from meshes import MESHES, soup

from clgrid.device import Device
from clgrid.hits import Hits
from clgrid.mesh import Mesh

F64 = npt.NDArray[np.float64]
# Few cells: enough triangles are tested together for their edges to be looked at.
GRID = {"resolution": (2, 2, 2)}


def spokes(count: int, rng: np.random.Generator) -> Mesh:
    """Long triangles around a vertex, each sharing edges with the next, across the box."""
    angle = np.sort(rng.uniform(0, 2 * np.pi, count))
    rim = np.stack([np.cos(angle), np.sin(angle), rng.uniform(-1, 1, count)], axis=-1)
    rim /= np.abs(rim).max(axis=1, keepdims=True)
    hub = rng.uniform(-0.5, 0.5, (1, 3))
    i = np.arange(count)
    faces = np.stack([np.zeros(count, int), 1 + i, 1 + (i + 1) % count], axis=-1)
    return Mesh(np.concatenate([hub, rim]).astype(np.float32), faces.astype(np.uint32))


def large_soup(count: int, rng: np.random.Generator) -> Mesh:
    """Between few points, so that edges and corners are shared by many."""
    points = rng.uniform(-1, 1, (8, 3))
    return soup(points[np.array([rng.choice(8, 3, replace=False) for _ in range(count)])])


def room(rng: np.random.Generator) -> Mesh:
    """A box seen from within, each side as strips whose diagonals are long."""
    del rng
    cuts = np.linspace(-1, 1, 9)
    strips = []
    for axis in range(3):
        for side in (-1.0, 1.0):
            for low, high in itertools.pairwise(cuts):
                flat = np.array([[low, -1], [high, -1], [high, 1], [low, 1]])
                corners = np.insert(flat, axis, side, axis=1)
                strips += [corners[[0, 1, 2]], corners[[0, 2, 3]]]
    return soup(np.array(strips))


KINDS = {"spokes": lambda rng: spokes(24, rng), "soup": lambda rng: large_soup(40, rng), "room": room}


def aims(mesh: Mesh, count: int, rng: np.random.Generator) -> F64:
    """Vertices, points of edges, and points of triangles."""
    corners = mesh.vertices[mesh.faces[rng.integers(mesh.triangle_count, size=count)]].astype(np.float64)
    weights = rng.dirichlet([1, 1, 1], count)
    weights[: count // 2, 2] = 0
    weights[: count // 8, 1] = 0
    weights /= weights.sum(axis=1, keepdims=True)
    return np.asarray((weights[:, :, None] * corners).sum(axis=1))


def pinholes(mesh: Mesh, count: int, rng: np.random.Generator, reach: float = 1.9) -> Query:
    """Tiles whose rays share an origin and pass a point by nothing, by roundings or by more."""
    eyes = rng.uniform(-reach, reach, (count, 1, 3)).astype(np.float32).astype(np.float64)
    ways = aims(mesh, count, rng)[:, None, :] - eyes
    width = rng.choice([0.0, 2.0**-24, 2.0**-23, 2.0**-20, 2.0**-12, 2.0**-5], size=(count, 1, 1))
    ways = ways * (1 + width * rng.uniform(-1, 1, (count, TILE, 3)))
    return shaped(np.tile(eyes, (1, TILE, 1)).reshape(-1, 3), ways.reshape(-1, 3), -np.inf)


def assert_tiles(mesh: Mesh, device: Device, rays: Query) -> Hits:
    with pytest.MonkeyPatch.context() as patch, tiles_as_given(patch):
        return assert_brute(mesh, device, "robust", rays, [GRID])


@pytest.mark.parametrize("kind", KINDS)
def test_edges_and_vertices_seen_from_a_point(kind: str, device: Device) -> None:
    """Fails if what counts as outside an edge, or beside a corner, is not beyond what rounding does."""
    rng = np.random.default_rng(51)
    for _ in range(4):
        mesh = KINDS[kind](rng)
        assert assert_tiles(mesh, device, pinholes(mesh, 500, rng)).mask.mean() > 0.5


@pytest.mark.parametrize("axis", range(3))
def test_triangles_seen_edge_on(axis: int, device: Device) -> None:
    """From a point in their planes, or off them by roundings: on which side is not sure."""
    rng = np.random.default_rng([52, axis])
    mesh = room(rng)
    o, d, low, high = (side.reshape(-1, TILE, *side.shape[1:]) for side in pinholes(mesh, 300, rng))
    off = rng.choice([0.0, 2.0**-24, 2.0**-22, 2.0**-18], size=len(o))
    o[:, :, axis] = (rng.choice([-1, 1], len(o)) * (1 - off))[:, None]
    d[:, :, axis] *= rng.choice([0.0, 2.0**-24, 2.0**-20, 2.0**-10], size=(len(o), 1))
    assert_tiles(mesh, device, (o.reshape(-1, 3), d.reshape(-1, 3), low.reshape(-1), high.reshape(-1)))


@pytest.mark.parametrize("kind", KINDS)
def test_common_and_nearly_common_origins(kind: str, device: Device) -> None:
    """Of a tile's rays, one or some or all start a rounding or more beside the others, or behind."""
    rng = np.random.default_rng(53)
    mesh = KINDS[kind](rng)
    o, d, low, high = (side.reshape(-1, TILE, *side.shape[1:]) for side in pinholes(mesh, 600, rng))
    for number in range(len(o)):
        some = rng.choice(TILE, size=rng.choice([1, 8, 63, 64]), replace=False)
        axis, off = rng.integers(3), rng.choice([2.0**-24, 2.0**-23, 2.0**-20, 2.0**-10, 0.1])
        if number % 3 == 0:
            o[number, some, axis] *= 1 + off
        elif number % 3 == 1:  # along the rays: the lines still share a point
            o[number, some] -= off * d[number, some]
        else:
            o[number, :, axis] = 0.0
            o[number, some, axis] = -0.0
    rays = (o.reshape(-1, 3), d.reshape(-1, 3), low.reshape(-1), high.reshape(-1))
    assert assert_tiles(mesh, device, rays).mask.mean() > 0.4


@pytest.mark.parametrize("name", ["soup", "needle_fan", "stacks", "lattice_box"])
def test_points_near_and_far(name: str, device: Device) -> None:
    """From within ``START_LIMIT``, where rays keep their common origin, and beyond, where they are moved."""
    rng = np.random.default_rng(54)
    mesh = MESHES[name]
    centre, size = mesh.bounds.mean(axis=0), float((mesh.bounds[1] - mesh.bounds[0]).max())
    for reach in (0.6, 1.2, 5.0, 1e4):
        o, d, low, high = pinholes(mesh, 100, rng, 0.0)
        eyes = np.repeat(centre + rng.uniform(-reach, reach, (100, 3)) * size, TILE, axis=0)
        assert_tiles(mesh, device, (eyes, d + o - eyes, low, high))
