"""The contract of t_err on ``robust`` and ``precise``: it holds the true t, and is small."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import numpy.typing as npt
import pytest
from adversarial import FAMILIES, structured
from agreement import Errors, fields_of, query, size_in
from meshes import MESHES, scaled, soup
from rays import surroundings

from clgrid.brute import brute_force
from clgrid.device import Device
from clgrid.mesh import Mesh
from clgrid.rational import crossings, plane_t

F64 = npt.NDArray[np.float64]
U = {"robust": 2.0**-24, "precise": 2.0**-53}
"""Half an ulp of 1 in the arithmetic of a rung."""


def wide_soup(by: float = 1.0) -> Mesh:
    """Triangles of all sizes whose coordinates need float64."""
    rng = np.random.default_rng(61)
    sizes = 10.0 ** rng.uniform(-4, 0, (400, 1, 1))
    return soup((rng.uniform(-1, 1, (400, 1, 3)) + sizes * rng.normal(size=(400, 3, 3))) * by, np.float64)


def needles(aspect: float = 1e4) -> Mesh:
    """Long thin triangles in all directions."""
    rng = np.random.default_rng(62)
    a, b = rng.uniform(-1, 1, (2, 300, 3))
    return soup(np.stack([a, b, a + 0.4 * (b - a) + rng.normal(size=(300, 3)) / aspect], axis=1))


def rays_at_needles(mesh: Mesh, count: int) -> tuple[F64, F64]:
    """Through the inside of thin triangles: none would be met by chance."""
    rng = np.random.default_rng(63)
    corners = mesh.vertices[mesh.faces[rng.integers(mesh.triangle_count, size=count)]].astype(np.float64)
    weights = rng.dirichlet([2, 2, 2], size=count)
    origins = rng.uniform(-2, 2, (count, 3))
    return origins, (corners * weights[:, :, None]).sum(axis=1) - origins


def families(*names: str) -> Callable[[Mesh, int], tuple[F64, F64]]:
    """Rays of these families, evenly."""

    def rays(mesh: Mesh, count: int) -> tuple[F64, F64]:
        around = surroundings(mesh, (5, 4, 6))
        parts = [
            FAMILIES[name](around, count // len(names), np.random.default_rng([64, k]))
            for k, name in enumerate(names)
        ]
        return np.concatenate([o for o, _ in parts]), np.concatenate([d for _, d in parts])

    return rays


@dataclass(frozen=True)
class Kind:
    """Rays at a mesh, and how large t_err may be, in U of the mesh's size: in the middle, and mostly."""

    mesh: Callable[[], Mesh]
    rays: Callable[[Mesh, int], tuple[F64, F64]]
    median: float
    most: float
    """Of 95 % of hits."""


BALL, TORUS = (lambda: MESHES["ball"]), (lambda: MESHES["torus"])
ANYHOW = families("around_random", "exactly_at")
KINDS = {
    "random": Kind(TORUS, families("around_random", "from_inside"), 100, 1e4),
    "at edges and vertices": Kind(TORUS, families("exactly_at", "around_at_edges"), 100, 1e4),
    "grazing": Kind(TORUS, families("around_grazing", "within_planes", "along_edges"), 1e6, 1e9),
    "slender": Kind(needles, rays_at_needles, 2e5, 1e7),
    "far origins": Kind(
        BALL, families("from_afar", "around_from_1e6_diagonals", "around_from_100_diagonals"), 100, 1e4
    ),
    "float64 mesh": Kind(wide_soup, ANYHOW, 200, 1e5),
    "far float64 mesh": Kind(lambda: MESHES["far_float64"], ANYHOW, 200, 1e5),
    "tiny float64 mesh": Kind(lambda: wide_soup(1e-25), ANYHOW, 200, 1e5),
    "huge mesh": Kind(lambda: scaled(MESHES["ball"], 1e25), ANYHOW, 200, 1e5),
    "secondary": Kind(TORUS, families("from_surface", "around_from_surface"), 200, 1e6),
}


@functools.lru_cache(maxsize=1)
def rays_of(name: str) -> tuple[Mesh, F64, F64]:
    kind = KINDS[name]
    mesh = kind.mesh()
    o, d = kind.rays(mesh, 6000)
    return mesh, o, d


