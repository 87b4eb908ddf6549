"""Tiles of 64 rays that strain what a tile assumes: beams of any width, aimed at what a grid is made of."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from agreement import Query, assert_same, fields_of
from rays import NEARLY_ZERO, Surroundings

from clgrid import cast
from clgrid.brute import brute_force, brute_force_count
from clgrid.camera import Camera
from clgrid.device import Device
from clgrid.grid import Grid, build
from clgrid.hits import Hits
from clgrid.mesh import Mesh
from clgrid.tiles import Division

F64 = npt.NDArray[np.float64]
Point = Callable[[Surroundings, np.random.Generator], F64]

TILE = 64
GRID: dict[str, Any] = {"resolution": (5, 4, 6)}
_U, _V = (side.reshape(-1, 1) for side in np.meshgrid(np.linspace(-1, 1, 8), np.linspace(-1, 1, 8)))


@contextmanager
def tiles_as_given(patch: pytest.MonkeyPatch, row: int = 0) -> Iterator[None]:
    """Each 64 rays in turn are a tile; or 8 x 8 of rows of ``row``: whatever the rays are like."""
    with patch.context() as inner:
        inner.setattr(cast, "division_of", lambda rays: Division(row))
        inner.setattr(cast, "_order", lambda target, part, rays: np.arange(len(rays[0]), dtype=np.uint64))
        yield


# --- points --------------------------------------------------------------------------------------------


def vertex(around: Surroundings, rng: np.random.Generator) -> F64:
    return np.array(around.corners[rng.integers(len(around.corners)), rng.integers(3)])


def edge_point(around: Surroundings, rng: np.random.Generator) -> F64:
    a, b, _ = rng.permutation(around.corners[rng.integers(len(around.corners))])
    return np.asarray(a + rng.choice([0.5, 0.25, rng.random()]) * (b - a))


def surface_point(around: Surroundings, rng: np.random.Generator) -> F64:
    return np.asarray(rng.dirichlet([1, 1, 1]) @ around.corners[rng.integers(len(around.corners))])


def cell_corner(around: Surroundings, rng: np.random.Generator) -> F64:
    return np.array([rng.choice(planes) for planes in around.planes])


def inside(around: Surroundings, rng: np.random.Generator) -> F64:
    return np.asarray(around.low + rng.random(3) * (around.high - around.low))


def on_bounds(around: Surroundings, rng: np.random.Generator) -> F64:
    """In a side of the mesh's bounds or of the grid's, or off it by a rounding or a little more."""
    point, axis, side = inside(around, rng), rng.integers(3), int(rng.integers(2))
    low, high = around.low[axis], around.high[axis]
    planes = around.planes[axis]
    point[axis] = rng.choice([(low, high)[side], planes[-side]])
    off = rng.choice([0.0, 2.0**-52, 2.0**-23, 2.0**-19, 2.0**-17, 2.0**-16, 2.0**-12])
    point[axis] += rng.choice([-1, 1]) * off * around.diagonal
    return point


def in_the_last_cell(around: Surroundings, rng: np.random.Generator) -> F64:
    point, axis = inside(around, rng), rng.integers(3)
    low, high = around.planes[axis][-2:]
    point[axis] = low + rng.choice([0.0, 0.5, rng.random()]) * (high - low)
    return point


def outside(around: Surroundings, rng: np.random.Generator) -> F64:
    """From beside the mesh to a million diagonals away."""
    way = rng.normal(size=3)
    far = rng.choice([0.7, 1.5, 3.0, 10.0 ** rng.uniform(0, 6)])
    return np.asarray(around.centre + far * around.diagonal * way / np.linalg.norm(way))


AIMS: tuple[Point, ...] = (
    vertex, edge_point, surface_point, cell_corner, inside, on_bounds, in_the_last_cell,
)  # fmt: skip
EYES: tuple[Point, ...] = (*AIMS, outside, outside, outside)


# --- directions ----------------------------------------------------------------------------------------


def _pick(points: tuple[Point, ...], around: Surroundings, rng: np.random.Generator) -> F64:
    return points[rng.integers(len(points))](around, rng)


def _strained(way: F64, rng: np.random.Generator) -> F64:
    """Some components as good as zero, or nearly parallel to the grid's sides, or on a diagonal."""
    kind, way = rng.integers(6), way.copy()
    longest = np.abs(way).max() or 1.0
    axis = rng.integers(3)
    if kind == 0:
        way[axis] = rng.choice(NEARLY_ZERO)
    elif kind == 1:
        keep = way[axis] or 1.0
        way = rng.choice(NEARLY_ZERO, size=3)
        way[axis] = keep
    elif kind == 2:
        way[axis] = rng.choice([-1, 1]) * 2.0 ** rng.uniform(-30, -14) * longest
    elif kind == 3:
        way = np.sign(way) * longest
    return way if way.any() else np.array([0.0, -0.0, -1.0])


