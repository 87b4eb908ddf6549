"""The page of ``clgrid bench`` and of one picture."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median

from clgrid.record import BenchRecord, RenderRecord, Row
from clgrid.report.model import Axis, Cell, Column, Page, Ranges, Section, Table, Value
from clgrid.report.pages.shared import BANDS, facts, named, rate, repeated, time_range, timed
from clgrid.report.quantity import BYTES, BYTES_EACH, COUNT, MRAYS, NUMBER, SECONDS, Quantity, counted

_MTRI = Quantity(((1.0, "Mtri/s"),))


def page(record: BenchRecord) -> Page:
    """Return the page of scenes that were built and drawn."""
    rows = record.rows
    says = [_sentence(row) for row in rows]
    device = record.device.name
    title = f"Build and render: {counted(len(rows), 'scene')} on {device}"
    if len(rows) == 1:
        title = f"Build and render: {named(rows[0].scene)} on {device}"
    return Page(
        title=title,
        says=says[:4] + ([f"{counted(len(says) - 4, 'more scene')} below."] if len(says) > 4 else []),
        warnings=[failure.error for failure in record.failures]
        + [f"{named(row.scene)}: {warning}" for row in rows for warning in row.warnings],
        sections=_sections(rows),
        facts=facts(record),
        commands=repeated(record),
        compiled=record.compiled,
    )


def page_of_picture(record: RenderRecord) -> Page:
    """Return the page of one picture that was drawn."""
    return Page(
        title=f"A picture of {named(record.row.scene)} on {record.device.name}",
        says=[_sentence(record.row), *(f"Written: {name}." for name in record.outputs)],
        warnings=record.row.warnings,
        sections=_sections([record.row]),
        facts=facts(record),
        commands=repeated(record),
        compiled=record.compiled,
    )


def _sentence(row: Row) -> str:
    return (
        f"{named(row.scene)}, {row.triangles:,} triangles, {row.layout}, {row.accuracy}:"
        f" {SECONDS.text(median(row.time_to_image_s))} to an image of {row.width} x {row.height},"
        f" {SECONDS.text(median(row.build_s))} of them the build;"
        f" the grid takes {BYTES.text(row.grid_bytes)}, {row.bytes_per_triangle:.3g} bytes a triangle."
    )


def _sections(rows: Sequence[Row]) -> list[Section]:
    if not rows:
        return []
    several = len({(row.layout, row.accuracy) for row in rows}) > 1
    times = [
        time_range(
            _label(row, several), row.time_to_image_s, more=[("build", SECONDS.text(median(row.build_s)))]
        )
        for row in rows
    ]
    blocks = [Ranges("Time to image", Axis("build and render", SECONDS), times, note=BANDS)]
    return [
        Section("Time and bytes", [*blocks, _scenes(rows)] if len(rows) > 1 else [_scenes(rows)]),
        Section("The build, by stage", [_stages(rows)]),
    ]


def _label(row: Row, several: bool) -> str:
    return f"{named(row.scene)}, {row.layout}, {row.accuracy}" if several else named(row.scene)


def _scenes(rows: Sequence[Row]) -> Table:
    columns = (
        Column("scene"),
        Column("layout"),
        Column("rung"),
        Column("triangles", COUNT),
        Column("density", NUMBER, "cells per triangle"),
        Column("build", SECONDS),
        Column("built", _MTRI, "triangles", detail=True),
        Column("render", SECONDS),
        Column("cast", MRAYS, "rays", detail=True),
        Column("time to image", SECONDS, "build and render"),
        Column("grid", BYTES),
        Column("a triangle", BYTES_EACH, "bytes of the grid per triangle"),
        Column("peak", BYTES, "most device bytes that the build held at once", detail=True),
        Column("load", SECONDS, "of the file; depends on caches of the system", detail=True),
        Column("compile", SECONDS, "of the first kernels; depends on caches of the driver", detail=True),
    )
    cells = [
        (
            Cell(named(row.scene), note=row.scene),
            row.layout,
            row.accuracy,
            row.triangles,
            Cell(row.density, note="x".join(map(str, row.resolution))),
            timed(row.build_s),
            rate(row.triangles, row.build_s),
            timed(row.render_s),
            rate(row.rays, row.render_s),
            timed(row.time_to_image_s),
            row.grid_bytes,
            row.bytes_per_triangle,
            row.peak_bytes,
            timed(row.load_s),
            sum(row.first_compile_s) if row.first_compile_s else None,
        )
        for row in rows
    ]
    repetitions = counted(len(rows[0].build_s), "repetition")
    return Table("Scenes", columns, cells, note=f"Medians of {repetitions}.")


def _stages(rows: Sequence[Row]) -> Table:
    names = [*dict.fromkeys(name for row in rows for name in row.build_stages_s)]
    columns = [Column("scene"), Column("layout"), *(Column(name, SECONDS) for name in names)]
    cells: list[list[Cell | Value]] = [
        [named(row.scene), row.layout, *(timed(row.build_stages_s.get(name, [])) for name in names)]
        for row in rows
    ]
    return Table("Medians", columns, cells)
