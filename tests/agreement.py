"""What answers must agree on: every bit between two ways to cast, and the exact reference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import numpy as np
import numpy.typing as npt

from clgrid.brute import brute_force, brute_force_count
from clgrid.device import Device
from clgrid.grid import Grid, build
from clgrid.hits import AllHits, Hits
from clgrid.layouts import ALL_LAYOUTS
from clgrid.layouts.lists import NESTED
from clgrid.mesh import Mesh
from clgrid.rational import Crossing, Triangles, crossings
from clgrid.rungs import LOSSLESS

F64 = npt.NDArray[np.float64]
Query = tuple[npt.NDArray[Any], npt.NDArray[Any], F64, F64]
"""Origins, directions, t_min and t_max; one row a ray, so that few variants of kernels are compiled."""

RUNGS = LOSSLESS
KINDS = [
    (layout, skipping)
    for layout in ALL_LAYOUTS
    for skipping in (False, True)
    if layout not in NESTED or not skipping
    if layout != "nested-hashed"
]
"""Every layout, without skipping and with it where it has that, but for the nested hashed one.

That one differs from the nested one in how lists are found, which test_nested tries on every rung.
"""
ALL = ("primitive_uvs", "t_err")


def fields_of(accuracy: str) -> tuple[str, ...]:
    """All that ``cast`` computes on a rung, but for the counters of the walk."""
    return (*ALL, "certain") if accuracy == "exact" else ALL


def query(
    origins: npt.ArrayLike, directions: npt.ArrayLike, low: npt.ArrayLike = 0.0, high: npt.ArrayLike = np.inf
) -> Query:
    """Rays with their intervals, by row."""
    o, d = np.atleast_2d(np.asarray(origins)), np.atleast_2d(np.asarray(directions))
    o, d = (np.ascontiguousarray(side) for side in np.broadcast_arrays(o, d))
    t_min, t_max = (np.array(np.broadcast_to(np.asarray(side, np.float64), len(o))) for side in (low, high))
    return o, d, t_min, t_max


def part(rays: Query, rows: Any) -> Query:
    """Some of the rays."""
    o, d, low, high = rays
    return o[rows], d[rows], low[rows], high[rows]


def bits(array: npt.NDArray[Any]) -> npt.NDArray[np.unsignedinteger[Any]]:
    """The array as integers, so that equal means every bit."""
    whole = np.ascontiguousarray(array)
    return whole.view(f"u{whole.dtype.itemsize}")


def assert_same(found: Hits | AllHits, expected: Hits | AllHits) -> None:
    """Every bit of all that was computed."""
    assert set(found.computed) == set(expected.computed)
    names = ["primitive_ids", "t_hit", *expected.computed]
    if isinstance(expected, AllHits):
        names.insert(0, "ray_splits")
    for name in names:
        assert found[name].dtype == expected[name].dtype
        np.testing.assert_array_equal(bits(found[name]), bits(expected[name]), err_msg=name)
    assert found.invalid_rays == expected.invalid_rays


@dataclass
class Answers:
    """All queries of the same rays."""

    hits: Hits
    counts: npt.NDArray[np.uint32]
    every: AllHits


def ask(grid: Grid, rays: Query) -> Answers:
    """All queries at once; asserts that they are consistent with each other."""
    hits = grid.cast(*rays, fields=fields_of(grid.accuracy))
    answers = Answers(hits, grid.count(*rays), grid.cast_all(*rays, fields=ALL))
    assert_consistent(answers)
    np.testing.assert_array_equal(grid.occluded(*rays), answers.counts > 0)
    return answers


def assert_consistent(answers: Answers) -> None:
    """Counts are those of all hits; the first of these is the closest; they are sorted by (t, id)."""
    hits, every = answers.hits, answers.every
    np.testing.assert_array_equal(answers.counts.reshape(-1), every.counts)
    mask = hits.mask.reshape(-1)
    np.testing.assert_array_equal(mask, every.counts > 0)
    first = every.ray_splits[:-1][mask]
    for name in ("primitive_ids", "t_hit", *every.computed):
        own = hits[name].reshape(-1, *every[name].shape[1:])[mask]
        np.testing.assert_array_equal(bits(every[name][first]), bits(own), err_msg=f"first hit, {name}")
    together = every.ray_ids[1:] == every.ray_ids[:-1]
    t, ids = every.t_hit, every.primitive_ids
    assert (t[1:] >= t[:-1])[together].all()
    exact = hits.computed.get("certain") is not None
    if not exact:  # there, unequal t may be reported as equal
        assert (ids[1:] > ids[:-1])[together & (t[1:] == t[:-1])].all()
    pairs = np.stack([every.ray_ids, ids])
    assert np.unique(pairs, axis=1).shape == pairs.shape, "a triangle counts once a ray"


def assert_lossless(
    mesh: Mesh, device: Device, accuracy: str, rays: Query, grids: Sequence[dict[str, Any]]
) -> Answers:
    """All grids answer as brute force does, in every bit; what the first one answers.

    ``cast_all`` has no brute force: all grids are held against that of a single cell.
    """
    expected = brute_force(mesh, *rays, device=device, accuracy=accuracy, fields=fields_of(accuracy))
    counts = brute_force_count(mesh, *rays, device=device, accuracy=accuracy)
    one_cell = build(mesh, resolution=(1, 1, 1), accuracy=accuracy, device=device)
    every = one_cell.cast_all(*rays, fields=ALL)
    assert_consistent(Answers(expected, counts, every))
    answers = None
    for options in grids:
        found = ask(build(mesh, accuracy=accuracy, device=device, **options), rays)
        assert_same(found.hits, expected)
        np.testing.assert_array_equal(found.counts, counts)
        assert_same(found.every, every)
        answers = answers or found
    return answers or Answers(expected, counts, every)


@dataclass
class Errors:
    """Of hits against the exact reference."""

    used: list[float] = field(default_factory=list)
    """|t_hit - t| / t_err of each."""
    relative: list[float] = field(default_factory=list)
    """t_err in units of the larger of t and the mesh's size in lengths of the direction."""

    def add(self, t_hit: float, t_err: float, exact: Fraction, size: float) -> None:
        """One more hit: within its error."""
        assert np.isfinite(t_err), f"t_err is {t_err}"
        off = abs(Fraction(t_hit) - exact)
        assert off <= Fraction(t_err), f"t {t_hit!r} is {float(off)} off {float(exact)!r}, t_err {t_err}"
        self.used.append(float(off / Fraction(t_err)) if off else 0.0)
        self.relative.append(float(Fraction(t_err) / max(abs(exact), Fraction(size))))

    def summary(self) -> str:
        """Median and worst share of the error that was used, and its median and largest size."""
        if not self.used:
            return "no hits"
        return (
            f"{len(self.used)} hits; |t - t*| / t_err median {np.median(self.used):.3g} "
            f"worst {max(self.used):.3g}; t_err relative median {np.median(self.relative):.3g} "
            f"worst {max(self.relative):.3g}"
        )


