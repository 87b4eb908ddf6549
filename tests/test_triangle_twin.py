"""Rays and triangle test of the device against their numpy twins, bit for bit, and exact arithmetic."""

from __future__ import annotations

import functools
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from meshes import soup
from oracle import (
    U,
    closest,
    errors,
    exact_t,
    intersect,
    local_mesh,
    prepare_rays,
)
from rays import Rays, lattice_meshes, lattice_rays, mixed

from clgrid import procedural
from clgrid.brute import brute_force
from clgrid.device import Device
from clgrid.frame import LocalFrame
from clgrid.hits import Hits
from clgrid.mesh import Mesh

HIT_ERROR = 26.0  # of cl/config.h, in units of 2^-24
PROVEN_ASIDE, PROVEN_LATE = 14.6, 11.1  # docs/numerics.md, likewise
MOVED = 16.3  # likewise: how far rounding moves a vertex, seen along the ray


def random_soup(rng: np.random.Generator) -> Mesh:
    sizes = 10.0 ** rng.uniform(-5, 0, (60, 1, 1))
    return soup(rng.uniform(-1, 1, (60, 1, 3)) + sizes * rng.normal(size=(60, 3, 3)))


def slivers(rng: np.random.Generator) -> Mesh:
    """Long triangles down to a rounding thin, and needles whose short side is a rounding."""
    a, along = rng.uniform(-1, 1, (80, 3)), rng.normal(size=(80, 3))
    width = 10.0 ** rng.uniform(-10, -2, (80, 1)) * rng.normal(size=(80, 3))
    middle = np.where(rng.random((80, 1)) < 0.5, rng.random((80, 1)), 1.0)
    return soup(np.stack([a, a + along, a + middle * along + width], axis=1))


def degenerate(rng: np.random.Generator) -> Mesh:
    """Points, repeated corners, corners on a line, and a few sound triangles twice."""
    a, e = rng.integers(-8, 9, (40, 1, 3)), rng.integers(-8, 9, (40, 1, 3))
    steps = rng.integers(0, 3, (40, 3, 1))
    sound = rng.integers(-8, 9, (8, 3, 3))
    return soup(np.concatenate([a + e * steps, sound, sound]))


def flat_lattice(_: np.random.Generator) -> Mesh:
    """Coplanar, axis-parallel squares, stacked and repeated."""
    x, y, z = np.meshgrid(range(3), range(3), (0, 0, 1), indexing="ij")
    a = np.stack([x, y, z], -1).reshape(-1, 3)
    b, c, d = (a + np.array(step) for step in ((1, 0, 0), (1, 1, 0), (0, 1, 0)))
    return soup(np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(float))


def moved(mesh: Mesh, by: float, dtype: type) -> Mesh:
    return Mesh((mesh.vertices.astype(np.float64) + by * np.array([1, -0.7, 0.3])).astype(dtype), mesh.faces)


def scaled(mesh: Mesh, by: float, dtype: type) -> Mesh:
    return Mesh((mesh.vertices.astype(np.float64) * by).astype(dtype), mesh.faces)


def meshes() -> dict[str, Mesh]:
    rng = np.random.default_rng(7)
    ball = procedural.icosphere(1)
    return {
        "random": random_soup(rng),
        "slivers": slivers(rng),
        "degenerate": degenerate(rng),
        "flat_lattice": flat_lattice(rng),
        "ball": ball,
        "far_float32": moved(ball, 1e7, np.float32),
        "far_float64": moved(ball, 1e9, np.float64),
        "tiny": scaled(ball, 1e-30, np.float32),
        "huge": scaled(ball, 1e30, np.float32),
        "tiny_float64": scaled(ball, 1e-120, np.float64),
        "huge_float64": scaled(ball, 1e120, np.float64),
        "denormal": scaled(ball, 1e-42, np.float32),
        "one": soup(np.eye(3)[None]),
    }


MESHES = meshes()