def _across(way: F64, rng: np.random.Generator) -> tuple[F64, F64]:
    """Two unit vectors across a way: any, or along axes."""
    if rng.random() < 0.4:
        axis = int(np.abs(way).argmax())
        return np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
    unit = way / np.linalg.norm(way)
    one = np.cross(unit, rng.normal(size=3))
    one /= np.linalg.norm(one) or 1.0
    return one, np.cross(unit, one)


def _width(rng: np.random.Generator) -> float:
    """Of a beam: none, roundings, parts of a cell, many cells."""
    return float(
        rng.choice([0.0, 10.0 ** rng.uniform(-16, -5), 10.0 ** rng.uniform(-5, -1), rng.uniform(0.1, 2)])
    )


def tile(around: Surroundings, rng: np.random.Generator) -> tuple[F64, F64]:
    """Rays of a pinhole, parallel ones, or some that meet in a point."""
    aim, eye = _pick(AIMS, around, rng), _pick(EYES, around, rng)
    way = aim - eye
    if not way.any():
        way = rng.normal(size=3)
    way = way / np.abs(way).max() * around.diagonal
    kind = rng.integers(3)
    if rng.random() < 0.5:
        way = _strained(way, rng)
        eye = aim - rng.choice([0.0, 0.5, 1.0, 1.5, 4.0]) * way
    x, y = _across(way, rng)
    width = _width(rng)
    fan = _U * x + _V * y
    length = float(np.linalg.norm(way))
    if kind == 0:  # a pinhole
        return np.tile(eye, (TILE, 1)), way + width * length * fan
    if kind == 1:  # parallel
        return eye + width * around.diagonal * fan, np.tile(way, (TILE, 1))
    starts = eye + width * around.diagonal * fan  # towards a light
    return starts, aim - starts


def _disturbed(o: F64, d: F64, low: F64, high: F64, rng: np.random.Generator) -> None:
    """Some rays of a tile that are none, or go another way."""
    kind = rng.integers(8)
    some = rng.choice(TILE, size=rng.choice([1, 3, 11, 12, 52, 53]), replace=False)
    if kind == 0:
        d[some] = -d[some]
    elif kind == 1:
        d[some] = d[some][:, [1, 2, 0]]
    elif kind == 2:
        d[some] = 0.0
    elif kind == 3:
        o[some, rng.integers(3)] = rng.choice([np.nan, np.inf, -np.inf])
    elif kind == 4:
        d[some, rng.integers(3)] = rng.choice([np.nan, np.inf])
    elif kind == 5:
        low[some], high[some] = 1.0, -1.0
    elif kind == 6:
        d[some] *= 10.0 ** rng.uniform(-20, 20, (len(some), 1))
    elif kind == 7:
        low[some] = np.nan


