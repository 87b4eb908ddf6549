"""The tables on the page of ``clgrid tradeoff``."""

from __future__ import annotations

from collections.abc import Sequence

from clgrid.report.model import CHOSEN, GOOD, Block, Cell, Column, Table
from clgrid.report.pages.shared import of, timed
from clgrid.report.quantity import (
    BYTES,
    BYTES_EACH,
    COUNT,
    DECIBELS,
    NUMBER,
    PERCENT,
    SECONDS,
    ULPS,
    Quantity,
    counted,
)
from clgrid.tradeoff_record import RayErrors, TradeoffRecord, TradeoffRow


def points(record: TradeoffRecord) -> Table:
    """Return all points by cost, with the one recommended and those on the front marked."""
    order = sorted(range(len(record.rows)), key=lambda number: record.rows[number].cost_s.median)
    sampled = any(row.samples is not None for row in record.rows)
    columns = [
        Column("rung"),
        Column("layout"),
        Column("density", NUMBER, "cells per triangle, as asked for"),
        *([Column("samples", COUNT, "rays a pixel")] if sampled else []),
        Column("time", SECONDS, "of a picture, its share of the build included"),
        Column("build", SECONDS),
        Column("render", SECONDS),
        Column("grid", BYTES),
        Column("a triangle", BYTES_EACH, "bytes of the grid per triangle"),
        Column("other pixels", COUNT, "that show another triangle than the reference"),
        Column("at most", PERCENT, "upper bound of their share in pictures like this one"),
        Column("beyond the need", None, "what the point does not keep to"),
    ]
    cells, marks = [], {}
    for place, number in enumerate(order):
        row = record.rows[number]
        cost = row.cost_s
        time = Cell(cost.median, note=f"{SECONDS.text(cost.low)} to {SECONDS.text(cost.high)}")
        cells.append(
            [
                row.accuracy,
                row.layout,
                Cell(row.density, note=" x ".join(map(str, row.resolution))),
                *([row.samples] if sampled else []),
                time,
                timed(evened(record, row, row.build_s)),
                timed(evened(record, row, row.render_s)),
                row.grid_bytes,
                row.bytes_per_triangle,
                row.picture.other_triangles,
                row.picture.other_share_most,
                Cell(", ".join(row.refused), mark="quiet"),
            ]
        )
        if record.recommendation is not None and record.recommendation.row == number:
            marks[place] = CHOSEN
        elif row.on_front:
            marks[place] = GOOD
    note = (
        f"★ recommended. ● on the front: no other point is as good in time, error and bytes and better in"
        f" one. Times are medians of {_repetitions(record.rows)}, once slow turns are taken out."
    )
    return Table("Points", columns, cells, marks, note)


def evened(record: TradeoffRecord, row: TradeoffRow, times: Sequence[float]) -> list[float]:
    """Return times as if all turns of the run had been alike."""
    return [second / record.slowness[turn] for second, turn in zip(times, row.turns, strict=True)]


def _repetitions(rows: Sequence[TradeoffRow]) -> str:
    counts = sorted({len(row.time_to_image_s) for row in rows})
    if not counts:
        return "no repetitions"
    return (
        counted(counts[0], "repetition") if len(counts) == 1 else f"{counts[0]} to {counts[-1]} repetitions"
    )


