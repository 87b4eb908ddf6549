"""Records as CSV: a line a row, the fields of the record as columns."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from statistics import median

from clgrid.report.difference_record import DifferenceRecord
from clgrid.report.entries import Entry, Scalar, entries
from clgrid.report.read import Run

ALL = "_all"
"""End of the columns that hold every repetition, separated by blanks; that of the field holds the median."""


def of_run(run: Run) -> str:
    """Return all rows of a record.

    Numbers have all their digits; what a row does not have is empty. Version and device are columns, so that
    files of several runs can be put together.
    """
    device = run.record.device
    about: dict[str, Scalar] = {
        "schema": run.record.schema,
        "clgrid": run.record.clgrid,
        "device_name": device.name,
        "driver": device.driver,
        "platform": device.platform,
    }
    return _written([{**about, **_line(entry)} for entry in entries(run.document)])


def of_difference(record: DifferenceRecord) -> str:
    """Return all findings of a comparison."""
    return _written(
        [
            {
                "row": each.row,
                "field": each.field,
                "verdict": each.verdict,
                **_timed_or_not("first", each.first, each.timed),
                **_timed_or_not("second", each.second, each.timed),
                "ratio": each.ratio,
                "ratio_low": each.low,
                "ratio_high": each.high,
                "noise_known": each.noise_known,
            }
            for each in record.findings
        ]
    )


def _line(entry: Entry) -> dict[str, Scalar]:
    line: dict[str, Scalar] = {**entry.names, **entry.marks, **entry.values}
    for name, times in entry.times.items():
        line |= _timed_or_not(name, times, True)
    return line


def _timed_or_not(name: str, values: Sequence[Scalar], timed: bool) -> dict[str, Scalar]:
    if not timed:
        return {name: values[0]}
    times = [float(value) for value in values if isinstance(value, (int, float))]
    return {name: median(times), f"{name}{ALL}": " ".join(map(repr, times))}


def _written(lines: Sequence[Mapping[str, Scalar]]) -> str:
    columns = [*dict.fromkeys(_interleaved(lines))]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([_cell(line.get(column)) for column in columns] for line in lines)
    return text.getvalue()


def _interleaved(lines: Sequence[Mapping[str, Scalar]]) -> Iterable[str]:
    for line in lines:
        yield from line


def _cell(value: Scalar) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    return repr(value) if isinstance(value, float) else str(value)
