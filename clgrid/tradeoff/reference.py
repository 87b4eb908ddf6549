"""The exact reference: rays of two kinds, and what the rung ``exact`` and rational arithmetic say of them."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from clgrid.camera import Camera
from clgrid.closed import open_edges
from clgrid.device import Device
from clgrid.frame import LocalFrame
from clgrid.grid import Grid
from clgrid.mesh import Mesh
from clgrid.rational import Crossing, Triangles, crossings
from clgrid.resolution import DEFAULT_DENSITY, by_density
from clgrid.structured import Aim
from clgrid.tradeoff.errors import (
    F64,
    Answers,
    Rays,
    against_exact_rung,
    against_rational,
    crossing_of,
    nearest_ids,
)
from clgrid.tradeoff.intervals import rate_most
from clgrid.tradeoff.plan import Plan
from clgrid.tradeoff_record import RayErrors, ReferenceCheck
from clgrid.verify import batches, compared_fields, last_places, sample_of, well_inside

Clock = Callable[[], float]

# Rays that are cast first, to see what all would take, and by how much fewer are cast if that is too long.
_PILOT, _FEWER = 2048, 4
# The same for lines in rational arithmetic.
_FIRST_LINES = 16


@dataclass
class Reference:
    """The answers of the rung ``exact``, and for a sample those of rational arithmetic.

    Attributes
    ----------
    recipe : (str, float)
        Layout and density of the grids that are asked: those for rays from anywhere to anywhere.
    rays : tuple of Rays
        Of each kind.
    answers : list of Answers
        Of the rung ``exact``, to each kind.
    t_err : list of (N,) float64
        By how much their t may be off.
    lines : list of list of list of Crossing
        Of each kind, all crossings of the first rays of its sample.
    """

    mesh: Mesh
    recipe: tuple[str, float]
    rays: tuple[Rays, ...]
    answers: list[Answers] = field(default_factory=list)
    t_err: list[F64] = field(default_factory=list)
    lines: list[list[list[Crossing]]] = field(default_factory=list)
    asked: int = 0
    rational_s: list[float] = field(default_factory=list)

    def ask(self, grid: Grid) -> None:
        """Cast all rays through a grid of the rung ``exact``."""
        for rays in self.rays:
            hits = grid.cast(rays.origins, rays.directions, fields=compared_fields(grid.rung))
            self.answers.append(Answers.of_hits(hits))
            self.t_err.append(hits.t_err)

    def ask_rationally(self, seconds: float, clock: Clock = time.perf_counter) -> None:
        """Cross as many lines of each sample as so many seconds allow, judged by the first of them."""
        self.asked = sum(len(rays.sample) for rays in self.rays)
        self.lines = [[] for _ in self.rays]
        if not self.asked:
            return
        start = clock()
        triangles = Triangles.of_mesh(self.mesh)
        for number, rays in enumerate(self.rays):
            began, left = clock(), seconds - (clock() - start)
            self._cross(triangles, number, rays.sample[:_FIRST_LINES])
            taken = (clock() - began) / max(len(self.lines[number]), 1)
            share = left / (len(self.rays) - number)
            allowed = min(len(rays.sample), max(_FIRST_LINES, _two_digits(share / max(taken, 1e-9))))
            self._cross(triangles, number, rays.sample[_FIRST_LINES:allowed])
        self.rational_s.append(clock() - start)

    def _cross(self, triangles: Triangles, number: int, rows: npt.NDArray[np.int64]) -> None:
        rays = self.rays[number]
        self.lines[number] += [
            crossings(triangles, rays.origins[row], rays.directions[row]) for row in rows.tolist()
        ]

    def check(self) -> ReferenceCheck:
        """The rung ``exact`` itself, against rational arithmetic."""
        rays = wrong = late = 0
        for number, lines in enumerate(self.lines):
            rows = self.rays[number].sample[: len(lines)]
            found, t_err = self.answers[number].at(rows), self.t_err[number][rows]
            rays += len(lines)
            wrong += int(np.count_nonzero(found.ids != nearest_ids(lines)))
            for row, line in enumerate(lines):
                id_ = found.ids.item(row)
                if any(crossing.id == id_ for crossing in line):
                    late += abs(found.t.item(row) - crossing_of(line, id_)) > t_err.item(row)
        return ReferenceCheck(
            asked=self.asked,
            rays=rays,
            wrong=wrong,
            wrong_most=rate_most(wrong, rays),
            late=late,
            rational_s=self.rational_s,
        )

    def errors(self, grid: Grid, seconds: float, clock: Clock = time.perf_counter) -> list[RayErrors]:
        """What a grid says of the rays, against both references.

        Parameters
        ----------
        grid : Grid
        seconds : float
            If all rays of a kind would take longer, fewer of them are cast: the first, a quarter and so on.
        clock : callable
        """
        found: list[RayErrors] = []
        for number, rays in enumerate(self.rays):
            count = _affordable(grid, rays, seconds / len(self.rays), clock)
            cast, lines = slice(count), self.lines[number]
            # The kernels of ``clgrid verify``, so that its answers are these.
            fields = compared_fields(grid.rung)
            answers = Answers.of_hits(grid.cast(rays.origins[cast], rays.directions[cast], fields=fields))
            last = last_places(grid.mesh, grid.rung, rays.directions[cast], answers.t)
            lengths = np.linalg.norm(rays.directions[cast], axis=1)
            truth, t_err = self.answers[number].at(cast), self.t_err[number][cast]
            found.append(against_exact_rung(rays.kind, answers, truth, t_err, last, lengths))
            pairs = zip(rays.sample.tolist(), lines, strict=False)
            known = [(row, line) for row, line in pairs if row < count]
            if known:
                rows = np.array([row for row, _ in known])
                some = [line for _, line in known]
                found.append(against_rational(rays.kind, answers.at(rows), some, last[rows], lengths[rows]))
        return found


def _affordable(grid: Grid, rays: Rays, seconds: float, clock: Clock) -> int:
    """Rays whose cast takes no longer, judged by the first of them."""
    count = len(rays)
    if count <= _PILOT:
        return count
    start = clock()
    grid.cast(rays.origins[:_PILOT], rays.directions[:_PILOT], fields=compared_fields(grid.rung))
    each = (clock() - start) / _PILOT
    while count > _PILOT and count * each > seconds:
        count = max(count // _FEWER, _PILOT)
    return count


def _two_digits(number: float) -> int:
    """The number rounded down to one or two digits, so that it is the same in most runs."""
    whole = max(int(number), 1)
    step = int(10 ** max(len(str(whole)) - 2, 0))
    return whole // step * step


def aim_resolution(mesh: Mesh) -> tuple[int, int, int]:
    """Resolution of the grid at which structured rays are aimed: the paper's density, whatever is swept."""
    local = LocalFrame.of_bounds(mesh.bounds).to_local(mesh.bounds).astype(np.float64)
    return by_density(local[1] - local[0], mesh.triangle_count, DEFAULT_DENSITY)


