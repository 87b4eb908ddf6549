"""The page of two runs beside one another."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median

from clgrid.report.difference_record import BETTER, OTHER, SAME, UNJUDGED, WORSE, DifferenceRecord, Finding
from clgrid.report.model import (
    BAD,
    GOOD,
    QUIET,
    Axis,
    Cell,
    Column,
    Page,
    Range,
    Ranges,
    Section,
    Table,
)
from clgrid.report.pages.shared import joined
from clgrid.report.quantity import BYTES, NUMBER, RATIO, SECONDS, counted
from clgrid.report.rules import is_size

# Lines of a plot, and rows of a table that nobody reads to its end.
_LINES, _MOST = 40, 1000
_MARKS = {WORSE: BAD, BETTER: GOOD, SAME: QUIET, UNJUDGED: QUIET}


def page(record: DifferenceRecord) -> Page:
    """Return the page of two runs."""
    changed = [each for each in record.findings if each.verdict in (WORSE, BETTER, OTHER)]
    order = (WORSE, BETTER, OTHER)
    changed.sort(key=lambda each: (order.index(each.verdict), -abs((each.ratio or 1.0) - 1.0)))
    sections = []
    plot = _plot(record)
    if plot.rows:
        sections.append(Section("Times", [plot]))
    sections.append(
        Section("What changed", [_table("Changes", changed)] if changed else [], _changed_text(changed))
    )
    if record.only_first or record.only_second:
        sections.append(Section("In one run only", [_only(record)]))
    sections.append(Section("Everything compared", [_table("All fields", record.findings)]))
    return Page(
        title=f"{record.second.file} against {record.first.file}",
        says=_says(record),
        warnings=[f"Not the same {each.name}: {each.first} / {each.second}" for each in record.circumstances],
        sections=[*sections, Section("How it was judged", [], method(record))],
        facts=[("written by", f"clgrid {record.clgrid}"), *_runs(record)],
    )


def method(record: DifferenceRecord) -> str:
    """Return how noise is told from change."""
    return (
        f"Each run's median has a band between two of its repetitions, in which the median of all times"
        f" lies with {record.confidence:.0%} confidence whatever their distribution (order statistics; with"
        " fewer than six repetitions, all of them). A time is worse or better if the bands do not overlap"
        f" and the median changed by more than {record.threshold:.0%}. With fewer than {record.few}"
        f" repetitions noise is unknown, and {record.unknown:.0%} is taken for it. Stages count only for"
        " what they are of the whole build. Load and first compile depend on caches and are not judged."
        " Counts and bytes are compared exactly; bytes of grids of two resolutions, and answers of the rung"
        " fast, may differ. What slows a whole run, such as another process, no repetition shows: run twice"
        " before you believe."
    )


def _says(record: DifferenceRecord) -> list[str]:
    worse = [each for each in record.findings if each.verdict == WORSE]
    better = [each for each in record.findings if each.verdict == BETTER]
    times = [each for each in record.findings if each.timed and each.verdict != UNJUDGED and each.ratio]
    says = [_worse(worse) if worse else "No regression beyond noise."]
    if better:
        says.append(f"{counted(len(better), 'field')} better: {_listed(better)}.")
    if times:
        ratio = median(each.ratio for each in times if each.ratio)
        says.append(
            f"All times together: the second run takes {ratio:.3g}× the first, by the median of {len(times)}."
        )
    says.append(f"{counted(record.matched, 'row')} in both runs.")
    unknown = sum(not each.noise_known for each in times)
    if unknown:
        says.append(
            f"{counted(unknown, 'time')} of too few repetitions: their noise is unknown, and"
            f" {record.unknown:.0%} was taken for it."
        )
    return says


def _worse(worse: Sequence[Finding]) -> str:
    return f"{counted(len(worse), 'regression')} beyond noise: {_listed(worse)}."


def _listed(findings: Sequence[Finding]) -> str:
    first = [f"{each.row}: {words(each.field)} {said(each)}" for each in findings[:3]]
    more = [f"{len(findings) - 3} more"] if len(findings) > 3 else []
    return joined([*first, *more])


def words(field: str) -> str:
    """Return a field in words: ``time to image``; ``build, count`` of ``build_stages_s.count``."""
    whole, _, part = field.partition(".")
    name = {"build_stages_s": "build", "nbytes": "bytes"}.get(whole, whole.removesuffix("_s"))
    return ", ".join(filter(None, (name, part))).replace("_", " ")


def said(finding: Finding) -> str:
    """Return a change in words: ``1.31×``, ``0 to 3``."""
    if finding.timed and finding.ratio is not None:
        return RATIO.text(finding.ratio)
    one, two = (_text(finding.field, each[0]) for each in (finding.first, finding.second))
    return f"{one} to {two}"


def _text(field: str, value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return BYTES.text(value) if is_size(field) else f"{value:,}"
    if isinstance(value, float):
        return NUMBER.text(value)
    return "-" if value is None else str(value)[:60] or "none"


def _plot(record: DifferenceRecord) -> Ranges:
    times = [each for each in record.findings if each.timed and each.verdict != UNJUDGED and each.ratio]
    # Stages only where they changed.
    times = [each for each in times if "." not in each.field or each.verdict in (WORSE, BETTER)]
    times.sort(key=lambda each: -(each.ratio or 1.0))
    shown = times
    if len(times) > _LINES:
        shown = [*times[: _LINES // 2], *times[-_LINES // 2 :]]
    rows = [
        Range(
            f"{each.row}: {words(each.field)}",
            each.ratio or 1.0,
            each.low or 0.0,
            each.high or 0.0,
            {WORSE: "slower", BETTER: "faster"}.get(each.verdict, "within noise"),
            _MARKS.get(each.verdict, ""),
            (
                ("first", SECONDS.text(median(_numbers(each.first)))),
                ("second", SECONDS.text(median(_numbers(each.second)))),
                ("ratio", f"{each.ratio:.3f}, between {each.low:.3f} and {each.high:.3f}"),
            ),
        )
        for each in shown
    ]
    note = "Shaded: changes that do not count."
    if len(times) > _LINES:
        note = f"The {_LINES} that changed most of {len(times)}. {note}"
    band = (1 / (1 + record.threshold), 1 + record.threshold)
    return Ranges("Second run over first", Axis("ratio of medians", RATIO), rows, 1.0, band, note)


def _numbers(values: Sequence[object]) -> list[float]:
    return [float(value) for value in values if isinstance(value, (int, float))]


def _changed_text(changed: Sequence[Finding]) -> str:
    return "" if changed else "Nothing beyond noise, and every count is the same."


def _table(title: str, findings: Sequence[Finding]) -> Table:
    columns = (
        Column("row"),
        Column("field"),
        Column("verdict"),
        Column("first"),
        Column("second"),
        Column("ratio", RATIO, "of medians, second over first"),
        Column("at least", RATIO),
        Column("at most", RATIO),
    )
    cells = [
        (
            each.row,
            each.field,
            Cell(each.verdict, mark=_MARKS.get(each.verdict, "")),
            _side(each, each.first),
            _side(each, each.second),
            each.ratio if each.timed else _count_ratio(each),
            each.low,
            each.high,
        )
        for each in findings[:_MOST]
    ]
    left = len(findings) - _MOST
    return Table(title, columns, cells, note=f"{left:,} more rows: see --csv or --json." if left > 0 else "")


def _side(finding: Finding, values: Sequence[object]) -> Cell:
    if not finding.timed:
        value = values[0]
        return Cell(value if isinstance(value, (int, float, str)) else None, _text(finding.field, value))
    numbers = _numbers(values)
    middle = median(numbers)
    count = counted(len(numbers), "repetition")
    note = f"{SECONDS.text(min(numbers))} to {SECONDS.text(max(numbers))}, {count}"
    return Cell(middle, SECONDS.text(middle), note=note)


def _count_ratio(finding: Finding) -> float | None:
    one, two = finding.first[0], finding.second[0]
    if isinstance(one, (int, float)) and isinstance(two, (int, float)) and one and not isinstance(one, bool):
        return two / one
    return None


def _only(record: DifferenceRecord) -> Table:
    cells = [(label, record.first.file) for label in record.only_first]
    cells += [(label, record.second.file) for label in record.only_second]
    return Table("Rows", (Column("row"), Column("only in")), cells)


def _runs(record: DifferenceRecord) -> list[tuple[str, str]]:
    found = []
    for name, run in (("first run", record.first), ("second run", record.second)):
        devices = "; ".join(f"{each.name}, driver {each.driver}, {each.platform}" for each in run.devices)
        found.append((name, f"{run.file}: {run.schema}, clgrid {run.clgrid}; {devices}"))
    return found
