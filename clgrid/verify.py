"""Verify a scene: structured rays through the grid, by brute force and, for a sample, in exact arithmetic.

What a rung promises (docs/numerics.md) is checked; what it does not promise is counted.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np
import numpy.typing as npt

from clgrid import record
from clgrid.brute import brute_force, brute_force_count
from clgrid.device import Device
from clgrid.errors import InputError
from clgrid.grid import Grid, build
from clgrid.hits import Hits
from clgrid.mesh import Mesh
from clgrid.rational import Crossing, Triangles, crossings
from clgrid.resolution import checked
from clgrid.rungs import ACCURACIES, LOSSLESS, Rung
from clgrid.scene import Scene
from clgrid.structured import KINDS, Aim, Batch, inside_points, structured
from clgrid.verify_record import FailedRay, VerifyRecord, VerifyRow
from clgrid.workload import bit_rows

Mask = npt.NDArray[np.bool_]
F64 = npt.NDArray[np.float64]
Progress = Callable[[str, float | None], None]
InWords = Callable[[int], object]

_BATCH = 1 << 17
# Rays times triangles that brute force tests on a rung: seconds on a few cores.
_MOST_TESTS = 4_000_000_000
_LOSSLESS_CHECKS = ("escapes", "bits", "counts", "late")
PROMISES = {
    **dict.fromkeys(LOSSLESS, _LOSSLESS_CHECKS),
    "exact": (*_LOSSLESS_CHECKS, "odd_lines", "even_inside", "wrong_hits", "wrong_ids", "wrong_counts"),
}
"""The checks of ``VerifyRow`` that no ray may fail, by rung."""


@dataclass(frozen=True)
class Plan:
    """What is cast.

    Attributes
    ----------
    accuracies : tuple of str
        Rungs, each with a grid of its own.
    rays : int
    check : int, optional
        How many of them to compare with brute force; by default all, or what 4e9 tests allow.
    exact : int
        How many of them to compare with exact arithmetic, some hundred to a thousand a second.
    seed : int
        Of the rays.
    layout, density, resolution, max_memory, skipping
        As for ``clgrid.build``.
    aim : (int, int, int), optional
        Resolution of the grid at whose planes and corners rays are aimed; by default that of the first rung's
        grid. With the same seed, aim and number the rays are the same, whatever the grid.

    Raises
    ------
    InputError
        If a rung is unknown or a number is out of range.
    """

    accuracies: tuple[str, ...] = LOSSLESS
    rays: int = 100_000
    check: int | None = None
    exact: int = 2000
    seed: int = 0
    layout: str = "compact"
    density: float | str = "auto"
    resolution: tuple[int, int, int] | None = None
    max_memory: int | None = None
    skipping: bool = False
    aim: tuple[int, int, int] | None = None

    def __post_init__(self) -> None:
        unknown = [name for name in self.accuracies if name not in ACCURACIES]
        if unknown or not self.accuracies:
            wrong = repr(unknown[0]) if unknown else "none"
            raise InputError(f"verify: accuracy is {wrong}; choose of {', '.join(ACCURACIES)}")
        if self.rays < 1 or min(self.check or 0, self.exact, self.seed) < 0:
            raise InputError("verify: give at least 1 ray, and no check, exact or seed below 0")
        if self.aim is not None:
            checked(self.aim)

    def build(self, mesh: Mesh, accuracy: str, device: Device) -> Grid:
        """The grid of a rung."""
        return build(
            mesh,
            layout=self.layout,
            density=self.density,
            resolution=self.resolution,
            accuracy=accuracy,
            device=device,
            max_memory=self.max_memory,
            skipping=self.skipping,
            rays=self.rays,
        )

    def sample(self, triangles: int) -> tuple[int, int]:
        """Rays to compare with brute force and with exact arithmetic."""
        # Nearest hits and counts: each ray is cast twice.
        bounded = _MOST_TESTS // (2 * max(triangles, 1))
        return min(self.rays, bounded if self.check is None else self.check), min(self.rays, self.exact)


@dataclass
class _Tally:
    """What is found of one rung's rays, batch by batch."""

    grid: Grid
    rays: int = 0
    hits: int = 0
    inside: int = 0
    checked: int = 0
    exact_checked: int = 0
    ulps: list[float] = field(default_factory=list)
    shares: list[float] = field(default_factory=list)
    failed: dict[str, FailedRay] = field(default_factory=dict)

    def note(self, check: str, wrong: Mask, batch: Batch, found: InWords, expected: InWords) -> None:
        """Count the rays of the batch's beginning that are wrong, and keep the first of all."""
        rows = np.flatnonzero(wrong)
        if not len(rows):
            return
        row, known = int(rows[0]), self.failed.get(check)
        first = known or FailedRay(
            check=check,
            rays=0,
            kind=KINDS[int(batch.kinds[row])],
            origin=_triple(batch.origins[row]),
            direction=_triple(batch.directions[row]),
            found=str(found(row)),
            expected=str(expected(row)),
        )
        self.failed[check] = _with_rays(first, first.rays + len(rows))

    def number(self, check: str) -> int:
        return self.failed[check].rays if check in self.failed else 0

    def row(self, *, closed: bool) -> VerifyRow:
        grid, stats = self.grid, self.grid.stats
        return VerifyRow(
            accuracy=grid.accuracy,
            resolution=stats.resolution,
            references=stats.references,
            grid_bytes=grid.nbytes,
            rays=self.rays,
            hits=self.hits,
            inside=self.inside,
            escapes=self.number("escapes") if self.inside else None,
            odd_lines=self.number("odd_lines") if closed else None,
            even_inside=self.number("even_inside") if self.inside else None,
            checked=self.checked,
            bits=self.number("bits"),
            counts=self.number("counts"),
            exact_checked=self.exact_checked,
            wrong_hits=self.number("wrong_hits"),
            wrong_ids=self.number("wrong_ids"),
            wrong_counts=self.number("wrong_counts"),
            exact_hits=len(self.ulps),
            late=self.number("late") if grid.rung.lossless else None,
            worst_ulps=max(self.ulps, default=None),
            worst_share=max(self.shares, default=None),
            median_share=float(np.median(self.shares)) if self.shares else None,
            broken=tuple(check for check in PROMISES.get(grid.accuracy, ()) if check in self.failed),
            first=list(self.failed.values()),
        )


