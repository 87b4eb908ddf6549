"""Every point once, untimed: its bytes, its picture beside the reference, its answers to rays."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import Any

from clgrid.camera import Camera
from clgrid.device import Device
from clgrid.errors import GridTooLargeError
from clgrid.grid import Grid, build
from clgrid.look import Shading
from clgrid.renderer import render
from clgrid.rungs import RUNGS
from clgrid.scene import Scene
from clgrid.tradeoff.pictures import Colours, Ids, picture_errors, same_colours
from clgrid.tradeoff.plan import Plan, Point
from clgrid.tradeoff.reference import Reference
from clgrid.tradeoff_record import LeftOut, PictureErrors, RayErrors

Clock = Callable[[], float]
Progress = Callable[[str, float | None], None]

# Points that take so many times as long as the fastest may be left out where the budget is short.
_HOPELESS = 8.0
# Share of the budget that the pass over all points should take, and of it what casts of rays may.
_SHARE, _CAST_SHARE = 0.4, 0.15


@dataclass
class Seen:
    """What is known of a point; seconds are added turn by turn.

    Attributes
    ----------
    errors_of : int
        Number of the point on which ``errors`` were measured.
    pass_s : float
        Seconds of the one build and picture that were not timed for good.
    """

    point: Point
    resolution: tuple[int, int, int]
    references: int
    grid_bytes: int
    peak_bytes: int
    picture: PictureErrors
    errors: list[RayErrors]
    errors_of: int
    pass_s: float
    turns: list[int] = field(default_factory=list)
    build_s: list[float] = field(default_factory=list)
    render_s: list[float] = field(default_factory=list)


@dataclass(frozen=True)
class Easel:
    """Builds grids of a scene and draws its picture, as points ask."""

    scene: Scene
    plan: Plan
    view: Camera
    device: Device

    def build(self, point: Point) -> Grid:
        """The grid of a point."""
        return build(self.scene.mesh, point.layout, point.density, accuracy=point.accuracy, **self.options)

    def auto(self, *, for_view: bool) -> tuple[str, float]:
        """Layout and density that "auto" takes: for the picture, or for rays from all around."""
        options = {**self.options, **({} if for_view else {"view": None})}
        with build(self.scene.mesh, "auto", accuracy="robust", **options) as grid:
            return grid.layout, grid.recipe.density

    @property
    def options(self) -> dict[str, Any]:
        """Options of ``build`` that all points share."""
        plan = self.plan
        return {
            "device": self.device,
            "max_memory": plan.wish.max_memory,
            "rays": plan.width * plan.height,
            "view": self.view,
        }

    def shading(self, samples: int | None) -> Shading | None:
        """How pictures of so many samples are lit; None for plain ones."""
        return None if samples is None else replace(self.plan.shading, samples=samples)

    def draw(self, grid: Grid, samples: int | None) -> Colours:
        """The colours of the picture."""
        size = self.plan.width, self.plan.height
        return render(self.scene, self.view, *size, grid=grid, shading=self.shading(samples)).rgba

    def ids(self, grid: Grid) -> Ids:
        """The triangle that each pixel shows."""
        image = render(self.scene, self.view, self.plan.width, self.plan.height, ("id",), grid=grid)
        assert image.primitive_id is not None
        return image.primitive_id


class Survey:
    """Looks at points one after another.

    Parameters
    ----------
    easel : Easel
    reference : Reference
        That has been asked.
    ids, colours : arrays
        Of the reference's pictures.
    """

    def __init__(self, easel: Easel, reference: Reference, ids: Ids, colours: Colours) -> None:
        self.seen: list[Seen] = []
        self.left_out: list[LeftOut] = []
        self.broken: list[str] = []
        self._easel = easel
        self._reference = reference
        self._true_ids, self._true_colours = ids, colours
        self._ids: dict[Point, tuple[Ids, int]] = {}
        self._pictures: dict[Point, tuple[Colours, PictureErrors]] = {}
        self._slow: dict[tuple[str, float, int | None], str] = {}

    def run(self, points: Iterable[Point], progress: Progress, clock: Clock = time.perf_counter) -> None:
        """Look at all points, those of one rung after those of another.

        Raises
        ------
        DeviceError
            If the device cannot be used at all.
        """
        wanted = list(points)
        rungs = list(dict.fromkeys(point.accuracy for point in wanted))
        casts = sum(1 for point in wanted if not RUNGS[point.accuracy].lossless) + len(rungs)
        cast_s = _CAST_SHARE * self._easel.plan.budget_s / casts
        for number, rung in enumerate(rungs):
            of_rung = [point for point in wanted if point.accuracy == rung]
            for k, point in enumerate(of_rung):
                share = (number + k / len(of_rung)) / len(rungs)
                progress(f"look at {point.words()}", share)
                self._look(point, cast_s, clock)
            if number == 0 and self.seen:
                self._give_up(len(rungs))

    def _give_up(self, rungs: int) -> None:
        """Leave out the slowest points on the other rungs, if the pass would take too much of the budget."""
        ranked = sorted(self.seen, key=lambda seen: -seen.pass_s)
        allowed = _SHARE * self._easel.plan.budget_s
        total, fastest = rungs * sum(seen.pass_s for seen in ranked), min(seen.pass_s for seen in ranked)
        for seen in ranked:
            if total <= allowed or seen.pass_s < _HOPELESS * fastest:
                return
            total -= (rungs - 1) * seen.pass_s
            self._slow[seen.point[1:]] = (
                f"takes {seen.pass_s:.2g} s a picture on the rung {seen.point.accuracy},"
                f" {seen.pass_s / fastest:.0f} times the fastest; a longer --budget measures it"
            )

    def _look(self, point: Point, cast_s: float, clock: Clock) -> None:
        if point[1:] in self._slow:
            self.left_out.append(_left_out(point, self._slow[point[1:]]))
            return
        start = clock()
        try:
            grid = self._easel.build(point)
        except GridTooLargeError as error:
            self.left_out.append(_left_out(point, str(error)))
            return
        with grid:
            colours = self._easel.draw(grid, point.samples)
            pass_s = clock() - start
            self._note(point, grid, colours, pass_s, cast_s)

    def _note(self, point: Point, grid: Grid, colours: Colours, pass_s: float, cast_s: float) -> None:
        kind = point._replace(samples=None)
        if RUNGS[point.accuracy].lossless:
            # No grid changes what these rungs answer: one speaks for all, and pictures show that it does.
            kind = kind._replace(layout="", density=0.0)
        number = len(self.seen)
        if kind not in self._ids:
            self._ids[kind] = self._easel.ids(grid), number
            errors = self._answers(point, grid, cast_s)
        else:
            errors = self.seen[self._ids[kind][1]].errors
        ids, errors_of = self._ids[kind]
        stats = grid.stats
        self.seen.append(
            Seen(
                point,
                resolution=stats.resolution,
                references=stats.references,
                grid_bytes=grid.nbytes,
                peak_bytes=grid.peak_nbytes,
                picture=self._picture(point, kind._replace(samples=point.samples), ids, grid, colours),
                errors=errors,
                errors_of=errors_of,
                pass_s=pass_s,
            )
        )

    def _answers(self, point: Point, grid: Grid, cast_s: float) -> list[RayErrors]:
        if not RUNGS[point.accuracy].lossless:
            return self._reference.errors(grid, cast_s)
        with self._easel.build(Point(point.accuracy, *self._reference.recipe, None)) as suited:
            return self._reference.errors(suited, cast_s)

    def _picture(self, point: Point, kind: Point, ids: Ids, grid: Grid, colours: Colours) -> PictureErrors:
        """Compare the picture with the reference, unless it is one that has been compared."""
        known = self._pictures.get(kind)
        if known is not None and same_colours(colours, known[0]):
            return known[1]
        if known is not None:
            self.broken.append(
                f"{self._easel.scene.name}: {point.words()} shows another picture than other grids of the"
                f" rung, which {point.accuracy!r} rules out; please report the scene"
            )
            ids = self._easel.ids(grid)
        found = picture_errors(ids, self._true_ids, colours, self._true_colours)
        if known is None and RUNGS[point.accuracy].lossless:
            self._pictures[kind] = colours, found
        return found


def _left_out(point: Point, reason: str) -> LeftOut:
    return LeftOut(**point._asdict(), reason=reason)
