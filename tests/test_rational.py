"""The exact reference: against a tiny real perturbation, against parity, and with and without its filter."""

from __future__ import annotations

from collections import Counter
from fractions import Fraction

import numpy as np
import numpy.typing as npt
import pytest
from adversarial import CLOSED, cases, fan_scene, fans, inside_rays, structured
from fans import TRIANGLES
from hypothesis import given, settings
from hypothesis import strategies as st
from meshes import CLOSED as CLOSED_NAMES
from meshes import MESHES, soup
from scenes import scene

from clgrid import prefilter, procedural
from clgrid.closed import open_edges
from clgrid.errors import InputError
from clgrid.mesh import Mesh, load
from clgrid.rational import Crossing, Triangles, closest, count, crossing_t, crossings, inside, plane_t

Case = tuple[npt.NDArray[np.floating], npt.NDArray[np.float64], npt.NDArray[np.float64]]
Row = list[int]

ALL_CLOSED = {name: mesh for name, (mesh, _) in CLOSED.items()} | {n: MESHES[n] for n in CLOSED_NAMES}


def integers(values: npt.NDArray[np.floating]) -> tuple[list[int], int]:
    """Values times 2**exponent, and the exponent."""
    exact = [Fraction(float(value)) for value in values.reshape(-1)]
    exponent = max(value.denominator for value in exact).bit_length() - 1
    return [int(value * 2**exponent) for value in exact], exponent


def sub(a: Row, b: Row) -> Row:
    return [x - y for x, y in zip(a, b, strict=True)]


def dot(a: Row, b: Row) -> int:
    return sum(x * y for x, y in zip(a, b, strict=True))


def cross(a: Row, b: Row) -> Row:
    return [a[i - 2] * b[i - 1] - a[i - 1] * b[i - 2] for i in range(3)]


def really_moved(case: Case) -> tuple[list[Crossing], bool]:
    """All crossings, and whether the origin is inside, with the origin really moved by (e, e^2, e^3).

    Möller and Trumbore's test in integers. Positions take L bits and directions R, so that an edge function
    or numerator of t that is not zero is at least 1, and what e makes of it at most e 2^(2L + R + 4): with
    e = 2^-K every sign is that of an infinitely small e.
    """
    corners, origin, direction = case
    flat, scale = integers(np.concatenate([origin, corners.reshape(-1)]).astype(np.float64))
    d, d_scale = integers(direction)
    bits = 2 * max(map(abs, flat)).bit_length() + max(map(abs, d)).bit_length() + 16
    one = 3 * bits
    points = [[value << one for value in flat[i : i + 3]] for i in range(0, len(flat), 3)]
    o, corners_ = points[0], points[1:]
    moved = [value + (1 << (one - bits * (axis + 1))) for axis, value in enumerate(o)]
    found, odd = [], False
    for id_ in range(len(corners)):
        a, b, c = corners_[3 * id_ : 3 * id_ + 3]
        ab, ac = sub(b, a), sub(c, a)
        p = cross(d, ac)
        det = dot(ab, p)
        if det == 0:
            continue
        sign = 1 if det > 0 else -1
        s = sub(moved, a)
        u, v = sign * dot(s, p), sign * dot(d, cross(s, ab))
        w = sign * det - u - v
        t = sign * dot(ac, cross(s, ab))
        assert u != 0, "the perturbed case is generic"
        assert v != 0
        assert w != 0
        assert t != 0
        if min(u, v, w) > 0:
            exact = Fraction(dot(ac, cross(sub(o, a), ab)), det) / 2**one
            found.append(Crossing(id_, exact * Fraction(2**d_scale, 2**scale)))
            odd ^= t > 0
    return sorted(found, key=lambda crossing: (crossing.t, crossing.id)), odd


def unfiltered(mesh: Mesh, origin: npt.ArrayLike, direction: npt.ArrayLike) -> list[Crossing]:
    """Crossings with every triangle, in portions too small for the filter."""
    corners, found = mesh.vertices[mesh.faces], []
    for start in range(0, len(corners), 64):
        part = crossings(corners[start : start + 64], origin, direction)
        found += [Crossing(crossing.id + start, crossing.t) for crossing in part]
    return sorted(found, key=lambda crossing: (crossing.t, crossing.id))


