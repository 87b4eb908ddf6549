"""Rays and meshes drawn to be degenerate: exactly through vertices and edges, within planes, at all scales.

``rays.py`` has families that aim at a grid; those here aim at triangles, and exactly: an origin has few
digits, so that the difference to what it is aimed at is a double (where the mesh has float32 coordinates).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from fans import FanScene, fan_scene, fans, nudged
from hypothesis import strategies as st
from meshes import soup, torus
from rays import FAMILIES as AROUND
from rays import NEARLY_ZERO, Rays, Surroundings, surroundings

from clgrid import procedural
from clgrid.mesh import Mesh

F64 = npt.NDArray[np.float64]

__all__ = [
    "CLOSED", "FAMILIES", "FanScene", "cases", "closed_meshes", "fan_scene", "fans", "inside_rays", "nudged",
    "structured",
]  # fmt: skip


def short(values: F64) -> F64:
    """The values rounded to 24 binary digits each."""
    share, exponent = np.frexp(values)
    return np.ldexp(np.round(np.ldexp(share, 24)), exponent - 24)


def _away(around: Surroundings, count: int, rng: np.random.Generator, decades: tuple[float, float]) -> F64:
    way = rng.normal(size=(count, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    return short(around.centre + around.diagonal * 10.0 ** rng.uniform(*decades, (count, 1)) * way)


def _triangles(around: Surroundings, count: int, rng: np.random.Generator) -> tuple[F64, F64, F64]:
    """Corners of random triangles, beginning with any of them."""
    face, first = rng.integers(len(around.corners), size=count), rng.integers(3, size=count)
    a, b, c = (around.corners[face, (first + k) % 3] for k in range(3))
    return a, b, c


def _targets(around: Surroundings, count: int, rng: np.random.Generator) -> F64:
    """Vertices, points of edges and of faces, most of them exact."""
    a, b, c = _triangles(around, count, rng)
    s = rng.random((count, 1))
    choices = [a, a / 2 + b / 2, a / 4 + b * 0.75, a / 2 + b / 4 + c / 4, (1 - s) * a + s * b]
    return np.choose(rng.integers(len(choices), size=(count, 1)), choices)


def exactly_at(around: Surroundings, count: int, rng: np.random.Generator) -> Rays:
    """From outside or within the bounds."""
    origins = _away(around, count, rng, (-1.5, 0.5))
    return origins, _targets(around, count, rng) - origins


def from_afar(around: Surroundings, count: int, rng: np.random.Generator) -> Rays:
    """From a hundred to a million diagonals away."""
    origins = _away(around, count, rng, (2, 6))
    return origins, _targets(around, count, rng) - origins


def along_edges(around: Surroundings, count: int, rng: np.random.Generator) -> Rays:
    """Along edges, from before, upon, and after them."""
    a, b, _ = _triangles(around, count, rng)
    return a - rng.choice((-2.0, -0.5, 0.0, 1.0, 16.0), size=(count, 1)) * (b - a), b - a


def within_planes(around: Surroundings, count: int, rng: np.random.Generator) -> Rays:
    """Within the plane of a triangle, through a corner or a point of an edge."""
    a, b, c = _triangles(around, count, rng)
    steps = rng.integers(-2, 3, (count, 2)).astype(np.float64)
    way = steps[:, :1] * (b - a) + steps[:, 1:] * (c - a)
    through = np.where(rng.random((count, 1)) < 0.5, a, b / 2 + c / 2)
    return through - rng.choice((0.0, 0.5, 4.0), size=(count, 1)) * way, way


def parallel_to_axes(around: Surroundings, count: int, rng: np.random.Generator) -> Rays:
    """Parallel to an axis or a plane of two, through vertices, points of edges and of faces."""
    way = rng.choice((-1.0, 0.0, 0.0, 1.0), size=(count, 3))
    targets = _targets(around, count, rng)
    # A power of two, so that the mesh's own coordinates stay what they are.
    step = 2.0 ** np.ceil(np.log2(around.diagonal))
    return targets - rng.choice((0.0, 1.0, 1.0), size=(count, 1)) * step * way, way


def from_surface(around: Surroundings, count: int, rng: np.random.Generator) -> Rays:
    """From vertices, edges and faces, to others or anywhere: crossings at t = 0."""
    origins = _targets(around, count, rng)
    ends = np.where(
        rng.random((count, 1)) < 0.5, _targets(around, count, rng), _away(around, count, rng, (-1, 1))
    )
    return origins, ends - origins


def from_inside(around: Surroundings, count: int, rng: np.random.Generator) -> Rays:
    """From points of few digits within the bounds, to anything."""
    origins = short(around.low + rng.random((count, 3)) * (around.high - around.low))
    return origins, _targets(around, count, rng) - origins


_OWN: tuple[Callable[[Surroundings, int, np.random.Generator], Rays], ...] = (
    exactly_at, from_afar, along_edges, within_planes, parallel_to_axes, from_surface, from_inside,
)  # fmt: skip
FAMILIES = {**{f"around_{name}": family for name, family in AROUND.items()}, **{f.__name__: f for f in _OWN}}
"""Those of rays.py and those above."""


def _strained(origins: F64, directions: F64, rng: np.random.Generator, share: float = 0.02) -> Rays:
    """Some directions of 1e-30 to 1e30 times their length, zeros of all kinds, values off by a rounding."""
    origins = nudged(origins, rng, share)
    directions = nudged(directions, rng, share)
    # Of a length that is none, or a rounding of none.
    none = (np.abs(directions) < 2.0**-900).all(axis=1)
    directions[none] = rng.integers(1, 4, (int(none.sum()), 3))
    size = np.abs(directions).max(axis=1, keepdims=True)
    dust = size * rng.choice(NEARLY_ZERO, size=directions.shape)
    dusty = (directions == 0) & (rng.random((len(directions), 1)) < 0.5)
    directions = np.where(dusty, dust, directions)
    exact = np.ldexp(1.0, rng.integers(-100, 101, (len(directions), 1)))
    anyhow = 10.0 ** rng.uniform(-30, 30, (len(directions), 1))
    length = np.choose(rng.integers(4, size=(len(directions), 1)), [1.0, 1.0, exact, anyhow])
    return origins, directions * length


def structured(mesh: Mesh, count: int, seed: int = 0, resolution: tuple[int, int, int] = (5, 4, 6)) -> Rays:
    """``count`` adversarial rays, (N, 3) float64 each, split evenly over all families and in random order.

    The square of the mesh's diagonal times a million must be a double. ``resolution`` is of the grid whose
    planes some families aim at.
    """
    around = surroundings(mesh, resolution)
    share = -(-count // len(FAMILIES))
    rng = np.random.default_rng([seed, 3])
    parts = [_strained(*family(around, share, rng), rng) for family in FAMILIES.values()]
    order = rng.permutation(share * len(FAMILIES))[:count]
    return np.concatenate([o for o, _ in parts])[order], np.concatenate([d for _, d in parts])[order]


def inside_rays(mesh: Mesh, points: npt.ArrayLike, count: int, seed: int = 0) -> Rays:
    """``count`` rays from the points, in turn: at vertices, edges and faces, along axes and anywhere."""
    around = surroundings(mesh, (1, 1, 1))
    rng = np.random.default_rng([seed, 4])
    starts = np.asarray(points, np.float64)
    origins = starts[np.arange(count) % len(starts)]
    axes = rng.choice((-1.0, 0.0, 0.0, 1.0), size=(count, 3)) * around.diagonal
    choices = [_targets(around, count, rng) - origins] * 3 + [axes, rng.normal(size=(count, 3))]
    ways = np.choose(rng.integers(len(choices), size=(count, 1)), choices)
    return origins, _strained(origins, ways, rng)[1]


def _joined(*parts: Mesh) -> Mesh:
    return soup(np.concatenate([part.vertices[part.faces] for part in parts]))


def _box(low: tuple[float, float, float], size: float = 1.0) -> Mesh:
    cube = procedural.cube()
    return Mesh((cube.vertices * (size / 2) + (np.array(low) + size / 2)).astype(np.float32), cube.faces)


def closed_meshes() -> dict[str, tuple[Mesh, list[tuple[float, float, float]]]]:
    """Closed meshes, each with points that half lines leave through an odd number of triangles."""
    tetrahedron = soup(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])[
        np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    ])  # fmt: skip
    unit, ball, ring = _box((0, 0, 0)), procedural.icosphere(2), torus()
    mid = (0.5, 0.5, 0.5)
    return {
        "tetrahedron": (tetrahedron, [(0.25, 0.25, 0.25), (0.125, 0.5, 0.25)]),
        "cube": (unit, [mid, (0.25, 0.5, 0.75), (2.0**-40, 0.5, 0.5)]),
        "icosphere": (ball, [(0.0, 0.0, 0.0), (0.5, -0.25, 0.125)]),
        "torus": (ring, [(1.0, 0.0, 0.0), (0.0, -1.0, 0.125)]),
        "cubes sharing a face": (_joined(unit, _box((1, 0, 0))), [mid, (1.5, 0.5, 0.5)]),
        "cubes sharing an edge": (_joined(unit, _box((1, 1, 0))), [mid, (1.5, 1.5, 0.5)]),
        "cubes sharing a vertex": (_joined(unit, _box((1, 1, 1))), [mid, (1.5, 1.5, 1.5)]),
        "cubes touching": (_joined(unit, _box((1, 0.25, 0.5))), [mid, (1.5, 0.75, 1.25)]),
        "cube in a cube": (_joined(_box((-1, -1, -1), 4.0), unit), [(-0.5, 0.5, 0.5), (2.0, 2.0, 2.0)]),
        "three copies": (_joined(ball, ball, ball), [(0.0, 0.0, 0.0)]),
        "far away": (Mesh(ball.vertices + np.float64(2.0**30), ball.faces), [(2.0**30,) * 3]),
    }


CLOSED = closed_meshes()


def _decades(limit: int) -> st.SearchStrategy[float]:
    """Doubles of all sizes up to 2**limit (as pbrt's pExp), and those that go wrong."""
    any_size = st.builds(
        lambda share, exponent: float(np.ldexp(share, exponent)),
        st.floats(-1, 1, allow_subnormal=False),
        st.integers(-limit, limit),
    )
    return st.one_of(any_size, st.sampled_from([*NEARLY_ZERO, 1.0, -1.0]))


_small = st.integers(-3, 3).map(float)


def _points(values: st.SearchStrategy[float], low: int, high: int) -> st.SearchStrategy[F64]:
    point = st.tuples(values, values, values)
    return st.lists(point, min_size=low, max_size=high).map(lambda rows: np.array(rows, np.float64))


@st.composite
def _lattice(draw: st.DrawFn) -> tuple[F64, F64, F64]:
    """Triangles between a few points of small integers, a line through two halves of such points."""
    points = draw(_points(_small, 3, 7))
    index = st.integers(0, len(points) - 1)
    faces = draw(st.lists(st.tuples(index, index, index), min_size=1, max_size=8))
    ends = draw(_points(_small, 2, 2)) / draw(st.sampled_from([1.0, 2.0]))
    return points[np.array(faces)], ends[0], ends[1] - ends[0]


@st.composite
def _fan(draw: st.DrawFn) -> tuple[F64, F64, F64]:
    """A fan around an apex; a line through the apex, a spoke, the rim, or along one of them."""
    points = draw(_points(draw(st.sampled_from([_small, _decades(40)])), 4, 8))
    apex, rim = points[0], points[1:]
    after = np.roll(rim, -1, axis=0)
    corners = np.stack([np.broadcast_to(apex, rim.shape), rim, after], axis=1)
    target = draw(st.sampled_from([apex, rim[0], (apex + rim[0]) / 2, (rim[0] + after[0]) / 2]))
    start = draw(_points(_small, 1, 1))[0]
    way = draw(
        st.sampled_from([target - start, rim[0] - apex, after[0] - rim[0], rim[0] + after[0] - 2 * apex])
    )
    return corners, target - way, way


@st.composite
def _wild(draw: st.DrawFn) -> tuple[F64, F64, F64]:
    """All coordinates of any size."""
    points = draw(_points(_decades(300), 5, 8))
    corners = np.stack([points[2:], np.roll(points[2:], 1, axis=0), np.roll(points[2:], 2, axis=0)], axis=1)
    return corners, points[0], points[1]


@st.composite
def cases(draw: st.DrawFn) -> tuple[npt.NDArray[np.floating], F64, F64]:
    """Corners (F, 3, 3) float32 or float64, origin and direction (3,) float64: degenerate mostly."""
    corners, origin, direction = draw(st.one_of(_lattice(), _fan(), _wild()))
    if draw(st.booleans()):
        scale = draw(st.sampled_from([-600, -140, -60, 0, 60, 140, 600]))
        corners, origin = np.ldexp(corners, scale), np.ldexp(origin, scale)
        direction = np.ldexp(direction, draw(st.sampled_from([-600, -100, 0, 100, 600])))
    zeros = draw(st.tuples(*[st.sampled_from(NEARLY_ZERO)] * 3))
    direction = np.where(direction == 0, np.array(zeros), direction)
    axis = draw(st.integers(0, 8))
    if axis < 3:
        origin = origin.copy()
        origin[axis] = np.nextafter(origin[axis], draw(st.sampled_from([-np.inf, np.inf])))
    if draw(st.booleans()):
        with np.errstate(over="ignore"):
            narrow = corners.astype(np.float32)
        if np.isfinite(narrow).all():
            return narrow, origin, direction
    return corners, origin, direction