def assert_twin(mesh: Mesh, rays: Rays, device: Device, t_min: object = 0.0, t_max: object = np.inf) -> Hits:
    """Brute force on the device equals the twin in every bit; the device's hits."""
    frame, vertices = local_mesh(mesh)
    local = prepare_rays(*rays, frame, t_min, t_max)
    twin = closest(local, vertices, mesh.faces)
    hits = brute_force(mesh, *rays, t_min, t_max, device=device)
    np.testing.assert_array_equal(hits.primitive_ids, twin.ids)
    np.testing.assert_array_equal(hits.t_hit.view(np.uint64), twin.t_hit.view(np.uint64))
    np.testing.assert_array_equal(hits.primitive_uvs.view(np.uint32), twin.uvs.view(np.uint32))
    assert hits.invalid_rays == int((~local.valid).sum())
    return hits


@pytest.mark.parametrize("name", MESHES)
def test_brute_force_equals_the_twin(name: str, device: Device) -> None:
    rays = mixed(MESHES[name], (4, 5, 3), 1300, seed=1)
    hits = assert_twin(MESHES[name], rays, device)
    assert hits.mask.any()
    # Directions of extreme length change nothing but t.
    for factor in (1e-300, 2.0**-1040, 1e250):
        with np.errstate(over="ignore"):
            assert_twin(MESHES[name], (rays[0], rays[1] / np.abs(rays[1]).max() * factor), device)


def test_float32_rays_equal_the_twin(device: Device) -> None:
    origins, directions = mixed(MESHES["random"], (4, 5, 3), 1300, seed=2)
    with np.errstate(under="ignore"):
        rays = origins.astype(np.float32), directions.astype(np.float32)
    assert_twin(MESHES["random"], rays, device)


def test_intervals_equal_the_twin(device: Device) -> None:
    rays = mixed(MESHES["ball"], (4, 5, 3), 1300, seed=3)
    t = assert_twin(MESHES["ball"], rays, device).t_hit
    rng = np.random.default_rng(0)
    t = np.where(np.isfinite(t), t, rng.normal(size=len(t)))
    for low, high in (
        (t, np.inf), (np.nextafter(t, np.inf), np.inf), (0.0, t), (0.0, np.nextafter(t, 0)),
        (-np.inf, np.inf), (-np.inf, np.nextafter(t, -np.inf)), (t, t), (1.0, 0.0), (np.nan, np.inf),
    ):  # fmt: skip
        assert_twin(MESHES["ball"], rays, device, low, high)


def test_rays_that_are_none_equal_the_twin(device: Device) -> None:
    special = np.array([np.nan, np.inf, -np.inf, 0.0, -0.0, 1.0, 5e-324, 1e308])
    rng = np.random.default_rng(4)
    assert_twin(MESHES["ball"], (rng.choice(special, (3000, 3)), rng.choice(special, (3000, 3))), device)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(mesh=lattice_meshes(), rays=lattice_rays())
def test_lattice_coincidences_equal_the_twin(mesh: Mesh, rays: Rays, device: Device) -> None:
    assert_twin(mesh, rays, device)


def closed_meshes() -> dict[str, Mesh]:
    """Closed meshes of triangles that have area."""
    rng = np.random.default_rng(11)
    ball = procedural.icosphere(1)
    rough = ball.vertices * (1 + 0.2 * rng.random((len(ball.vertices), 1)))
    needle = ball.vertices * np.array([1.0, 1e-2, 1e-4])
    return {
        "cube": procedural.cube(),
        "rough": Mesh(rough.astype(np.float32), ball.faces),
        "needles": Mesh(needle.astype(np.float32), ball.faces),
        "lattice": Mesh((np.rint(rough * 8) / 8).astype(np.float32), ball.faces),
    }


CLOSED = closed_meshes()


def margin(origin: np.ndarray, direction: np.ndarray, triangle: np.ndarray) -> float:
    """Distance from the ray to the triangle's edges, across its longest axis, in units of 2^-24."""
    o, d, corners = (part.astype(np.float64) for part in (origin, direction, triangle))
    z = int(np.argmax(np.abs(d)))
    x, y = (z + 1) % 3, (z + 2) % 3
    p = [(corners[:, a] - o[a]) - d[a] / d[z] * (corners[:, z] - o[z]) for a in (x, y)]
    along = [np.roll(q, -1) - q for q in p]
    with np.errstate(invalid="ignore"):
        return float(np.min(np.abs(p[0] * along[1] - p[1] * along[0]) / np.hypot(*along))) / U