@settings(max_examples=600)
@given(cases())
def test_equals_a_real_tiny_perturbation(case: Case) -> None:
    found, odd = really_moved(case)
    assert crossings(*case) == found
    assert inside(*case) == odd


@settings(max_examples=600)
@given(cases())
def test_filter_changes_nothing(case: Case) -> None:
    corners, origin, direction = case
    prepared = Triangles.of_corners(corners)
    assert crossings(prepared, origin, direction) == crossings(*case)
    assert inside(prepared, origin, direction) == inside(*case)


def test_bulk_fans_equal_a_real_tiny_perturbation() -> None:
    """The fans are as degenerate as they say: many crossings have equal t, many lie on edges."""
    equal, on_edge, hits = 0, 0, Counter[int]()
    for case in fans(1000, seed=3):
        found, odd = really_moved(case)
        assert crossings(*case) == found
        assert crossings(Triangles.of_corners(case[0]), *case[1:]) == found
        assert inside(*case) == odd
        equal += len({crossing.t for crossing in found}) < len(found)
        mirrored = -case[0], -case[1], -case[2]
        # A perturbation the other way takes other triangles exactly where an edge is met.
        on_edge += {c.id for c in crossings(*mirrored)} != {c.id for c in found}
        hits[len(found)] += 1
    assert equal > 100
    assert on_edge > 150
    assert all(hits[number] > 10 for number in range(4))


@pytest.mark.parametrize(("dtype", "exponent"), [(np.float32, 0), (np.float32, -60), (np.float64, 400)])
def test_fans_of_a_scene_are_met_alone(dtype: type, exponent: int) -> None:
    scene = fan_scene(300, 4, rays=2, dtype=dtype, exponent=exponent)
    assert scene.mesh.vertices.dtype == dtype
    prepared, met = Triangles.of_mesh(scene.mesh), 0
    for ray in range(len(scene.origins)):
        line = scene.origins[ray], scene.directions[ray]
        alone = closest(scene.corners(ray), *line, 0.0, scene.t_max[ray])
        whole = closest(prepared, *line, 0.0, scene.t_max[ray])
        if alone is None:
            assert whole is None
        else:
            assert whole == Crossing(alone.id + TRIANGLES * int(scene.fan[ray]), alone.t)
            met += 1
    assert met > 200


@pytest.mark.parametrize("name", ALL_CLOSED)
def test_lines_cross_closed_meshes_an_even_number_of_times(name: str) -> None:
    mesh = ALL_CLOSED[name]
    prepared, met = Triangles.of_mesh(mesh), 0
    for origin, direction in zip(*structured(mesh, 200, seed=1), strict=True):
        found = crossings(prepared, origin, direction)
        assert len(found) % 2 == 0, (origin, direction)
        met += bool(found)
    assert met > 50


@pytest.mark.parametrize("name", ["scans/armadillo.obj", "scans/horse.ply", "cad/gears.stl"])
def test_lines_cross_closed_scans_an_even_number_of_times(name: str) -> None:
    mesh = load(scene(name))
    assert open_edges(mesh) == 0
    prepared, met = Triangles.of_mesh(mesh), 0
    for origin, direction in zip(*structured(mesh, 300, seed=1), strict=True):
        found = crossings(prepared, origin, direction)
        assert len(found) % 2 == 0, (origin, direction)
        met += bool(found)
    assert met > 150


@pytest.mark.parametrize("name", CLOSED)
def test_half_lines_leave_closed_meshes_an_odd_number_of_times(name: str) -> None:
    mesh, points = CLOSED[name]
    prepared = Triangles.of_mesh(mesh)
    for origin, direction in zip(*inside_rays(mesh, points, 150, seed=2), strict=True):
        assert inside(prepared, origin, direction), (origin, direction)
        assert count(prepared, origin, direction) % 2 == 1