def rays_of(mesh: Mesh, plan: Plan, view: Camera, device: Device) -> tuple[Rays, Rays]:
    """Rays of the picture, chosen at random, and those of ``clgrid verify`` with the same seed and aim."""
    return _camera_rays(plan, view), _structured_rays(mesh, plan, device)


def _camera_rays(plan: Plan, view: Camera) -> Rays:
    pixels = plan.width * plan.height
    chosen = np.random.default_rng([plan.seed, 2]).permutation(pixels)[: min(plan.rays, pixels)]
    origins, directions = (
        np.ascontiguousarray(array.reshape(-1, 3)[chosen]) for array in view.rays(plan.width, plan.height)
    )
    return Rays("camera", origins, directions, np.arange(min(plan.exact, len(chosen))))


def _structured_rays(mesh: Mesh, plan: Plan, device: Device) -> Rays:
    aim = Aim.at(mesh, aim_resolution(mesh))
    points = np.zeros((0, 3)) if open_edges(mesh) else well_inside(aim, device, plan.seed)
    origins, directions, sample, start = [], [], [], 0
    for batch in batches(aim, points, plan.rays, plan.seed):
        origins.append(batch.origins)
        directions.append(batch.directions)
        sample.append(np.arange(start, start + sample_of(batch, min(plan.exact, plan.rays), plan.rays)))
        start += len(batch)
    return Rays("structured", np.concatenate(origins), np.concatenate(directions), np.concatenate(sample))


__all__ = ["Reference", "aim_resolution", "rays_of"]
