"""The page of ``clgrid tradeoff``."""

from __future__ import annotations

from statistics import median

from clgrid.report.model import (
    CHOSEN,
    GOOD,
    Axis,
    Block,
    Page,
    Point,
    Scatter,
    Section,
)
from clgrid.report.pages import tradeoff_tables as tables
from clgrid.report.pages.shared import facts, named, repeated
from clgrid.report.quantity import BYTES, NUMBER, PERCENT, SECONDS, Quantity, counted
from clgrid.tradeoff_record import TradeoffRecord, TradeoffRow

# What the error of a point is, by the need's measure.
MEASURES = {
    "pixels": ("pixels that show another triangle", PERCENT),
    "rays": ("structured rays with a wrong answer", PERCENT),
    "distance": ("worst error of t, scene units", NUMBER),
    "rms": ("error of colours, root mean square", NUMBER),
}


def page(record: TradeoffRecord) -> Page:
    """Return the page of speed against accuracy on a scene."""
    sections = [
        Section("What accuracy costs", _plots(record)),
        Section("All points", [tables.points(record)], _need(record)),
        Section("How wrong the answers are", tables.errors(record), _errors_text(record)),
    ]
    if record.left_out:
        sections.append(Section("Left out", [tables.left_out(record)]))
    sections.append(Section("How it was measured", [tables.methods(record), tables.spent(record)]))
    return Page(
        title=f"Speed against accuracy: {named(record.scene)}",
        says=_says(record),
        warnings=[*record.broken, *record.warnings],
        sections=sections,
        facts=[
            ("scene", f"{record.source or record.scene}, {record.triangles:,} triangles"),
            (
                "picture",
                f"{record.width} x {record.height}, from {' '.join(f'{at:.6g}' for at in record.eye)}",
            ),
            *facts(record),
            ("clock", "wall" if record.clock == "wall" else "processor time of all threads"),
        ],
        commands=repeated(record),
        compiled=record.compiled,
    )


def label(row: TradeoffRow) -> str:
    """Name a point in a few words."""
    samples = "" if row.samples is None else f", {counted(row.samples, 'sample')}"
    return f"{row.accuracy}, {row.layout}, density {row.density:g}{samples}"


def _says(record: TradeoffRecord) -> list[str]:
    says = []
    chosen = record.recommendation
    if chosen is None:
        says.append(record.nearest or "No point was measured.")
    else:
        says.append(chosen.sentence)
        support = f"The same point follows from {PERCENT.text(chosen.support)} of the resampled measurements"
        if chosen.rival is not None:
            support += f", {label(record.rows[chosen.rival])} from most of the others"
        says.append(f"{support}.")
    says += _price(record)
    check = record.reference
    if check.rays:
        wrong = f"disagree on {check.wrong:,}" if check.wrong else "agree on all"
        says.append(
            f"The reference was itself compared with rational arithmetic: they {wrong} of {check.rays:,}"
            f" rays, so that at most {PERCENT.text(check.wrong_most)} of such rays are wrong"
            f" ({record.confidence:.0%} sure)."
        )
    return says


def _price(record: TradeoffRecord) -> list[str]:
    """What the quickest point of each rung costs beside the quickest of all, and what it gets wrong."""
    plain = [row for row in record.rows if row.samples is None] or record.rows
    rungs = dict.fromkeys(row.accuracy for row in plain)
    if not plain or len(rungs) < 2:
        return []
    best = {
        rung: min((row for row in plain if row.accuracy == rung), key=lambda row: row.cost_s.median)
        for rung in rungs
    }
    first = min(best.values(), key=lambda row: row.cost_s.median)
    parts = []
    for rung, row in sorted(best.items(), key=lambda each: each[1].cost_s.median):
        wrong = row.picture.other_triangles
        faults = f"{counted(wrong, 'wrong pixel')} of {row.picture.pixels:,}" if wrong else "no wrong pixel"
        ratio = row.cost_s.median / first.cost_s.median
        beside = f", {ratio:.2f}× the quickest" if row is not first else ""
        parts.append(f"{rung} {SECONDS.text(row.cost_s.median)}{beside} ({faults})")
    return [f"The quickest of each rung: {'; '.join(parts)}."]