def _with_rays(first: FailedRay, rays: int) -> FailedRay:
    return FailedRay(**{**{name: getattr(first, name) for name in first.__struct_fields__}, "rays": rays})


def _triple(row: F64) -> tuple[float, float, float]:
    x, y, z = row.tolist()
    return x, y, z


def verify(
    scene: Scene, plan: Plan, device: Device, progress: Progress = lambda step, share: None
) -> VerifyRecord:
    """Cast rays of all kinds through grids of the scene, and check what comes back.

    Parameters
    ----------
    scene : Scene
    plan : Plan
        Which rays, through which grids.
    device : Device
        Where.
    progress : callable
        Called with what is being done, and the share of it that is done, None if not known.

    Raises
    ------
    InputError
        If the mesh has no triangles.
    DeviceError, GridTooLargeError
        If a grid cannot be built.
    """
    mesh = scene.mesh
    if not mesh.triangle_count:
        raise InputError(f"{scene.name} has no triangles to verify; give another scene")
    tallies = []
    for accuracy in plan.accuracies:
        progress(f"build {accuracy}", None)
        tallies.append(_Tally(plan.build(mesh, accuracy, device)))
    aim = Aim.at(mesh, plan.aim or tallies[0].grid.stats.resolution)
    closed = tallies[0].grid.open_edges == 0
    points = np.zeros((0, 3))
    if closed:
        progress("find points inside", None)
        points = well_inside(aim, device, plan.seed)
    checks, exact_checks = plan.sample(mesh.triangle_count)
    triangles = Triangles.of_mesh(mesh) if exact_checks else None
    kinds = np.zeros(len(KINDS), np.int64)
    start = 0
    for batch in batches(aim, points, plan.rays, plan.seed):
        kinds += np.bincount(batch.kinds, minlength=len(KINDS))
        sample, exact_sample = (sample_of(batch, n, plan.rays) for n in (checks, exact_checks))
        expected = _in_exact_arithmetic(triangles, batch, exact_sample, progress)
        for tally in tallies:
            progress(f"cast {tally.grid.accuracy}", start / plan.rays)
            _inspect(tally, batch, sample, expected, closed=closed)
        start += len(batch)
    return VerifyRecord(
        schema=record.schema("verify"),
        clgrid=record.version(),
        device=record.describe_device(device),
        compiled=record.describe_builds(device),
        seeds={"rays": plan.seed},
        scene=scene.name,
        triangles=mesh.triangle_count,
        open_edges=tallies[0].grid.open_edges,
        layout=tallies[0].grid.layout,
        density=plan.density,
        skipping=plan.skipping,
        kinds=dict(zip(KINDS, kinds.tolist(), strict=True)),
        rows=[tally.row(closed=closed) for tally in tallies],
        warnings=mesh.warnings,
    )


