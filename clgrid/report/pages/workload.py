"""The page of ``clgrid bench --workload``."""

from __future__ import annotations

from collections.abc import Sequence

from clgrid.record import WorkloadRecord, WorkloadRow
from clgrid.report.model import Axis, Cell, Column, Page, Ranges, Section, Table
from clgrid.report.pages.shared import BANDS, facts, faults, named, repeated, time_range, timed
from clgrid.report.quantity import BYTES, COUNT, MRAYS, NUMBER, SECONDS


def page(record: WorkloadRecord) -> Page:
    """Return the page of a renderer's rays."""
    rows = record.rows
    names = [*dict.fromkeys(row.workload for row in rows)]
    return Page(
        title=f"Rays of a renderer ({', '.join(names)}) on {record.device.name}",
        says=[_sentence(row) for row in rows],
        warnings=[failure.error for failure in record.failures]
        + [f"{named(row.scene)}: {warning}" for row in rows for warning in row.warnings],
        sections=[Section("Rays by kind", [_times(rows), _kinds(rows)])] if rows else [],
        facts=facts(record),
        commands=repeated(record),
        compiled=record.compiled,
    )


def _sentence(row: WorkloadRow) -> str:
    checked = f"{row.differing:,} of {row.checked:,} compared rays differ from brute force"
    return (
        f"{named(row.scene)}, {row.layout}, {row.accuracy}: {row.mrays_per_s:.3g} million rays a second,"
        f" {row.steps_per_ray:.3g} cells a ray; "
        + (checked if row.checked else "none was compared with brute force")
        + "."
    )


def _times(rows: Sequence[WorkloadRow]) -> Ranges:
    lines = [
        time_range(f"{named(row.scene)}, {kind.kind}", kind.cast_s, more=[("rays", f"{kind.rays:,}")])
        for row in rows
        for kind in row.kinds
    ]
    return Ranges("Casting", Axis("all rays of the kind", SECONDS), lines, note=BANDS)


def _kinds(rows: Sequence[WorkloadRow]) -> Table:
    columns = (
        Column("scene"),
        Column("rays of"),
        Column("rays", COUNT),
        Column("hits", COUNT),
        Column("cells", NUMBER, "looked at, a ray"),
        Column("cast", SECONDS),
        Column("rate", MRAYS),
        Column("grid", BYTES),
        Column("peak", BYTES, "most device bytes that the build held at once"),
        Column("differ", COUNT, "from brute force, in any bit"),
    )
    cells: list[list[Cell | str | int | float | None]] = []
    for row in rows:
        for kind in row.kinds:
            cells.append(
                [
                    named(row.scene),
                    kind.kind,
                    kind.rays,
                    kind.hits,
                    kind.steps_per_ray,
                    timed(kind.cast_s),
                    kind.mrays_per_s,
                    None,
                    None,
                    None,
                ]
            )
        differ = faults(row.differing, row.checked, row.accuracy != "fast")
        cells.append(
            [
                named(row.scene),
                "all",
                row.rays,
                row.hits,
                row.steps_per_ray,
                timed(row.cast_s),
                row.mrays_per_s,
                row.grid_bytes,
                row.peak_bytes,
                differ,
            ]
        )
    count = len(rows[0].cast_s) if rows else 0
    return Table("Kinds", columns, cells, note=f"Medians of {count} repetitions.")
