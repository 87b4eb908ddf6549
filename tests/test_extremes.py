"""Extremes of size, place, shape and direction, each by name: the guarantees of every rung hold there too."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from adversarial import FAMILIES, inside_rays, short, structured
from agreement import RUNGS, Query, ask, assert_exact, assert_lossless, part, query, truth_of
from meshes import lattice_box, moved, needle_fan, scaled, soup, torus
from rays import NEARLY_ZERO, Surroundings, surroundings

from clgrid import procedural
from clgrid.brute import brute_force
from clgrid.device import Device
from clgrid.errors import MeshError
from clgrid.grid import build
from clgrid.mesh import Mesh
from clgrid.rational import Triangles

F64 = npt.NDArray[np.float64]
RESOLUTION = (5, 4, 6)
GRID: dict[str, Any] = {"resolution": RESOLUTION}
BALL = procedural.icosphere(2)


@dataclass(frozen=True)
class Extreme:
    """A mesh with the rays that strain it."""

    mesh: Mesh
    rays: Query
    centre: F64 | None = None
    """A point that no ray may escape from."""
    rungs: tuple[str, ...] = RUNGS
    sample: int = 120
    """So many rays are held against rational arithmetic."""
    density: float = 30
    """Of the second grid."""


Case = Callable[[], Extreme]
CASES: dict[str, Case] = {}


def case(name: str) -> Callable[[Case], Case]:
    """Enter a case by name; it is made once for all rungs and devices."""

    def enter(make: Case) -> Case:
        assert name not in CASES
        CASES[name] = functools.lru_cache(maxsize=1)(make)
        return make

    return enter


def of_families(mesh: Mesh, names: tuple[str, ...], count: int = 1200, low: float = 0.0) -> Query:
    around, parts = surroundings(mesh, RESOLUTION), []
    for number, name in enumerate(names):
        rng = np.random.default_rng([71, number])
        parts.append(FAMILIES[name](around, count // len(names), rng))
    return query(np.concatenate([o for o, _ in parts]), np.concatenate([d for _, d in parts]), low)


# --- sizes and places ---------------------------------------------------------------------------------


def _of_size(by: float, dtype: type) -> Case:
    def make() -> Extreme:
        mesh = scaled(BALL, by, dtype)
        return Extreme(mesh, query(*structured(mesh, 520, 72)), np.zeros(3))

    return make


for _by in (1e-30, 1e-20, 1e20, 1e30):
    case(f"float32 times {_by:g}")(_of_size(_by, np.float32))
    case(f"float64 times {_by:g}")(_of_size(_by, np.float64))


@case("float32 denormals")
def _() -> Extreme:
    """The whole mesh: coordinates are small multiples of 2^-149."""
    mesh = Mesh(np.ldexp(lattice_box(8).vertices * 4, -149 + 6).astype(np.float32), lattice_box(8).faces)
    assert 0 < np.abs(mesh.vertices).max() < 2.0**-126
    return Extreme(mesh, query(*structured(mesh, 520, 73)), np.zeros(3))


@case("vertices with denormal coordinates")
def _() -> Extreme:
    """Of a mesh of unit size: as good as zero, and not zero."""
    vertices = torus(24, 16).vertices.astype(np.float64)
    rng = np.random.default_rng(74)
    flat = np.abs(vertices) < 1e-6
    # Not the least of all: in a mesh below 2, half of that would be lost, and exact refuses it.
    tiny = [2.0**-1073, -(2.0**-1073), 3 * 2.0**-1040, -0.0, 2.0**-149]
    vertices[flat] = rng.choice(tiny, size=int(flat.sum()))
    assert flat.sum() > 50
    mesh = Mesh(vertices, torus(24, 16).faces)
    return Extreme(mesh, query(*structured(mesh, 520, 74)), np.array([1.0, 0, 0]))


@case("float64 far from the origin")
def _() -> Extreme:
    """A thousand million diagonals away."""
    way = 3.5e9
    mesh = moved(BALL, way, np.float64)
    return Extreme(mesh, query(*structured(mesh, 520, 75)), way * np.array([1, -0.7, 0.3]))


@case("far along one axis")
def _() -> Extreme:
    vertices = BALL.vertices.astype(np.float64) + np.array([0, 0, 3.5e9])
    mesh = Mesh(vertices, BALL.faces)
    return Extreme(mesh, query(*structured(mesh, 520, 76)), np.array([0, 0, 3.5e9]))


@case("from 1e6 diagonals")
def _() -> Extreme:
    names = ("from_afar", "around_from_1e6_diagonals", "around_from_100_diagonals")
    return Extreme(BALL, of_families(BALL, names))


def _from_away(distance: float) -> Case:
    """Towards the mesh from so far away that a double cannot tell where a ray passes, unless along axes."""

    def make() -> Extreme:
        mesh = lattice_box(4)
        rng = np.random.default_rng(77)
        way = rng.choice((-1.0, 0.0, 1.0), size=(90, 3))
        way[(way == 0).all(axis=1)] = (0, 0, 1)
        # Lattice points are vertices, points of edges and of faces; others lie in general position.
        target = np.where(
            rng.random((90, 1)) < 0.5, rng.integers(-4, 5, (90, 3)) / 4, rng.uniform(-1, 1, (90, 3))
        )
        reach = 2.0 ** np.round(np.log2(distance))
        origins = np.where(way == 0, target, -reach * way)
        # A shorter direction would take t from 1e300 diagonals beyond the largest double.
        ways = way * np.ldexp(1.0, rng.integers(-10, 91, (90, 1)))
        rays = query(origins, ways, rng.choice((0.0, -np.inf), size=90))
        return Extreme(mesh, rays, rungs=("exact",), sample=90)

    return make


for _diagonals in (1e20, 1e300):
    case(f"from {_diagonals:g} diagonals")(_from_away(3.5 * _diagonals))


# --- directions ----------------------------------------------------------------------------------------


@case("directions of any length")
def _() -> Extreme:
    rng = np.random.default_rng(78)
    o, d, low, high = of_families(BALL, ("exactly_at", "from_inside", "around_random"))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    return Extreme(BALL, (o, d * 10.0 ** rng.uniform(-30, 30, (len(d), 1)), low, high))


def _with_dust(values: tuple[float, ...]) -> Case:
    def make() -> Extreme:
        rng = np.random.default_rng(79)
        o, d, low, high = of_families(BALL, ("parallel_to_axes", "around_along_axes", "exactly_at"))
        d = np.where(np.abs(d) < 1e-3, 0, d)
        d[(d == 0).all(axis=1)] = (0, 0, -1)
        exact = rng.random(d.shape) < 0.3
        exact[np.arange(len(d)), np.abs(d).argmax(axis=1)] = False
        return Extreme(BALL, (o, np.where((d == 0) | exact, rng.choice(values, size=d.shape), d), low, high))

    return make


case("components -0.0")(_with_dust((0.0, -0.0)))
case("denormal components")(_with_dust((5e-324, -5e-324, 1e-310, -1e-310, 1e-320)))
case("components 1e-16")(_with_dust((1e-16, -1e-16)))
case("components 1e-300")(_with_dust((1e-300, -1e-300, 1e-200)))
case("components 1e-46")(_with_dust((1e-46, -1e-40, 1e-30)))


# --- rays and grids ------------------------------------------------------------------------------------


def _in_grid(family: str) -> Case:
    def make() -> Extreme:
        mesh = torus()
        return Extreme(mesh, of_families(mesh, (family,)))

    return make


case("along grid planes")(_in_grid("around_in_grid_planes"))
case("along cell edges")(_in_grid("around_along_cell_edges"))
case("through cell corners")(_in_grid("around_through_cell_corners"))


def _origins(of: Callable[[Surroundings, int, np.random.Generator], F64], low: float) -> Case:
    def make() -> Extreme:
        mesh = lattice_box(6)
        around, rng = surroundings(mesh, RESOLUTION), np.random.default_rng(80)
        o = of(around, 1200, rng)
        d = np.where(
            rng.random((1200, 1)) < 0.5,
            rng.normal(size=(1200, 3)),
            rng.choice((-1.0, 0.0, 1.0), size=(1200, 3)),
        )
        d[(d == 0).all(axis=1)] = (0, -1, 0)
        return Extreme(mesh, query(o, d, low))

    return make


def _on_surface(around: Surroundings, count: int, rng: np.random.Generator) -> F64:
    corners = around.corners[rng.integers(len(around.corners), size=count)]
    weights = np.array([[1, 0, 0], [0.5, 0.5, 0], [0.25, 0.5, 0.25], [0.3, 0.3, 0.4]])
    points: F64 = (corners * weights[rng.integers(4, size=count)][:, :, None]).sum(axis=1)
    return points


def _in_cell_corners(around: Surroundings, count: int, rng: np.random.Generator) -> F64:
    return np.stack([rng.choice(around.planes[axis], size=count) for axis in range(3)], axis=1)


def _on_bounds(around: Surroundings, count: int, rng: np.random.Generator) -> F64:
    points = around.low + rng.random((count, 3)) * (around.high - around.low)
    ends = rng.integers(-1, 2, (count, 3))
    return np.where(ends < 0, around.low, np.where(ends > 0, around.high, points))


for _low in (0.0, -np.inf):
    case(f"origins on the surface, t_min {_low}")(_origins(_on_surface, _low))
    case(f"origins in cell corners, t_min {_low}")(_origins(_in_cell_corners, _low))
    case(f"origins on the bounds, t_min {_low}")(_origins(_on_bounds, _low))


# --- shapes of meshes ----------------------------------------------------------------------------------


@case("zero area and duplicates")
def _() -> Extreme:
    rng = np.random.default_rng(81)
    ball = BALL.vertices[BALL.faces].astype(np.float64)
    lines = np.stack([ball[:, 0], ball[:, 1], ball[:, 0] / 2 + ball[:, 1] / 2], axis=1)
    points = np.repeat(ball[:, :1], 3, axis=1)
    mesh = soup(rng.permutation(np.concatenate([ball, ball, lines, points, ball[:, [1, 2, 0]]])))
    # The centre must not be left out: the ball is there, and there again, and is closed.
    return Extreme(mesh, query(*structured(mesh, 520, 82)), np.zeros(3))


@case("needles of aspect 1e8")
def _() -> Extreme:
    rng = np.random.default_rng(83)
    a, b = rng.uniform(-1, 1, (2, 300, 3))
    corners = np.stack([a, b, a + 0.4 * (b - a) + 1e-8 * rng.normal(size=(300, 3))], axis=1)
    mesh = soup(corners, np.float64)
    around = mesh.vertices[mesh.faces[rng.integers(300, size=600)]]
    targets = (around * rng.dirichlet([1, 1, 1], size=600)[:, :, None]).sum(axis=1)
    origins = rng.uniform(-2, 2, (600, 3))
    o, d = structured(mesh, 600, 84)
    return Extreme(mesh, query(np.concatenate([origins, o]), np.concatenate([targets - origins, d])))


@case("closed needles")
def _() -> Extreme:
    mesh = needle_fan(200)
    # Cells are slices of the cone, each with half of all triangles, that rays along it meet again and again.
    return Extreme(mesh, query(*structured(mesh, 520, 85)), np.zeros(3), density=0.5)


@case("coplanar stacks")
def _() -> Extreme:
    rng = np.random.default_rng(86)
    corners = rng.integers(-4, 5, (400, 3, 3)).astype(float)
    corners[:, :, 2] = rng.integers(-1, 2, (400, 1)) * 2.0**-12
    return Extreme(soup(corners), query(*structured(soup(corners), 400, 87), -np.inf))


@case("one as large as the scene")
def _() -> Extreme:
    rng = np.random.default_rng(88)
    small = rng.uniform(-1, 1, (400, 1, 3)) + 1e-3 * rng.normal(size=(400, 3, 3))
    large = np.array([[[-1, -1, -1], [1, 1, -0.5], [-0.5, 1, 1]], [[-1.0, 1, -1], [1, -1, 0.1], [1, 1, 1]]])
    mesh = soup(np.concatenate([small[:200], large, small[200:]]))
    return Extreme(mesh, query(*structured(mesh, 520, 89)))


@case("one triangle")
def _() -> Extreme:
    mesh = soup(np.array([[[0, 0, 0], [1, 0, 0.25], [0, 1, 0.5]]]))
    return Extreme(mesh, query(*structured(mesh, 520, 90), -np.inf))


@case("copies of one triangle")
def _() -> Extreme:
    mesh = soup(np.tile(np.array([[[0, 0, 0], [1, 0, 0.25], [0, 1, 0.5]]]), (2000, 1, 1)))
    return Extreme(mesh, query(*structured(mesh, 130, 91)), sample=20)


@case("vertices on cell planes")
def _() -> Extreme:
    """At 8 cells an axis, up to the margin of the grid."""
    mesh = lattice_box(8)
    return Extreme(mesh, query(*structured(mesh, 520, 92, (8, 8, 8))), np.zeros(3))


@case("a fan around one vertex")
def _() -> Extreme:
    return cone(1500, 130)


def cone(count: int, rays: int) -> Extreme:
    """A closed double cone whose triangles all share a vertex: a half at the top, a half at the bottom."""
    angle = np.arange(count) * 2 * np.pi / count
    rim = np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], -1)
    vertices = np.concatenate([rim, [[0, 0, 1.0], [0, 0, -0.5]]]).astype(np.float32)
    i = np.arange(count, dtype=np.uint32)
    j = np.roll(i, -1)
    top, bottom = np.full_like(i, count), np.full_like(i, count + 1)
    mesh = Mesh(vertices, np.concatenate([np.stack([i, j, top], -1), np.stack([j, i, bottom], -1)]))
    rng = np.random.default_rng(93)
    o, d = structured(mesh, rays, 93)
    # Through the apex exactly, from few digits; and by it.
    apex = short(rng.uniform(-0.5, 0.5, (rays // 4, 3)) - [0, 0, 0.25])
    o = np.concatenate([o, apex, apex])
    d = np.concatenate([d, [0, 0, 1.0] - apex, [0, 0, 1.0] - apex + 1e-9 * rng.normal(size=apex.shape)])
    return Extreme(mesh, query(o, d), np.array([0.0, 0, 0.125]), sample=40)


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize("accuracy", RUNGS)
@pytest.mark.parametrize("name", CASES)
def test_extremes(name: str, accuracy: str, device: Device) -> None:
    extreme = CASES[name]()
    if accuracy not in extreme.rungs:
        pytest.skip(f"{accuracy} does not promise hits of rays {name}")
    mesh, rays = extreme.mesh, extreme.rays
    skipping = {"layout": "hashed", "skipping": True, "density": extreme.density}
    answers = assert_lossless(mesh, device, accuracy, rays, [GRID, skipping])
    assert answers.hits.invalid_rays == 0
    assert answers.hits.mask.mean() > 0.02
    if extreme.centre is not None:
        leaving = query(*inside_rays(mesh, extreme.centre[None], 800, 94))
        out = assert_lossless(mesh, device, accuracy, leaving, [GRID])
        assert out.hits.invalid_rays == 0
        assert out.hits.mask.all(), "no ray escapes"
        if accuracy == "exact" and name != "zero area and duplicates":
            assert (out.counts % 2 == 1).all()
    if accuracy == "exact":
        rows = np.random.default_rng(95).permutation(len(rays[0]))[: extreme.sample]
        some = part(rays, rows)
        grid = build(mesh, accuracy=accuracy, device=device, **GRID)
        assert_exact(ask(grid, some), truth_of(Triangles.of_mesh(mesh), some), mesh, some)


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize("accuracy", RUNGS)
@pytest.mark.parametrize(
    "name", ["from 1e6 diagonals", "float64 far from the origin", "float32 times 1e-30", "coplanar stacks"]
)
def test_intervals_around_a_hit(name: str, accuracy: str, device: Device) -> None:
    """t_min and t_max at the hit, and one double on either side."""
    extreme = CASES[name]()
    mesh, (o, d, _, _) = extreme.mesh, part(extreme.rays, slice(None, None, 4))
    hits = brute_force(mesh, o, d, -np.inf, np.inf, device=device, accuracy=accuracy)
    t = np.where(hits.mask, hits.t_hit, 1.0)
    for low, high in (
        (t, np.inf),
        (np.nextafter(t, np.inf), np.inf),
        (-np.inf, t),
        (-np.inf, np.nextafter(t, -np.inf)),
        (t, t),
    ):
        rays = query(o, d, low, high)
        found = assert_lossless(mesh, device, accuracy, rays, [GRID]).hits
        if accuracy != "exact":  # asks the reported t, which is a double
            inside_ = (hits.t_hit >= rays[2]) & (hits.t_hit <= rays[3])
            np.testing.assert_array_equal(found.t_hit[inside_ & hits.mask], hits.t_hit[inside_ & hits.mask])
        else:
            some = part(rays, slice(0, 60))
            answers = ask(build(mesh, accuracy=accuracy, device=device, **GRID), some)
            assert_exact(answers, truth_of(Triangles.of_mesh(mesh), some), mesh, some)


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize("accuracy", RUNGS)
def test_zeros_of_all_kinds_are_parallel(accuracy: str, device: Device) -> None:
    """A box seen along its axes: whatever the other components are that come to nothing."""
    grid = build(procedural.cube(), resolution=(3, 4, 5), accuracy=accuracy, device=device)
    for axis in range(3):
        for one in NEARLY_ZERO[:8]:
            for other in NEARLY_ZERO[:8]:
                way = np.insert(np.array([one, other]), axis, 1.0)
                start = np.insert(np.array([0.25, 0.375]), axis, -3.0)
                answers = ask(grid, query(start, way))
                assert answers.hits.t_hit.tolist() == [2]
                assert answers.every.t_hit.tolist() == [2, 4]


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize("accuracy", RUNGS)
def test_a_million_copies_of_one_triangle(accuracy: str, device: Device) -> None:
    corners = np.array([[0, 0, 0], [1, 0, 0.25], [0, 1, 0.5]], np.float32)
    mesh = Mesh(corners, np.tile(np.arange(3, dtype=np.uint32), (1_000_000, 1)))
    grid = build(mesh, resolution=(2, 2, 2), accuracy=accuracy, device=device)
    rays = query([(0.3, 0.3, 2), (0.3, 0.3, -1), (0.9, 0.9, 2)], [(0, 0, -1), (0, 0, 1), (0, 0, -1)])
    hits = grid.cast(*rays)
    assert hits.primitive_ids.tolist() == [0, 0, -1]
    assert grid.count(*rays).tolist() == [1_000_000, 1_000_000, 0]
    assert grid.occluded(*rays).tolist() == [True, True, False]
    every = grid.cast_all(*rays)
    np.testing.assert_array_equal(every.primitive_ids, np.tile(np.arange(1_000_000), 2))
    assert (every.t_hit[:1_000_000] == hits.t_hit[0]).all()


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize("accuracy", RUNGS)
def test_100_000_triangles_that_share_a_vertex(accuracy: str, device: Device) -> None:
    extreme = cone(50_000, 52)
    mesh, rays = extreme.mesh, extreme.rays
    answers = assert_lossless(mesh, device, accuracy, rays, [{"density": 4}])
    assert answers.hits.mask.any()
    assert extreme.centre is not None
    leaving = query(*inside_rays(mesh, extreme.centre[None], 400, 96))
    out = ask(build(mesh, density=4, accuracy=accuracy, device=device), leaving)
    assert out.hits.mask.all()
    if accuracy == "exact":
        assert (out.counts % 2 == 1).all()
        some = part(rays, slice(None, None, 3))
        assert_exact(ask(build(mesh, density=4, accuracy=accuracy, device=device), some),
                     truth_of(Triangles.of_mesh(mesh), some), mesh, some)  # fmt: skip


def test_exact_refuses_what_it_cannot_hold(device: Device) -> None:
    mesh = Mesh(np.array([[0, 0, 0], [3, 0, 5e-324], [0, 3, 0]]), np.array([[0, 1, 2]], np.uint32))
    with pytest.raises(MeshError, match="below 2\\^-1022 of the mesh's size, which exact cannot hold"):
        build(mesh, density=4, accuracy="exact", device=device)
    build(mesh, density=4, accuracy="precise", device=device)


@pytest.mark.parametrize("accuracy", RUNGS)
def test_vertices_of_no_triangle_may_lie_anywhere(accuracy: str, device: Device) -> None:
    corners = np.array([[1.5, 1.5, 1.5], [1.5 + 2**-50, 1.75, 1.5], [1.75, 1.5, 1.5]])  # moved by 1.5
    others = [[5e-324, 1e300, -np.pi], [np.nan, np.inf, -np.inf], [1e-300, -1 / 3, 0]]
    faces = np.array([[0, 1, 2]], np.uint32)
    rays = query(np.array([[1.55, 1.55, 0]] * 3), np.array([[0, 0, 1], [0, 0, -1], [0.01, 0.02, 1]]))
    alone = ask(build(Mesh(corners, faces), density=4, accuracy=accuracy, device=device), rays)
    mesh = Mesh(np.concatenate([corners, others]), faces)
    among = ask(build(mesh, density=4, accuracy=accuracy, device=device), rays)
    assert alone.hits.mask.tolist() == [True, False, True]
    np.testing.assert_array_equal(among.hits.t_hit, alone.hits.t_hit)
    np.testing.assert_array_equal(among.counts, alone.counts)
