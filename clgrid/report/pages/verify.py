"""The page of ``clgrid verify``."""

from __future__ import annotations

from collections.abc import Sequence

from clgrid.report.model import BAD, Cell, Column, Page, Section, Table
from clgrid.report.pages.shared import facts, faults, joined, named, repeated
from clgrid.report.quantity import COUNT, PERCENT, ULPS
from clgrid.verify_record import VerifyRecord, VerifyRow

# Each check, in words, with the number of rays that it is asked of.
_CHECKS = (
    ("escapes", "escapes", "inside", "from inside of a closed mesh, without a hit"),
    ("even from inside", "even_inside", "inside", "an even number of crossings, from inside"),
    ("odd lines", "odd_lines", "rays", "whole lines that cross a closed mesh an odd number of times"),
    ("other bits", "bits", "checked", "than brute force, of t, id, u, v or t_err"),
    ("other counts", "counts", "checked", "of hits, than brute force"),
    ("wrong hits", "wrong_hits", "exact_checked", "a hit where exact arithmetic misses, or the reverse"),
    ("wrong triangles", "wrong_ids", "exact_checked", "another nearest triangle than in exact arithmetic"),
    ("wrong counts", "wrong_counts", "exact_checked", "another number of hits than in exact arithmetic"),
    ("late", "late", "exact_hits", "t farther from the exact one than t_err"),
)


def page(record: VerifyRecord) -> Page:
    """Return the page of promises tried."""
    rows = record.rows
    kept = [row.accuracy for row in rows if not row.broken]
    says = (
        [f"{joined(kept)} {'keeps' if len(kept) == 1 else 'keep'} every promise on this scene."]
        if kept
        else []
    )
    says += [f"{rows[0].rays:,} rays that find faults, each rung by itself."] if rows else []
    if record.open_edges:
        says.append(
            f"{record.open_edges:,} edges have an odd number of triangles: the mesh is not closed, so that"
            " nothing is asked of escapes and parity."
        )
    broken = [f"{row.accuracy} breaks a promise: {joined(row.broken)}." for row in rows if row.broken]
    failed = [(row, ray) for row in rows for ray in row.first]
    sections = [Section("Promises", [_table(rows)], "Faults among the rays that each check is asked of.")]
    if failed:
        columns = [
            Column(name) for name in ("rung", "check", "kind", "origin", "direction", "found", "expected")
        ]
        cells = [
            (
                row.accuracy,
                Cell(ray.check, mark=BAD if ray.check in row.broken else ""),
                ray.kind,
                " ".join(map(repr, ray.origin)),
                " ".join(map(repr, ray.direction)),
                ray.found,
                ray.expected,
            )
            for row, ray in failed
        ]
        sections.append(Section("First rays that fail", [Table("Rays", columns, cells)]))
    return Page(
        title=f"Promises tried on {named(record.scene)}, {record.triangles:,} triangles",
        says=broken + says,
        warnings=record.warnings,
        sections=sections,
        facts=[*facts(record), ("grid", f"{record.layout}, density {record.density}")],
        commands=repeated(record),
        compiled=record.compiled,
    )


def _table(rows: Sequence[VerifyRow]) -> Table:
    columns = [
        Column("rung"),
        Column("promises"),
        *(Column(name, COUNT, note) for name, _, _, note in _CHECKS),
        Column("worst t", ULPS, "largest error of t, in last places"),
        Column("worst share", PERCENT, "largest error of t, of its t_err"),
        Column("median share", PERCENT, "median error of t, of its t_err"),
    ]
    cells = [
        [
            row.accuracy,
            Cell("broken", mark="bad") if row.broken else Cell("kept", mark="good"),
            *(
                faults(getattr(row, check), getattr(row, asked), check in row.broken)
                for _, check, asked, _ in _CHECKS
            ),
            row.worst_ulps,
            row.worst_share,
            row.median_share,
        ]
        for row in rows
    ]
    return Table("Rungs", columns, cells)
