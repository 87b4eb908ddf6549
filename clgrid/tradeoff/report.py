"""From what was measured to rows, front and recommendation."""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence

import numpy as np

from clgrid.device import Device
from clgrid.mesh import Mesh
from clgrid.rungs import ACCURACIES
from clgrid.tradeoff import words
from clgrid.tradeoff.choose import Candidate, Choice
from clgrid.tradeoff.errors import EXACT_RUNG, RATIONAL
from clgrid.tradeoff.front import front
from clgrid.tradeoff.intervals import median_interval, rate_most
from clgrid.tradeoff.plan import SIMPLICITY, Plan, Wish
from clgrid.tradeoff.reference import aim_resolution
from clgrid.tradeoff.survey import Seen
from clgrid.tradeoff.turns import Turns
from clgrid.tradeoff_record import (
    Need,
    PictureErrors,
    RayErrors,
    Recommendation,
    ReferenceCheck,
    Spread,
    TradeoffRow,
)

Error = tuple[float, float | None]


def error_of(
    accuracy: str, picture: PictureErrors, errors: Sequence[RayErrors], measure: str, check: ReferenceCheck
) -> Error:
    """The error of a point by a measure, and its upper bound.

    The rung ``exact`` is the reference of pixels and rays: its bound is what rational arithmetic says of it.
    """
    if measure == "rms":
        return picture.rms, picture.rms
    if measure == "distance":
        found = [each.distance for each in errors if each.kind == "camera" and each.distance is not None]
        worst = max((each.worst for each in found), default=0.0)
        floor = max((each.floor for each in found), default=0.0)
        return max(worst, floor), worst + floor
    if accuracy == "exact":
        return 0.0, check.wrong_most if check.rays else None
    if measure == "pixels":
        return picture.other_share, picture.other_share_most
    seen = next(each for each in errors if (each.kind, each.reference) == ("structured", EXACT_RUNG))
    wrong = seen.missed + seen.false_hits + seen.wrong_triangles
    return wrong / seen.rays, rate_most(wrong, seen.rays)


class Report:
    """What was seen of the points, as the choice and the record need it.

    Attributes
    ----------
    check : ReferenceCheck
    aim : (int, int, int)
        Resolution of the grid at which structured rays were aimed.
    candidates : list of Candidate
    """

    def __init__(
        self, mesh: Mesh, seen: Sequence[Seen], plan: Plan, check: ReferenceCheck, auto: tuple[str, float]
    ) -> None:
        self.check = check
        self.aim = aim_resolution(mesh)
        self._seen, self._plan = seen, plan
        self._triangles = mesh.triangle_count
        wish = plan.wish
        self._errors: list[Error] = [
            error_of(each.point.accuracy, each.picture, each.errors, wish.measure, check) for each in seen
        ]
        self.candidates = [
            Candidate(
                strictness=ACCURACIES.index(each.point.accuracy),
                nbytes=each.grid_bytes,
                simplicity=SIMPLICITY.index(each.point.layout),
                off_auto=abs(math.log2(each.point.density / auto[1])),
                error=error,
                fits=wish.allowed_error is None or error <= wish.allowed_error,
                grid=each.point[1:],
            )
            for each, (error, _) in zip(seen, self._errors, strict=True)
        ]

    def rows(self, turns: Turns, source: str, device: Device) -> list[TradeoffRow]:
        """The record's rows, once the turns are over."""
        evened = turns.evened()
        spreads = [_spread(evened[np.isfinite(evened[:, k]), k].tolist()) for k in range(turns.points)]
        kept = front(
            [each.median for each in spreads],
            [error for error, _ in self._errors],
            [each.grid_bytes for each in self._seen],
        )
        return [self._row(k, spreads[k], k in kept, source, device) for k in range(turns.points)]

    def front(self, rows: Sequence[TradeoffRow]) -> list[int]:
        """Numbers of the rows on the front, by cost."""
        return sorted((k for k, row in enumerate(rows) if row.on_front), key=lambda k: rows[k].cost_s.median)

    def _row(self, number: int, cost_s: Spread, on_front: bool, source: str, device: Device) -> TradeoffRow:
        seen, wish, (error, most) = self._seen[number], self._plan.wish, self._errors[number]
        point = seen.point
        refused = [] if self.candidates[number].fits else ["error"]
        refused += ["time"] if wish.max_time_s is not None and cost_s.median > wish.max_time_s else []
        return TradeoffRow(
            **point._asdict(),
            resolution=seen.resolution,
            references=seen.references,
            grid_bytes=seen.grid_bytes,
            bytes_per_triangle=seen.grid_bytes / self._triangles,
            peak_bytes=seen.peak_bytes,
            turns=seen.turns,
            build_s=seen.build_s,
            render_s=seen.render_s,
            time_to_image_s=[b + r for b, r in zip(seen.build_s, seen.render_s, strict=True)],
            cost_s=cost_s,
            picture=seen.picture,
            errors=seen.errors,
            errors_of=seen.errors_of,
            error=error,
            error_most=most,
            refused=refused,
            on_front=on_front,
            verify=self._command(seen, source, device),
        )

    def _command(self, seen: Seen, source: str, device: Device) -> str:
        plan, point = self._plan, seen.point
        kind = "structured", RATIONAL
        given = {
            "accuracy": point.accuracy,
            "layout": point.layout,
            "density": f"{point.density:g}",
            "aim": "x".join(map(str, self.aim)),
            "rays": plan.rays,
            "check": 0,
            "exact": sum(each.rays for each in seen.errors if (each.kind, each.reference) == kind),
            "seed": plan.seed,
            "device": device.label,
        }
        options = " ".join(f"--{name} {value}" for name, value in given.items())
        return f"clgrid verify {shlex.quote(source)} {options}"


def _spread(seconds: Sequence[float]) -> Spread:
    median, low, high = median_interval(seconds)
    return Spread(median=median, low=low, high=high)


def need_of(wish: Wish) -> Need:
    """The record of a wish."""
    return Need(
        measure=wish.measure,
        max_error=wish.allowed_error,
        max_time_s=wish.max_time_s,
        max_memory=wish.max_memory,
        frames=wish.frames,
        rebuild=wish.rebuild,
        stated=wish != Wish(frames=wish.frames, rebuild=wish.rebuild),
    )


def recommendation_of(
    rows: Sequence[TradeoffRow], choice: Choice, wish: Wish, check: ReferenceCheck
) -> Recommendation | None:
    """The record of a choice; None where no point meets the need."""
    if choice.point is None:
        return None
    row = rows[choice.point]
    allowed, most = wish.allowed_error, row.error_most
    return Recommendation(
        row=choice.point,
        support=choice.support,
        rival=choice.rival,
        sentence=words.sentence(rows, choice.point, wish, check, choice.support, choice.rival),
        proven=most is not None and (allowed is None or most <= allowed),
    )


def broken_promises(scene: str, check: ReferenceCheck) -> list[str]:
    """What rational arithmetic finds wrong with the rung ``exact``, a line each."""
    lines = []
    if check.wrong:
        lines.append(f"{check.wrong:,} of {check.rays:,} rays hit another triangle on exact than exactly")
    if check.late:
        lines.append(f"t of {check.late:,} hits on exact is farther off than t_err")
    return [f"{scene}: {line}; please report the scene" for line in lines]