def batches(aim: Aim, points: F64, rays: int, seed: int) -> Iterator[Batch]:
    """The rays of a seed, some at a time, each batch in random order."""
    for number, start in enumerate(range(0, rays, _BATCH)):
        yield structured(aim, min(_BATCH, rays - start), points, (seed, number))


def sample_of(batch: Batch, wanted: int, rays: int) -> int:
    """How many of the batch's first rays are its part of a sample of all rays."""
    return -(-len(batch) * wanted // rays)


def well_inside(aim: Aim, device: Device, seed: int) -> F64:
    """(P, 3) points inside of a closed mesh and off its surface, told by the rung ``exact``."""
    grid = build(aim.mesh, accuracy="exact", density=4.0, device=device)
    return inside_points(aim, grid.contains, lambda o, d: grid.cast(o, d, fields=()).t_hit, (seed, 1 << 32))


def broken_promises(result: VerifyRecord) -> list[str]:
    """Say, a line each, which check a rung fails that it promises to pass, with the first ray that does."""
    seed = result.seeds["rays"]
    return [
        f"{result.scene}: {row.accuracy}: {first.rays:,} rays fail {first.check!r}; the first, {first.kind}"
        f" (seed {seed}): origin {list(first.origin)}, direction {list(first.direction)}: found"
        f" {first.found}, expected {first.expected}"
        for row in result.rows
        for first in row.first
        if first.check in row.broken
    ]


def _in_exact_arithmetic(
    triangles: Triangles | None, batch: Batch, count: int, progress: Progress
) -> list[list[Crossing]]:
    """All crossings of the lines of the batch's first rays."""
    found: list[list[Crossing]] = []
    for i in range(count if triangles is not None else 0):
        if i % 64 == 0:
            progress("exact arithmetic", i / count)
        assert triangles is not None
        found.append(crossings(triangles, batch.origins[i], batch.directions[i]))
    return found


def compared_fields(rung: Rung) -> tuple[str, ...]:
    """What is compared: ``fast`` knows no error of t."""
    return ("primitive_uvs", "t_err") if rung.lossless else ("primitive_uvs",)


def _inspect(
    tally: _Tally, batch: Batch, sample: int, expected: list[list[Crossing]], *, closed: bool
) -> None:
    """Cast a batch and note all that is wrong with it."""
    grid, rays = tally.grid, (batch.origins, batch.directions)
    hits, counts = grid.cast(*rays, fields=compared_fields(grid.rung)), grid.count(*rays)
    tally.rays += len(batch)
    tally.hits += int(np.count_nonzero(hits.mask))
    if closed:
        inside = batch.inside
        tally.inside += int(np.count_nonzero(inside))
        lines = grid.count(*rays, t_min=-np.inf)
        tally.note("escapes", inside & ~hits.mask, batch, lambda row: "a miss", lambda row: "a hit")
        tally.note("even_inside", inside & (counts % 2 == 0), batch, counts.item, lambda row: "an odd count")
        tally.note("odd_lines", lines % 2 == 1, batch, lines.item, lambda row: "an even count of the line")
    if sample:
        tally.checked += sample
        _compare_with_brute_force(tally, batch, sample, hits, counts)
    if expected:
        tally.exact_checked += len(expected)
        _compare_with_exact(tally, batch, expected, hits, counts)


def _compare_with_brute_force(
    tally: _Tally, batch: Batch, count: int, hits: Hits, counts: npt.NDArray[np.uint32]
) -> None:
    grid, first = tally.grid, slice(count)
    rays = batch.origins[first], batch.directions[first]
    options = {"device": grid.device, "accuracy": grid.accuracy}
    truth = brute_force(grid.mesh, *rays, fields=compared_fields(grid.rung), **options)  # type: ignore[arg-type]
    number = brute_force_count(grid.mesh, *rays, **options)  # type: ignore[arg-type]
    wrong = (bit_rows(hits, first) != bit_rows(truth)).any(axis=-1)
    if grid.rung.lossless:
        wrong |= hits.t_err[first].view(np.uint64) != truth.t_err.view(np.uint64)
    tally.note("bits", wrong, batch, _in_words(hits), _in_words(truth))
    tally.note("counts", counts[first] != number, batch, counts.item, number.item)


def _in_words(hits: Hits) -> InWords:
    def words(row: int) -> str:
        u, v = hits.primitive_uvs[row].tolist()
        t = hits.t_hit.item(row)
        off = f" +- {hits.t_err.item(row)!r}" if "t_err" in hits.computed else ""
        return f"t {t!r}{off}, triangle {hits.primitive_ids[row]}, u {u!r}, v {v!r}"

    return words


def _compare_with_exact(
    tally: _Tally,
    batch: Batch,
    expected: list[list[Crossing]],
    hits: Hits,
    counts: npt.NDArray[np.uint32],
) -> None:
    ahead = [[crossing for crossing in line if crossing.t >= 0] for line in expected]
    nearest = np.array([line[0].id if line else -1 for line in ahead])
    number = np.array([len(line) for line in ahead])
    first = slice(len(expected))
    ids = hits.primitive_ids[first]
    missed = (ids < 0) != (nearest < 0)
    tally.note("wrong_hits", missed, batch, ids.item, nearest.item)
    tally.note("wrong_ids", ~missed & (ids != nearest), batch, ids.item, nearest.item)
    tally.note("wrong_counts", counts[first] != number, batch, counts.item, number.item)
    late, exact = np.zeros(len(ids), np.bool_), [Fraction(0)] * len(ids)
    last_place = last_places(tally.grid.mesh, tally.grid.rung, batch.directions[first], hits.t_hit[first])
    for i, line in enumerate(expected):
        at = next((crossing.t for crossing in line if crossing.id == ids[i]), None)
        if ids[i] < 0 or at is None:
            continue
        error, exact[i] = abs(Fraction(hits.t_hit.item(i)) - at), at
        tally.ulps.append(float(error / Fraction(last_place.item(i))))
        if not tally.grid.rung.lossless:
            continue
        bound = hits.t_err.item(i)
        late[i] = not math.isfinite(bound) or error > Fraction(bound)
        tally.shares.append(_share(error, bound))
    tally.note("late", late, batch, _in_words(hits), lambda row: f"t {float(exact[row])!r} = {exact[row]}")


def last_places(mesh: Mesh, rung: Rung, directions: F64, t: F64) -> F64:
    """(N,) the last digit, in the rung's arithmetic, of t or of the way through the mesh, if longer."""
    size = float((mesh.bounds[1] - mesh.bounds[0]).max())
    with np.errstate(over="ignore"):
        way = np.maximum(np.abs(t), size / np.abs(directions).max(axis=1))
    last: F64 = np.spacing(np.where(np.isfinite(way), way, 1.0)) * (np.finfo(rung.real).eps / 2.0**-52)
    return last


def _share(error: Fraction, bound: float) -> float:
    """The error over its bound; inf where it exceeds a bound of 0."""
    if not error or math.isinf(bound):
        return 0.0
    return float(error / Fraction(bound)) if bound else math.inf
