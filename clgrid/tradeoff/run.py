"""Sweep a scene: reference, survey, contest, and the record of them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from clgrid import record
from clgrid.closed import open_edges
from clgrid.device import Device
from clgrid.errors import InputError
from clgrid.frame import LocalFrame
from clgrid.scene import Scene
from clgrid.tradeoff import choose, contest, front, intervals, turns, words
from clgrid.tradeoff.contest import Contest
from clgrid.tradeoff.plan import Plan, Point
from clgrid.tradeoff.prepare import compile_all
from clgrid.tradeoff.reference import Reference, rays_of
from clgrid.tradeoff.report import Report, broken_promises, need_of, recommendation_of
from clgrid.tradeoff.survey import Easel, Seen, Survey
from clgrid.tradeoff_record import TradeoffRecord

Progress = Callable[[str, float | None], None]

METHODS = {
    **intervals.METHODS,
    "seconds": turns.METHOD,
    "repetitions": contest.METHOD,
    "front": front.METHOD,
    "choice": choose.METHOD,
}
_CLOCKS: dict[str, Callable[[], float]] = {"wall": time.perf_counter, "cpu": time.process_time}
# Share of what is left of the budget after the survey that rational arithmetic may have.
_RATIONAL_SHARE = 0.25


class _Spent:
    """Seconds of the parts of a run."""

    def __init__(self) -> None:
        self.seconds: dict[str, list[float]] = {}

    @contextmanager
    def on(self, part: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.seconds.setdefault(part, []).append(time.perf_counter() - start)

    @property
    def total(self) -> float:
        return sum(map(sum, self.seconds.values()))


def _measure(easel: Easel, seen: Seen, turn: int) -> float:
    """Build a point's grid and draw its picture, note the seconds, and return the cost of a picture."""
    clock = _CLOCKS[easel.plan.clock]
    start = clock()
    grid = easel.build(seen.point)
    built = clock()
    with grid:
        easel.draw(grid, seen.point.samples)
        done = clock()
    seen.turns.append(turn)
    seen.build_s.append(built - start)
    seen.render_s.append(done - built)
    return easel.plan.wish.cost_s(built - start, done - built)


def tradeoff(
    scene: Scene,
    plan: Plan,
    device: Device,
    progress: Progress = lambda step, share: None,
    *,
    source: str = "",
    load_s: float = 0.0,
) -> TradeoffRecord:
    """Sweep rungs, layouts and densities on a scene, and recommend one.

    Parameters
    ----------
    scene : Scene
    plan : Plan
    device : Device
    progress : callable
        Called with what is being done, and the share of it that is done, None if not known.
    source : str
        The scene as it was named, for the commands that the record holds.
    load_s : float
        Seconds that loading took.

    Raises
    ------
    InputError
        If the mesh has no triangles, the scene has no such camera, or no point could be built.
    DeviceError
        If the device cannot be used, or fails the self-test of a rung.
    GridTooLargeError
        If no grid that the reference could be asked through fits.
    """
    mesh = scene.mesh
    if not mesh.triangle_count:
        raise InputError(f"{scene.name} has no triangles to draw; give another scene")
    view, spent = plan.camera(scene), _Spent()
    easel = Easel(scene, plan, view, device)
    progress("choose a grid", None)
    start = time.perf_counter()
    auto, recipe = easel.auto(for_view=True), easel.auto(for_view=False)
    compiled = [time.perf_counter() - start]
    compiled += compile_all(easel, auto[0], recipe[0], closed=not open_edges(mesh), progress=progress)
    with spent.on("rays"):
        progress("aim rays", None)
        reference = Reference(mesh, recipe, rays_of(mesh, plan, view, device))
    with spent.on("reference"):
        progress("ask the reference", None)
        with easel.build(Point("exact", *recipe, None)) as grid:
            reference.ask(grid)
        with easel.build(Point("exact", *auto, None)) as grid:
            ids, colours = easel.ids(grid), easel.draw(grid, max(plan.samples, default=None))
    with spent.on("rational"):
        progress("rational arithmetic", None)
        reference.ask_rationally(_RATIONAL_SHARE * (plan.budget_s - spent.total))
    survey = Survey(easel, reference, ids, colours)
    with spent.on("survey"):
        survey.run(plan.points(), progress)
    if not survey.seen:
        raise InputError(f"{scene.name}: no point could be measured; {survey.left_out[0].reason}")
    report = Report(mesh, survey.seen, plan, reference.check(), auto)
    with spent.on("turns"):
        match = Contest(
            report.candidates,
            lambda row: _measure(easel, survey.seen[row], len(match.turns.costs)),
            plan.wish.max_time_s,
            least_error=plan.wish.least_error,
            seed=plan.seed,
            progress=progress,
        )
        choice = match.run(plan.budget_s - spent.total)
    named = source or scene.name
    rows = report.rows(match.turns, named, device)
    return TradeoffRecord(
        schema=record.schema("tradeoff"),
        clgrid=record.version(),
        device=record.describe_device(device),
        compiled=record.describe_builds(device),
        seeds={"rays": plan.seed, "turns": plan.seed, "samples": plan.shading.seed},
        scene=scene.name,
        source=named,
        triangles=mesh.triangle_count,
        size=float((mesh.bounds[1] - mesh.bounds[0]).max()),
        max_rounding=LocalFrame.of_bounds(mesh.bounds).max_rounding(mesh),
        width=plan.width,
        height=plan.height,
        eye=tuple(view.eye.tolist()),
        clock=plan.clock,
        auto_layout=auto[0],
        auto_density=auto[1],
        aim=report.aim,
        rays=plan.rays,
        confidence=intervals.CONFIDENCE,
        margin=choose.MARGIN,
        fast_pays=choose.FAST_PAYS,
        methods=METHODS,
        budget_s=plan.budget_s,
        load_s=[load_s],
        first_compile_s=compiled,
        spent_s=spent.seconds,
        need=need_of(plan.wish),
        rows=rows,
        left_out=survey.left_out,
        reference=report.check,
        slowness=match.turns.slowness().tolist(),
        front=report.front(rows),
        recommendation=recommendation_of(rows, choice, plan.wish, report.check),
        nearest="" if choice.point is not None else words.nearest(rows, plan.wish, report.check),
        broken=survey.broken + broken_promises(scene.name, report.check),
        process_peak_bytes=record.process_peak_bytes(),
        warnings=mesh.warnings,
    )
