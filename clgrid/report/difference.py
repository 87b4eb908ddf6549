"""Two runs beside one another: what is worse, what is better, and what they do not have in common."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from clgrid import record
from clgrid.compare_record import CompareRecord
from clgrid.errors import InputError
from clgrid.record import DeviceRecord
from clgrid.report.difference_record import (
    BETTER,
    OTHER,
    SAME,
    UNJUDGED,
    WORSE,
    Circumstance,
    DifferenceRecord,
    Finding,
    RunRecord,
)
from clgrid.report.entries import Entry, Scalar, entries
from clgrid.report.match import match
from clgrid.report.noise import FASTER, FEW, SLOWER, change
from clgrid.report.read import Run
from clgrid.report.rules import BITS, EQUAL, LESS, MORE, SAID, is_judged, is_size, rule, whole
from clgrid.tradeoff.intervals import CONFIDENCE

THRESHOLD = 0.10
UNKNOWN = 0.25


def compare(
    first: Run, second: Run, threshold: float = THRESHOLD, unknown: float = UNKNOWN
) -> DifferenceRecord:
    """Compare two records of one kind.

    Parameters
    ----------
    threshold : float
        Share that the median of a time must have changed by, beyond its noise.
    unknown : float
        Share taken for noise where a run has fewer than ``noise.FEW`` repetitions.

    Raises
    ------
    InputError
        If they are of two kinds, or have no row in common.
    """
    kinds = [run.record.schema for run in (first, second)]
    if kinds[0] != kinds[1]:
        raise InputError(
            f"{first.name} is a record of {kinds[0]}, {second.name} one of {kinds[1]}; give two of one kind"
        )
    matches = match(entries(first.document), entries(second.document))
    if not matches.pairs:
        raise InputError(
            f"{first.name} and {second.name} have no row in common: {_some(matches.only_first)} in one,"
            f" {_some(matches.only_second)} in the other; measure the same scenes with the same options"
        )
    alike = first.record.clgrid == second.record.clgrid
    findings = [
        finding
        for row, one, two in matches.pairs
        for finding in (*_times(row, one, two, threshold, unknown), *_values(row, one, two, alike))
    ]
    return DifferenceRecord(
        schema=record.schema("report"),
        clgrid=record.version(),
        first=_described(first),
        second=_described(second),
        threshold=threshold,
        unknown=unknown,
        few=FEW,
        confidence=CONFIDENCE,
        circumstances=_circumstances(first, second),
        matched=len(matches.pairs),
        only_first=matches.only_first,
        only_second=matches.only_second,
        findings=findings,
    )


def regressions(result: DifferenceRecord) -> list[Finding]:
    """Return what is worse in the second run."""
    return [finding for finding in result.findings if finding.verdict == WORSE]


def _times(row: str, one: Entry, two: Entry, threshold: float, unknown: float) -> Iterator[Finding]:
    for name, first in one.times.items():
        if name not in two.times:
            continue
        second = two.times[name]
        found = change(first, second, threshold, unknown)
        verdict = {SLOWER: WORSE, FASTER: BETTER}.get(found.verdict, SAME)
        if not is_judged(name):
            verdict = UNJUDGED
        elif verdict != SAME and not _matters(name, one, two, threshold):
            verdict = SAME
        yield Finding(
            row=row,
            field=name,
            verdict=verdict,
            timed=True,
            first=[*first],
            second=[*second],
            ratio=found.ratio,
            low=found.low,
            high=found.high,
            noise_known=found.known,
        )


def _matters(name: str, one: Entry, two: Entry, threshold: float) -> bool:
    """Whether a part of a time changed by more than the threshold of the whole."""
    of = whole(name)
    if of not in one.times or of not in two.times:
        return True
    middles = [
        sorted(entry.times[each])[len(entry.times[each]) // 2] for each in (name, of) for entry in (one, two)
    ]
    return abs(middles[1] - middles[0]) > threshold * middles[2]


def _values(row: str, one: Entry, two: Entry, alike: bool) -> Iterator[Finding]:
    # The rung fast promises no answers; bytes of grids of two resolutions are of two grids.
    strict = one.names.get("accuracy") != "fast"
    one_grid = all(
        one.values.get(name, one.marks.get(name)) == two.values.get(name, two.marks.get(name))
        for name in ("resolution", "skipping", "parts")
    )
    # Of other numbers of rays, other numbers hit.
    asked = all(one.values.get(name) == two.values.get(name) for name in ("rays", "checked", "exact_checked"))
    for name, first in one.values.items():
        how = rule(name)
        if how == SAID or name not in two.values:
            continue
        second = two.values[name]
        verdict = _verdict(how, first, second, strict, alike)
        judged = one_grid if is_size(name) else strict and asked
        if verdict in (WORSE, BETTER) and not judged:
            verdict = OTHER
        yield Finding(row=row, field=name, verdict=verdict, timed=False, first=[first], second=[second])


def _verdict(how: str, first: Scalar, second: Scalar, strict: bool, alike: bool) -> str:
    if first == second:
        return SAME
    if how == EQUAL:
        return WORSE if strict else OTHER
    if how == BITS:
        return WORSE if strict and alike else OTHER
    if how in (LESS, MORE):
        if isinstance(first, str) or isinstance(second, str):
            # Names of broken promises: none is best.
            return WORSE if second and not first else BETTER if first and not second else OTHER
        if first is not None and second is not None:
            return WORSE if (second > first) == (how == LESS) else BETTER
        # A signal without noise is None, the best.
        if how == MORE:
            return WORSE if first is None else BETTER
    return OTHER


def _some(labels: list[str]) -> str:
    return (
        f"{labels[0]!r}" + (f" and {len(labels) - 1} more" if len(labels) > 1 else "") if labels else "none"
    )


def _described(run: Run) -> RunRecord:
    return RunRecord(
        file=run.name,
        schema=run.record.schema,
        clgrid=run.record.clgrid,
        devices=list(_devices(run).values()),
    )


def _devices(run: Run) -> dict[str, DeviceRecord]:
    if isinstance(run.record, CompareRecord):
        return {each.label: each.device for each in run.record.devices}
    return {"": run.record.device}


def _circumstances(first: Run, second: Run) -> list[Circumstance]:
    """What may explain a difference, of machines, drivers, versions and seeds."""
    facts = [_facts(run) for run in (first, second)]
    return [
        Circumstance(name=name, first=one, second=two)
        for name in dict.fromkeys([*facts[0], *facts[1]])
        for one, two in [[each.get(name, "not said") for each in facts]]
        if one != two
    ]


def _facts(run: Run) -> dict[str, str]:
    facts = {"clgrid": run.record.clgrid}
    for label, device in _devices(run).items():
        before = f"{label}: " if label else ""
        said = {"device": device.name, "driver": device.driver, "platform": device.platform}
        facts |= {f"{before}{name}": text for name, text in said.items()}
    facts |= _host(run.document.get("host"))
    facts |= {f"seed of {name}": str(seed) for name, seed in run.record.seeds.items()}
    facts |= {name: str(run.document[name]) for name in ("clock",) if name in run.document}
    need: dict[str, Any] = run.document.get("need") or {}
    facts |= {name: str(need[name]) for name in ("frames", "rebuild") if name in need}
    return facts


def _host(host: dict[str, Any] | None) -> dict[str, str]:
    if not host:
        return {}
    facts = {name: str(host[name]) for name in ("processor", "cores", "system")}
    return facts | {name: str(version) for name, version in host["versions"].items()}