def errors(record: TradeoffRecord) -> list[Block]:
    """Return what rays and pictures get wrong, each measurement once."""
    own = [(row, each) for k, row in enumerate(record.rows) if row.errors_of == k for each in row.errors]
    units = f"{record.size:.3g} scene units is the scene's longest side"
    rays = Table(
        "Rays: hits and triangles",
        (
            *_POINT,
            Column("missed", PERCENT, "hits of the reference that are misses here"),
            Column("at most", PERCENT),
            Column("false hits", PERCENT, "hits where the reference misses"),
            Column("at most", PERCENT),
            Column("wrong triangles", PERCENT, "another nearest triangle"),
            Column("at most", PERCENT),
        ),
        [[*_point(row, each), *_rates(each)] for row, each in own],
        note="Numbers in brackets are rays.",
    )
    distances = Table(
        "Rays: errors of t, where the triangle is right",
        (
            *_POINT[:-1],
            Column("hits", COUNT),
            Column("median", ULPS),
            Column("99.9 %", ULPS),
            Column("worst", ULPS),
            Column("median", _UNITS),
            Column("99.9 %", _UNITS),
            Column("worst", _UNITS),
            Column("floor", _UNITS, "what the reference may itself be off"),
        ),
        [[*_point(row, each)[:-1], *_distances(each)] for row, each in own if each.distance is not None],
        note=f"Units in the last place of float32 on fast and robust, else of float64. {units}.",
    )
    sampled = any(row.samples is not None for row in record.rows)
    pictures = Table(
        "Pictures",
        (
            Column("rung"),
            Column("layout"),
            Column("density", NUMBER),
            *([Column("samples", COUNT, "rays a pixel; - for a plain picture")] if sampled else []),
            Column("other pixels", COUNT, "that show another triangle"),
            Column("share", PERCENT),
            Column("at most", PERCENT),
            Column("largest", NUMBER, "difference of a linear colour channel"),
            Column("rms", NUMBER, "root mean square difference"),
            Column("PSNR", DECIBELS),
        ),
        [
            [
                row.accuracy,
                row.layout,
                row.density,
                *([row.samples] if sampled else []),
                Cell(row.picture.other_triangles, of(row.picture.other_triangles, row.picture.pixels)),
                row.picture.other_share,
                row.picture.other_share_most,
                row.picture.largest,
                row.picture.rms,
                Cell(row.picture.psnr, "" if row.picture.psnr is not None else "equal"),
            ]
            for row in record.rows
        ],
    )
    return [rays, *([distances] if distances.rows else []), pictures]


_UNITS = Quantity(((1.0, "scene units"),))
_POINT = (
    Column("rung"),
    Column("layout"),
    Column("density", NUMBER),
    Column("rays of"),
    Column("reference"),
    Column("rays", COUNT),
)


def _point(row: TradeoffRow, each: RayErrors) -> list[str | int | float]:
    return [row.accuracy, row.layout, row.density, each.kind, each.reference, each.rays]


def _rates(each: RayErrors) -> list[Cell | float]:
    found: list[Cell | float] = []
    for wrong, most in (
        (each.missed, each.missed_most),
        (each.false_hits, each.false_hits_most),
        (each.wrong_triangles, each.wrong_triangles_most),
    ):
        share = wrong / each.rays if each.rays else 0.0
        text = f"{PERCENT.text(share).rstrip('%')} ({wrong:,})" if wrong else "0"
        found += [Cell(share, text), most]
    return found


def _distances(each: RayErrors) -> list[int | float | None]:
    found = each.distance
    if found is None:
        return [None] * 8
    return [
        found.hits,
        found.median_ulps,
        found.p999_ulps,
        found.worst_ulps,
        found.median,
        found.p999,
        found.worst,
        found.floor,
    ]


def left_out(record: TradeoffRecord) -> Table:
    """Return the points that could not be measured."""
    columns = (
        Column("rung"),
        Column("layout"),
        Column("density", NUMBER),
        Column("samples", COUNT),
        Column("why"),
    )
    cells = [
        (each.accuracy, each.layout, each.density, each.samples, each.reason) for each in record.left_out
    ]
    return Table("Points", columns, cells)


def methods(record: TradeoffRecord) -> Table:
    """Return how intervals, bounds, front and choice are made."""
    return Table("Methods", (Column("what"), Column("how")), [*record.methods.items()])


def spent(record: TradeoffRecord) -> Table:
    """Return where the time of the run went."""
    rows = [*record.spent_s.items(), ("load", record.load_s), ("first compile", record.first_compile_s)]
    cells = [(name, sum(times)) for name, times in rows]
    note = f"Of a budget of {SECONDS.text(record.budget_s)} beside loading and compiling."
    return Table("Time of the run", (Column("part"), Column("time", SECONDS)), cells, note=note)