def size_in(mesh: Mesh, directions: npt.NDArray[Any]) -> F64:
    """(N,) the mesh's largest extent in lengths of each direction."""
    extent = float((mesh.bounds[1] - mesh.bounds[0]).max()) or 1.0
    longest = np.abs(directions.astype(np.float64)).max(axis=1)
    with np.errstate(all="ignore"):
        return np.where(longest > 0, extent / longest, 1.0)


Truth = list[list[Crossing]]


def truth_of(triangles: Triangles, rays: Query) -> Truth:
    """Of each ray, all crossings in its interval, by (t, id)."""
    return [
        [crossing for crossing in crossings(triangles, o, d) if low <= crossing.t <= high]
        for o, d, low, high in zip(*rays, strict=True)
    ]


def assert_exact(answers: Answers, truth: Truth, mesh: Mesh, rays: Query) -> Errors:
    """Hit or miss, triangle, count and order are the truth's, and t is within its error of it."""
    hits, every, errors = answers.hits, answers.every, Errors()
    ids = np.array([row[0].id if row else -1 for row in truth], np.int64)
    np.testing.assert_array_equal(hits.primitive_ids, ids)
    np.testing.assert_array_equal(answers.counts, [len(row) for row in truth])
    np.testing.assert_array_equal(every.primitive_ids, [crossing.id for row in truth for crossing in row])
    sizes = size_in(mesh, rays[1])
    position = 0
    for ray, row in enumerate(truth):
        if row:
            errors.add(float(hits.t_hit[ray]), float(hits.t_err[ray]), row[0].t, sizes[ray])
        for crossing in row:
            t_hit, t_err = float(every.t_hit[position]), float(every.t_err[position])
            errors.add(t_hit, t_err, crossing.t, sizes[ray])
            position += 1
    return errors
