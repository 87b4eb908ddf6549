"""The page of ``clgrid bench --frames``."""

from __future__ import annotations

from statistics import median

from clgrid.record import FramesRecord
from clgrid.report.model import Axis, Column, Page, Point, Scatter, Section, Table
from clgrid.report.noise import band
from clgrid.report.pages.shared import facts, named, repeated, timed
from clgrid.report.quantity import BYTES, COUNT, SECONDS, counted


def page(record: FramesRecord) -> Page:
    """Return the page of a mesh that moves."""
    seen = record.medians
    return Page(
        title=f"A moving mesh: {named(record.scene)} on {record.device.name}",
        says=[
            f"{counted(len(record.rows), 'frame')} of {record.triangles:,} triangles, {record.layout},"
            f" {record.accuracy}: {SECONDS.text(seen.time_to_image_s)} a frame by the median,"
            f" {SECONDS.text(seen.build_s)} of them to rebuild the grid."
        ],
        warnings=record.warnings,
        sections=[Section("Frames", [_plot(record), _table(record)])],
        facts=[*facts(record), ("vertices from", named(record.frames))],
        commands=repeated(record),
        compiled=record.compiled,
    )


def _plot(record: FramesRecord) -> Scatter:
    points = []
    for row in record.rows:
        for name, times in (("time to image", row.time_to_image_s), ("build", row.build_s)):
            found = band(times)
            said = (
                ("median", SECONDS.text(found.median)),
                ("band", f"{SECONDS.text(found.low)} to {SECONDS.text(found.high)}"),
            )
            points.append(
                Point(
                    f"frame {row.frame}, {name}",
                    row.frame,
                    found.median,
                    name,
                    y_range=(found.low, found.high),
                    facts=said,
                )
            )
    axes = Axis("frame", COUNT, log=False), Axis("time", SECONDS, log=False)
    return Scatter(
        "Time by frame", *axes, points, "Whiskers: the 95% band of the median, or all repetitions."
    )


def _table(record: FramesRecord) -> Table:
    columns = (
        Column("frame", COUNT),
        Column("build", SECONDS),
        Column("render", SECONDS),
        Column("time to image", SECONDS),
        Column("references", COUNT),
        Column("grid", BYTES),
        Column("peak", BYTES, "most device bytes held at once so far"),
        Column("hits", COUNT),
    )
    cells = [
        (
            row.frame,
            timed(row.build_s),
            timed(row.render_s),
            timed(row.time_to_image_s),
            row.references,
            row.grid_bytes,
            row.peak_bytes,
            row.hits,
        )
        for row in record.rows
    ]
    count = int(median(len(row.build_s) for row in record.rows)) if record.rows else 0
    return Table("Frames", columns, cells, note=f"Medians of {counted(count, 'repetition')}.")