def touched_t(triangle: npt.NDArray[np.floating], origin: F64, direction: F64) -> Fraction | None:
    """Exact t of the closed triangle; None where the ray's line misses it, or lies in its plane."""
    t = plane_t(triangle, origin, direction)
    if t is None:
        return None
    o, d, *corners = (
        [Fraction(float(value)) for value in row] for row in (origin, direction, *triangle.astype(np.float64))
    )
    a, b, c = ([x - y for x, y in zip(corner, o, strict=True)] for corner in corners)

    def side(p: list[Fraction], q: list[Fraction]) -> Fraction:
        return sum((d[i - 2] * (p[i - 1] * q[i] - p[i] * q[i - 1]) for i in range(3)), Fraction(0))

    signs = {(value > 0) - (value < 0) for value in (side(a, b), side(b, c), side(c, a))}
    return None if {-1, 1} <= signs else t


@functools.lru_cache(maxsize=4)
def truth(name: str, ids: bytes) -> list[Fraction | None]:
    """Of each hit ray, in order, the exact t: computed once for all devices, whose ids are the same."""
    mesh, o, d = rays_of(name)
    found = np.frombuffer(ids, np.int64)
    return [touched_t(mesh.vertices[mesh.faces[i]], o[k], d[k]) for k, i in enumerate(found) if i >= 0]


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize("accuracy", ["robust", "precise"])
@pytest.mark.parametrize("name", KINDS)
def test_t_err_holds_the_true_t_and_is_small(
    name: str, accuracy: str, device: Device, record_property: Callable[[str, object], None]
) -> None:
    mesh, o, d = rays_of(name)
    hits = brute_force(
        mesh, *query(o, d, -np.inf), device=device, accuracy=accuracy, fields=fields_of(accuracy)
    )
    assert np.isfinite(hits.t_err).all()
    assert (hits.t_err[hits.mask] > 0).all()
    assert (hits.t_err[~hits.mask] == 0).all()
    errors, sizes = Errors(), size_in(mesh, d)
    exact = truth(name, hits.primitive_ids.tobytes())
    for ray, t in zip(np.flatnonzero(hits.mask), exact, strict=True):
        if t is not None:
            errors.add(float(hits.t_hit[ray]), float(hits.t_err[ray]), t, sizes[ray])
    record_property("errors", errors.summary())
    assert len(errors.used) > 0.4 * len(exact) > 200
    units = np.array(errors.relative) / U[accuracy]
    assert np.median(units) < KINDS[name].median, errors.summary()
    assert np.quantile(units, 0.95) < KINDS[name].most, np.quantile(units, 0.95)
    # A bound that no error comes near to is no bound but a guess.
    assert max(errors.used) > 0.01


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize("accuracy", ["robust", "precise"])
@pytest.mark.parametrize(
    "name", ["edge_on_slivers", "needle_fan", "stacks", "soup", "far_float32", "times_1e-30"]
)
def test_no_adversarial_ray_breaks_t_err(
    name: str, accuracy: str, device: Device, record_property: Callable[[str, object], None]
) -> None:
    mesh = MESHES[name]
    rays = query(*structured(mesh, 1200, 65), -np.inf)
    hits = brute_force(mesh, *rays, device=device, accuracy=accuracy, fields=fields_of(accuracy))
    assert np.isfinite(hits.t_err).all()
    checked = 0
    errors, sizes = Errors(), size_in(mesh, rays[1])
    for ray in np.flatnonzero(hits.mask)[:1200]:
        triangle = mesh.vertices[mesh.faces[hits.primitive_ids[ray]]]
        t = touched_t(triangle, rays[0][ray], rays[1][ray])
        if t is not None:
            errors.add(float(hits.t_hit[ray]), float(hits.t_err[ray]), t, sizes[ray])
            checked += 1
    record_property("errors", errors.summary())
    assert checked > 100


def test_t_err_of_a_known_hit(device: Device) -> None:
    """A triangle faced at t = 2: a few roundings, and exact where nothing is rounded."""
    mesh = Mesh(np.array([[0, 0, 0], [4, 0, 0], [0, 4, 0]], np.float32), np.array([[0, 1, 2]], np.uint32))
    for accuracy in ("robust", "precise"):
        for scale in (1.0, 1e-20, 1e20):
            hits = brute_force(mesh, (1, 2, 6), (0, 0, -3 * scale), device=device, accuracy=accuracy,
                               fields=fields_of(accuracy))  # fmt: skip
            assert hits.t_hit == pytest.approx(2 / scale)
            assert 0 < hits.t_err * scale < 200 * U[accuracy]
            true = crossings(mesh.vertices[mesh.faces], (1.0, 2.0, 6.0), (0.0, 0.0, -3 * scale))[0].t
            assert abs(Fraction(float(hits.t_hit)) - true) <= Fraction(float(hits.t_err))