@pytest.mark.parametrize("name", CLOSED)
def test_points_outside_and_on_a_surface_agree_in_every_direction(name: str) -> None:
    mesh, _ = CLOSED[name]
    prepared = Triangles.of_mesh(mesh)
    corners = mesh.vertices[mesh.faces].astype(np.float64)[:12]
    outside = mesh.bounds[0] - 0.125
    for point in [outside, *corners[:, 0], *(corners[:, 0] / 2 + corners[:, 1] / 2)]:
        _, directions = inside_rays(mesh, [point], 25, seed=3)
        answers = {inside(prepared, point, direction) for direction in directions}
        assert len(answers) == 1, point
        assert answers == {False} or point is not outside


def test_twice_the_same_surface_has_no_inside() -> None:
    ball = procedural.icosphere(1)
    twice = Triangles.of_corners(np.repeat(ball.vertices[ball.faces], 2, axis=0))
    for origin, direction in zip(*inside_rays(ball, [(0, 0, 0)], 60), strict=True):
        assert not inside(twice, origin, direction)
        found = crossings(twice, origin, direction)
        assert [c.t for c in found[::2]] == [c.t for c in found[1::2]]


@pytest.mark.parametrize("name", MESHES)
def test_filter_changes_nothing_for_lines_made_to_fool_it(name: str) -> None:
    mesh = MESHES[name]
    prepared = Triangles.of_mesh(mesh)
    for origin, direction in zip(*structured(mesh, 40, seed=5), strict=True):
        assert crossings(prepared, origin, direction) == unfiltered(mesh, origin, direction)


def test_filter_keeps_what_lies_within_a_rounding_of_the_line() -> None:
    """Lines at a corner of far too many triangles, in coordinates that do not divide."""
    rng = np.random.default_rng(8)
    for scale in (1.0, 1e-300, 1e300, 1e-9):
        apex = rng.normal(size=3) * scale
        rim = apex + rng.normal(size=(500, 3)) * scale * 10.0 ** rng.uniform(-12, 0, (500, 1))
        mesh = soup(np.stack([np.broadcast_to(apex, rim.shape), rim, np.roll(rim, 1, axis=0)], 1), np.float64)
        prepared = Triangles.of_mesh(mesh)
        for _ in range(10):
            origin = apex + rng.normal(size=3) * scale * 10.0 ** rng.uniform(-3, 3)
            direction = apex - origin
            expected = unfiltered(mesh, origin, direction)
            assert crossings(prepared, origin, direction) == expected
            assert len(expected) > 20


def test_filter_drops_nearly_everything() -> None:
    mesh = procedural.icosphere(5)
    prepared = Triangles.of_mesh(mesh)
    kept = [
        len(prepared.near(o.tolist(), d.tolist()))
        for o, d in zip(*structured(mesh, 100, seed=2), strict=True)
    ]
    assert mesh.triangle_count == 20480
    assert np.median(kept) < 40
    # As far away as a double reaches, and with every coordinate far from zero.
    assert len(prepared.near([1e300, 2e300, 3e300], [-1.0, -2.0, -3.0])) < 40
    far = Triangles.of_corners(mesh.vertices[mesh.faces].astype(np.float64) + 1e9)
    assert len(far.near([1e9, 1e9, 1e9], [1.0, 0.5, 0.25])) < 40


def test_portions_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = MESHES["ball"]
    rays = list(zip(*structured(mesh, 60, seed=6), strict=True))
    expected = [crossings(Triangles.of_mesh(mesh), *ray) for ray in rays]
    monkeypatch.setattr(prefilter, "_BLOCK", 3)
    monkeypatch.setattr(prefilter, "_BLOCKS_AT_ONCE", 2)
    assert [crossings(Triangles.of_mesh(mesh), *ray) for ray in rays] == expected


def test_a_filter_without_margin_would_be_found_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(prefilter, "MARGIN", -1e-14)
    with pytest.raises(AssertionError):
        test_filter_changes_nothing_for_lines_made_to_fool_it("ball")


SQUARE = np.array([[[0, 0, 1], [2, 0, 1], [2, 2, 1]], [[0, 0, 1], [2, 2, 1], [0, 2, 1]]], np.float32)