def t_error(direction: np.ndarray, triangle: np.ndarray) -> Fraction:
    """Proven bound on t: a plane met at a slant turns an error aside into one along the ray."""
    corners = triangle.astype(np.float64)
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    slant = np.abs(normal).sum() / abs(normal @ direction.astype(np.float64))
    return Fraction((PROVEN_ASIDE * slant + PROVEN_LATE) * U)


@functools.cache
def exact_hits(name: str) -> dict[int, tuple[dict[int, Fraction], dict[int, Fraction]]]:
    """For each ray of the test below: t of every triangle hit, and of those not merely grazed."""
    mesh = CLOSED[name]
    frame, vertices = local_mesh(mesh)
    local = prepare_rays(*mixed(mesh, (4, 3, 3), 150, seed=5), frame)
    found = {}
    for i in np.flatnonzero(local.reaches).tolist():
        entry = Fraction(local.t_entry[i])
        exact: dict[int, Fraction] = {}
        for id_, face in enumerate(mesh.faces):
            t = exact_t(local.origin[i], local.direction[i], vertices[face])
            if t is not None and t + entry > Fraction(32 * U):
                exact[id_] = t
        clear = {
            id_: t for id_, t in exact.items()
            if margin(local.origin[i], local.direction[i], vertices[mesh.faces[id_]]) > MOVED
        }  # fmt: skip
        found[i] = exact, clear
    return found


@pytest.mark.parametrize("name", CLOSED)
def test_exact_hits_are_found_at_their_t(name: str, device: Device) -> None:
    """Rational arithmetic on the stored values: a crossing that is not a grazing one is never missed."""
    mesh = CLOSED[name]
    frame, vertices = local_mesh(mesh)
    origins, directions = mixed(mesh, (4, 3, 3), 150, seed=5)
    local = prepare_rays(origins, directions, frame)
    hits = brute_force(mesh, origins, directions, device=device)
    checked = 0
    for i, (exact, clear) in exact_hits(name).items():
        entry = Fraction(local.t_entry[i])
        if not clear:
            continue
        assert hits.mask[i], (origins[i], directions[i])
        t = Fraction(hits.t_hit[i] / local.t_unit[i]) - entry
        slack = {k: t_error(local.direction[i], vertices[mesh.faces[k]]) for k in clear}
        assert all(t <= clear[k] + slack[k] for k in clear)
        id_ = int(hits.primitive_ids[i])
        if id_ in clear:
            assert abs(t - exact[id_]) <= slack[id_]
            checked += 1
    assert checked > 10


@pytest.mark.parametrize("name", CLOSED)
def test_no_ray_escapes_from_inside(name: str, device: Device) -> None:
    mesh = CLOSED[name]
    _, directions = mixed(mesh, (4, 3, 3), 13000, seed=13)
    aimed = mesh.vertices[mesh.faces].astype(np.float64)
    ends = np.concatenate([aimed, aimed + np.roll(aimed, 1, axis=1)]).reshape(-1, 3)
    directions = np.concatenate([directions, ends])
    assert brute_force(mesh, np.zeros(3), directions, device=device).mask.all()


@pytest.mark.parametrize("name", MESHES)
def test_no_exact_hit_is_invented(name: str) -> None:
    """An accepted hit passes a point of the stored triangle, at its t but for rounding."""
    mesh = MESHES[name]
    frame, vertices = local_mesh(mesh)
    rays = prepare_rays(*mixed(mesh, (4, 5, 3), 1300, seed=6), frame)
    aside, late = errors(rays, intersect(rays, vertices, mesh.faces), vertices, mesh.faces)
    assert aside.max() < PROVEN_ASIDE
    assert late.max() < PROVEN_LATE