def bundles(around: Surroundings, count: int, rng: np.random.Generator) -> Query:
    """So many tiles, one after another, with intervals of all kinds."""
    parts = []
    for _ in range(count):
        o, d = tile(around, rng)
        low, high = np.zeros(TILE), np.full(TILE, np.inf)
        kind = rng.integers(6)
        if kind == 0:
            low[:] = -np.inf
        elif kind == 1:
            low[:], high[:] = -np.inf, 0.0
        elif kind == 2:
            low[:] = rng.uniform(-1, 2)
            high[:] = low + rng.choice([0.0, 1e-9, 1e-3, 1.0])
        if rng.random() < 0.3:
            _disturbed(o, d, low, high, rng)
        parts.append((o, d, low, high))
    o, d, low, high = (np.concatenate(side) for side in zip(*parts, strict=True))
    return o, d, low, high


def around_hits(rays: Query, t_hit: F64, rng: np.random.Generator) -> Query:
    """The same rays with intervals that begin or end at hits, or next to them; some are reflected there."""
    o, d, low, high = (side.copy() for side in rays)
    rows = np.isfinite(t_hit)
    t = np.where(rows, t_hit, 1.0)
    kind = np.repeat(rng.integers(6, size=-(-len(t) // TILE)), TILE)[: len(t)]
    low = np.where(kind == 0, t, np.where(kind == 1, np.nextafter(t, np.inf), low))
    high = np.where(kind == 2, t, np.where(kind == 3, np.nextafter(t, -np.inf), high))
    low, high = np.where(kind == 4, t, low), np.where(kind == 4, t, high)
    on = ((kind == 5) & rows)[:, None]
    with np.errstate(all="ignore"):
        return np.where(on, o + t[:, None] * d, o), np.where(on, -d, d), low, high


# --- rays of any shape against brute force ---------------------------------------------------------------


def shaped(
    o: npt.ArrayLike, d: npt.ArrayLike, low: npt.ArrayLike = 0.0, high: npt.ArrayLike = np.inf
) -> Query:
    """Rays of any leading shape, each with its own interval, so that few variants of kernels are compiled."""
    origins, directions = (np.array(side) for side in np.broadcast_arrays(np.asarray(o), np.asarray(d)))
    t_min, t_max = (np.array(np.broadcast_to(side, origins.shape[:-1]), np.float64) for side in (low, high))
    return origins, directions, t_min, t_max


def assert_brute(
    mesh: Mesh, device: Device, accuracy: str, rays: Query, grids: Sequence[Grid | dict[str, Any]] = (GRID,)
) -> Hits:
    """Every bit of cast, count and occluded is that of brute force; what brute force finds."""
    expected = brute_force(mesh, *rays, device=device, accuracy=accuracy, fields=fields_of(accuracy))
    counts = brute_force_count(mesh, *rays, device=device, accuracy=accuracy)
    np.testing.assert_array_equal(expected.mask, counts > 0)
    for options in grids:
        grid = options
        if not isinstance(grid, Grid):
            grid = build(mesh, accuracy=accuracy, device=device, **grid)
        assert_same(grid.cast(*rays, fields=fields_of(accuracy)), expected)
        np.testing.assert_array_equal(grid.count(*rays), counts)
        np.testing.assert_array_equal(grid.occluded(*rays), counts > 0)
    return expected


def view(
    eye: npt.ArrayLike, width: int, height: int, fov: float = 40.0, at: npt.ArrayLike = (0, 0, 0)
) -> Query:
    return shaped(*Camera.look_at(eye, at, (0.1, 0.9, 0.2), fov).rays(width, height))


def orders(rays: Query, rng: np.random.Generator) -> Iterator[tuple[str, Query]]:
    """The same rays as they may come: as an image, in rows, with gaps, shuffled, reversed."""
    flat = tuple(side.reshape(-1, *side.shape[2:]) for side in rays)
    count = len(flat[0])
    yield "an image", rays
    for name, rows in (
        ("rows", np.arange(count)),
        ("rows with gaps", np.flatnonzero(rng.random(count) < 0.7)),
        ("shuffled", rng.permutation(count)),
        ("reversed", np.arange(count)[::-1]),
    ):
        o, d, low, high = (np.ascontiguousarray(side[rows]) for side in flat)
        yield name, (o, d, low, high)