def test_diagonal_of_a_square_belongs_to_one_triangle() -> None:
    """The origin moves by e in x first, to the side of triangle 0; at a corner it moves inwards or out."""
    assert crossings(SQUARE, (1, 1, 0), (0, 0, 2)) == [Crossing(0, Fraction(1, 2))]
    assert crossings(SQUARE, (1, 1, 3), (0, 0, -1)) == [Crossing(0, Fraction(2))]
    assert crossings(SQUARE, (0, 0, 0), (0, 0, 1)) == [Crossing(0, Fraction(1))]
    assert crossings(SQUARE, (2, 2, 0), (0, 0, 1)) == []
    assert crossings(SQUARE, (0, 1, 0), (0, 0, 1)) == [Crossing(1, Fraction(1))]
    assert crossings(SQUARE, (2, 1, 0), (0, 0, 1)) == []


def test_interval_is_closed_and_exact() -> None:
    ray = (1.5, 0.5, 0.0), (0.0, 0.0, 3.0)
    third = Fraction(1, 3)
    assert closest(SQUARE, *ray, third, third) == Crossing(0, third)
    # The double nearest to a third is less than it.
    assert closest(SQUARE, *ray, 0.0, 1 / 3) is None
    assert count(SQUARE, *ray, 1 / 3) == 1
    assert count(SQUARE, *ray, np.nextafter(1 / 3, 1)) == 0
    assert count(SQUARE, *ray, -np.inf, np.inf) == 1
    assert count(SQUARE, (1.5, 0.5, 1.0), (1, 0, 1)) == 1
    assert count(SQUARE, *ray, np.nan, np.inf) == 0
    assert closest(np.repeat(SQUARE, 3, axis=0), *ray) == Crossing(0, third)


@settings(max_examples=200)
@given(cases(), st.floats(allow_nan=False), st.floats(allow_nan=False))
def test_closest_and_count_are_of_the_crossings(case: Case, t_min: float, t_max: float) -> None:
    within = [c for c in crossings(*case) if t_min <= c.t <= t_max]
    assert count(*case, t_min, t_max) == len(within)
    assert closest(*case, t_min, t_max) == (within[0] if within else None)
    for crossing in crossings(*case):
        triangle = case[0][crossing.id]
        assert plane_t(triangle, *case[1:]) == crossing_t(triangle, *case[1:]) == crossing.t


def test_plane_is_met_outside_of_the_triangle() -> None:
    assert plane_t(SQUARE[0], (100, 100, 0), (1, 0, 0.5)) == 2
    assert plane_t(SQUARE[0], (0, 0, 1), (1, 0, 0)) is None
    assert plane_t(SQUARE[0][[0, 1, 1]], (0, 0, 0), (1, 0, 1)) is None
    assert plane_t(SQUARE[0], (0, 0, 0), (np.inf, 0, 1)) is None


@pytest.mark.parametrize(
    ("origin", "direction"),
    [
        ((np.nan, 0, 0), (0, 0, 1)),
        ((1.5, 0.5, 0), (0, 0, 0)),
        ((1.5, 0.5, 0), (0, -0.0, np.inf)),
        ((1.5, -np.inf, 0), (0, 0, 1)),
    ],
)
@pytest.mark.parametrize("triangles", [SQUARE, Triangles.of_corners(SQUARE)])
def test_rays_that_are_none_meet_nothing(triangles: object, origin: object, direction: object) -> None:
    assert crossings(triangles, origin, direction) == []
    assert closest(triangles, origin, direction) is None
    assert not inside(triangles, origin, direction)


def test_nothing_to_cross() -> None:
    nothing = np.zeros((0, 3, 3), np.float32)
    assert crossings(nothing, (0, 0, 0), (0, 0, 1)) == []
    assert crossings(Triangles.of_corners(nothing), (0, 0, 0), (0, 0, 1)) == []


def test_wrong_arrays_are_refused() -> None:
    with pytest.raises(InputError, match=r"shape \(3, 3\)"):
        crossings(SQUARE[0], (0, 0, 0), (0, 0, 1))
    with pytest.raises(InputError, match="int64"):
        Triangles.of_corners(SQUARE.astype(np.int64))
    with pytest.raises(InputError, match="NaN"):
        crossings(np.where(SQUARE == 2, np.nan, SQUARE), (0, 0, 0), (0, 0, 1))
    with pytest.raises(InputError, match="direction"):
        crossings(SQUARE, (0, 0, 0), (0, 1))