def worst_case_tests(rng: np.random.Generator, kind: int) -> tuple[np.ndarray, np.ndarray]:
    """Errors for rays from the far corner of their range at triangles in the far corner of theirs."""
    size = 10.0 ** rng.uniform(-6, 0)
    corner = rng.choice([-1, 1], size=3) * rng.uniform(0.9, 1, 3)
    if kind == 0:
        corners = corner + size * rng.normal(size=(8, 3, 3))
    else:
        a, along = size * rng.normal(size=(8, 3)), rng.normal(size=(8, 3))
        thin = 10.0 ** rng.uniform(-9, -2) * rng.normal(size=(8, 3))
        corners = corner + np.stack([a, a + along, a + 0.5 * along + thin], 1)
    vertices = np.clip(corners, -1, 1).astype(np.float32).reshape(-1, 3)
    faces = np.arange(24, dtype=np.uint32).reshape(8, 3)
    origins = -np.sign(corner) * rng.uniform(1.7, 2, (2000, 3))
    weights = rng.dirichlet([1, 1, 1], size=2000)
    targets = (vertices[faces[rng.integers(8, size=2000)]] * weights[:, :, None]).sum(1)
    rays = prepare_rays(origins, targets - origins, LocalFrame(np.zeros(3), 0))
    return errors(rays, intersect(rays, vertices, faces), vertices, faces)


def test_error_bounds_are_held_and_not_generous() -> None:
    """The bounds that the pad stands on: never exceeded, and not far above the worst found."""
    rng = np.random.default_rng(8)
    found = [worst_case_tests(rng, kind % 2) for kind in range(20)]
    aside, late = (max(float(part[i].max()) for part in found) for i in range(2))
    assert PROVEN_ASIDE / 4 < aside < PROVEN_ASIDE
    assert PROVEN_LATE / 2 < late < PROVEN_LATE
    assert PROVEN_ASIDE + PROVEN_LATE < HIT_ERROR


def test_triangles_with_a_repeated_corner_are_never_hit(device: Device) -> None:
    corners = np.random.default_rng(9).normal(size=(300, 3, 3))
    for kind, (to, of) in enumerate(((1, 0), (2, 1), (0, 2))):
        corners[kind::4, to] = corners[kind::4, of]
    corners[3::4] = corners[3::4, :1]
    mesh = soup(corners)
    rays = mixed(mesh, (4, 5, 3), 13000, seed=9)
    assert not brute_force(mesh, *rays, device=device).mask.any()


def seamed_ball() -> tuple[Mesh, np.ndarray]:
    """A closed ball on a lattice, its edges split from one side only; triangles on a line fill the seams."""
    ball = procedural.icosphere(2)
    points = (np.rint(ball.vertices * 4000) * 2).tolist()
    across = {(a, b): (f, c) for f, row in enumerate(ball.faces.tolist()) for a, b, c in _turns(row)}
    faces, seams, done = [], [], set()
    for f, (a, b, c) in enumerate(ball.faces.tolist()):
        other, e = across[b, a]
        if f in done or other in done:
            continue
        done |= {f, other}
        middle = len(points)
        points.append([(p + q) / 2 for p, q in zip(points[a], points[b], strict=True)])
        faces += [(a, b, c), (b, middle, e), (middle, a, e)]
        seams.append((a, middle, b))
    faces += [row for f, row in enumerate(ball.faces.tolist()) if f not in done]
    corners = np.array(points)[np.array(seams)]
    assert not np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).any()
    return Mesh(np.array(points, np.float32), np.array(faces + seams, np.uint32)), corners


def _turns(row: list[int]) -> list[tuple[int, int, int]]:
    a, b, c = row
    return [(a, b, c), (b, c, a), (c, a, b)]


def test_seams_closed_by_triangles_on_a_line_let_no_ray_through(device: Device) -> None:
    """Four in a hundred of these rays escaped while such triangles could not be hit."""
    mesh, seams = seamed_ball()
    rng = np.random.default_rng(12)
    seam, s = seams[rng.integers(len(seams), size=40000)], rng.random((40000, 1))
    origins = rng.uniform(-3000, 3000, (40000, 3))
    directions = (1 - s) * seam[:, 0] + s * seam[:, 2] - origins
    assert brute_force(mesh, origins, directions, device=device).mask.all()