def _need(record: TradeoffRecord) -> str:
    need = record.need
    name, quantity = measure(record)
    parts = []
    if need.max_error is not None:
        most = f"at most {quantity.text(need.max_error)}" if need.max_error else "no"
        parts.append(f"{most} {name}")
    if need.max_time_s is not None:
        parts.append(f"at most {SECONDS.text(need.max_time_s)} a picture")
    if need.max_memory is not None:
        parts.append(f"at most {BYTES.text(need.max_memory)} for the grid")
    every = "its grid rebuilt for each" if need.rebuild else "the grid built once"
    frames = "one picture" if need.frames == 1 else f"{need.frames:,} pictures, {every}"
    asked = "The need, as stated" if need.stated else "No need was stated; assumed"
    limits = f": {', '.join(parts)}" if parts else ""
    return (
        f"{asked}: {frames}{limits}. Time is that of a picture, its share of the build included; times that"
        f" differ by no more than {record.margin:.0%} count as equal."
    )


def _errors_text(record: TradeoffRecord) -> str:
    return (
        "A rate of zero comes with its upper bound: so many such rays could be wrong and"
        f" {counted(record.rays, 'ray')} still show none ({record.confidence:.0%} sure)."
    )


def measure(record: TradeoffRecord) -> tuple[str, Quantity]:
    """Return what the need's error means, and in what unit."""
    return MEASURES.get(record.need.measure, (record.need.measure, NUMBER))


def _plots(record: TradeoffRecord) -> list[Block]:
    name, quantity = measure(record)
    error = Axis(name, quantity)
    time = Axis("time of a picture", SECONDS)
    note = (
        "What is on the front of time, error and bytes is opaque, with whiskers: the band of the median time,"
        " and upwards to the upper bound of the error."
    )
    rows = [(k, row) for k, row in enumerate(record.rows) if row.error is not None]
    return [
        Scatter("Time against error", time, error, [_point(record, k, row, True) for k, row in rows], note),
        Scatter(
            "Time against memory",
            time,
            Axis("bytes of the grid", BYTES),
            [_point(record, k, row, False) for k, row in enumerate(record.rows)],
        ),
    ]


def _point(record: TradeoffRecord, number: int, row: TradeoffRow, error: bool) -> Point:
    chosen = record.recommendation is not None and record.recommendation.row == number
    cost = row.cost_s
    _, quantity = measure(record)
    reach = None
    if error and row.error is not None and row.error_most is not None and row.error_most > row.error > 0:
        reach = (row.error, row.error_most)
    most = "" if row.error_most is None else f" (at most {quantity.text(row.error_most)})"
    wrong = f"{quantity.text(row.error)}{most}"
    return Point(
        label=label(row),
        x=cost.median,
        y=(row.error or 0.0) if error else row.grid_bytes,
        series=row.accuracy,
        kind=row.layout if row.samples is None else f"{row.layout}, {counted(row.samples, 'sample')}",
        x_range=(cost.low, cost.high),
        y_range=reach,
        mark=CHOSEN if chosen else GOOD if row.on_front else "",
        facts=(
            ("time", f"{SECONDS.text(cost.median)} ({SECONDS.text(cost.low)} to {SECONDS.text(cost.high)})"),
            ("build", SECONDS.text(median(tables.evened(record, row, row.build_s)))),
            ("render", SECONDS.text(median(tables.evened(record, row, row.render_s)))),
            ("error", wrong),
            ("grid", BYTES.text(row.grid_bytes)),
            ("resolution", " x ".join(map(str, row.resolution))),
        ),
    )
