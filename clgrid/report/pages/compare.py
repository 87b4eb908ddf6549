"""The page of ``clgrid compare``."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median

import numpy as np

from clgrid.compare_record import COMPLETED, CompareDevice, ComparePair, CompareRecord, CompareRow
from clgrid.report.model import Axis, Block, HeatMap, Page, Range, Ranges, Section
from clgrid.report.pages import compare_tables as tables
from clgrid.report.pages.shared import BANDS, facts, joined, named, repeated, time_range
from clgrid.report.quantity import COUNT, NUMBER, SECONDS, counted

# Heat maps shown; further pairs are in the table.
_MAPS = 12


def page(record: CompareRecord) -> Page:
    """Return the page of several devices at the same work."""
    scenes = [*dict.fromkeys(pair.scene for pair in record.pairs)] or [
        *dict.fromkeys(row.scene for device in record.devices for row in device.rows)
    ]
    devices = joined([device.label for device in record.devices]) or "No device"
    sections = [
        Section("Whether they agree", _agreement(record), _agreement_text(record)),
        Section("How fast they are", _speed(record)),
        Section(
            "What they are",
            tables.devices(record),
            "What explains differences, as the drivers say and as small kernels show.",
        ),
    ]
    return Page(
        title=f"{devices} compared on {joined([named(scene) for scene in scenes]) or 'no scene'}",
        says=_says(record),
        warnings=_warnings(record),
        sections=sections,
        facts=_facts(record),
        commands=repeated(record),
        compiled=record.compiled,
    )


def _says(record: CompareRecord) -> list[str]:
    done = [device for device in record.devices if device.status == COMPLETED]
    says: list[str] = []
    strict = [pair for pair in record.pairs if pair.promised]
    loose = [pair for pair in record.pairs if not pair.promised]
    if strict:
        rungs = joined([*dict.fromkeys(pair.accuracy for pair in strict)])
        broken = [pair for pair in strict if not pair.equal]
        rays = sum(each.rays for pair in strict for each in pair.rays)
        if broken:
            says.append(_broken(broken, len(strict)))
        else:
            says.append(
                f"The same answers, bit for bit: on {rungs}, {counted(len(done), 'device')} built the same"
                f" grids, hit the same triangles at the same t, u and v, and drew the same pictures"
                f" ({rays:,} pairs of hits compared)."
            )
    if loose:
        says.append(_loose(loose))
    says += _fastest(record)
    return says or ["No two devices completed the same work, so that nothing could be compared."]


def _broken(broken: Sequence[ComparePair], asked: int) -> str:
    first = broken[0]
    rays, all_rays = _rays(first)
    found = f"{rays:,} of {all_rays:,} rays differ"
    if not rays:
        found = "grids differ" if not first.grids else f"{first.image.differing:,} pixels differ"
    return (
        f"Not the same bits, though promised: {len(broken)} of {counted(asked, 'comparison')}. First"
        f" {first.accuracy} on {named(first.scene)}, {first.first} against {first.second}: {found}."
    )


def _loose(loose: Sequence[ComparePair]) -> str:
    worst = max(loose, key=lambda pair: _rays(pair)[0])
    rays, all_rays = _rays(worst)
    if not rays:
        return f"On {worst.accuracy}, which promises nothing, no ray differs either."
    flips = sum(each.only_first + each.only_second for each in worst.rays)
    ids = sum(each.id for each in worst.rays)
    return (
        f"On {worst.accuracy}, which promises nothing, {worst.first} and {worst.second} differ most, on"
        f" {named(worst.scene)}: {rays:,} of {all_rays:,} rays in some bit, {ids:,} in the triangle,"
        f" {flips:,} between hit and miss."
    )


def _rays(pair: ComparePair) -> tuple[int, int]:
    """Rays that differ, and all."""
    return sum(each.differing for each in pair.rays), sum(each.rays for each in pair.rays)


def _fastest(record: CompareRecord) -> list[str]:
    """Of each scene, on robust if it was asked for: who is first, and who is last by how much."""
    says: list[str] = []
    for (scene, accuracy), rows in _by_work(record).items():
        if len(rows) < 2 or any(f"{named(scene)}:" in said for said in says):
            continue
        totals = sorted((median(row.build_s) + median(row.render_s), device.label) for device, row in rows)
        (best, first), (most, last) = totals[0], totals[-1]
        says.append(
            f"{named(scene)}: {first} is first to an image on {accuracy}, {SECONDS.text(best)}; {last} takes"
            f" {most / best:.2f} times that."
        )
    return says[:3]


def _by_work(record: CompareRecord) -> dict[tuple[str, str], list[tuple[CompareDevice, CompareRow]]]:
    """Rows by scene and rung, the rung robust first."""
    found: dict[tuple[str, str], list[tuple[CompareDevice, CompareRow]]] = {}
    for device in record.devices:
        for row in device.rows:
            found.setdefault((row.scene, row.accuracy), []).append((device, row))
    return dict(sorted(found.items(), key=lambda work: work[0][1] != "robust"))


def _warnings(record: CompareRecord) -> list[str]:
    found = [failure.error for failure in record.failures]
    for device in record.devices:
        if device.status != COMPLETED:
            words = f"; its last words: {device.last_words}" if device.last_words else ""
            found.append(
                f"{device.label} {_ended(device)} at {device.step or 'its start'}: {device.reason}{words}"
            )
        found += [
            f"{device.label}: {named(each.scene)}, {each.accuracy}: {each.error}" for each in device.failures
        ]
        found += [
            f"{device.label}: {named(row.scene)}: {text}" for row in device.rows for text in row.warnings
        ]
        found += [
            f"{device.label} fails the self-test of {row.accuracy}: {row.self_test}"
            for row in device.rows
            if row.self_test
        ]
    return [*dict.fromkeys(found)]


def _ended(device: CompareDevice) -> str:
    return "ran out of memory" if device.status == "out of memory" else device.status


def _facts(record: CompareRecord) -> list[tuple[str, str]]:
    found = [each for each in facts(record) if each[0] not in ("device", "driver", "platform")]
    return [*found, ("picture", f"{record.width} x {record.height}")]


def _agreement(record: CompareRecord) -> list[Block]:
    blocks: list[Block] = [tables.pairs(record.pairs)] if record.pairs else []
    differing = [pair for pair in record.pairs if pair.ray is not None]
    if differing:
        blocks.append(tables.rays(differing))
    return [*blocks, *_heat_maps(record.pairs)]


def _agreement_text(record: CompareRecord) -> str:
    if not record.pairs:
        return "Fewer than two devices completed any scene."
    left = sum(pair.heat_map is not None for pair in record.pairs) - _MAPS
    return f"Heat maps of the first {_MAPS} pairs that differ; {left} more are left out." if left > 0 else ""


def _heat_maps(pairs: Sequence[ComparePair]) -> list[Block]:
    """Where pictures and primary rays differ; what promises the same bits comes first."""
    blocks: list[Block] = []
    several = len({pair.scene for pair in pairs}) > 1
    shown = [pair for pair in sorted(pairs, key=lambda pair: not pair.promised) if pair.heat_map is not None]
    for pair in shown[:_MAPS]:
        heat = pair.heat_map
        if heat is None:
            continue
        where = f"{pair.accuracy}, {pair.first} / {pair.second}"
        where = f"{named(pair.scene)}, {where}" if several else where
        shape = (heat.height, heat.width)
        each = f"by blocks of {heat.block} x {heat.block} pixels" if heat.block > 1 else "pixel by pixel"
        if any(heat.rays):
            rays = np.asarray(heat.rays, np.float64).reshape(shape)
            note = f"{counted(int(rays.sum()), 'ray differs', 'rays differ')}, {each}."
            blocks.append(HeatMap(f"Primary rays: {where}", rays, COUNT, note))
        if any(heat.image):
            image = np.asarray(heat.image, np.float64).reshape(shape)
            note = f"Largest difference of linear colour, {each}."
            blocks.append(HeatMap(f"Picture: {where}", image, NUMBER, note))
    return blocks


def _speed(record: CompareRecord) -> list[Block]:
    blocks: list[Block] = []
    for (scene, accuracy), rows in _by_work(record).items():
        lines: list[Range] = []
        for device, row in rows:
            label = device.label
            lines.append(time_range(f"build, {label}", row.build_s, label))
            lines.append(time_range(f"render, {label}", row.render_s, label))
            lines += [
                time_range(f"{each.kind} rays, {label}", each.cast_s, label, [("rays", f"{each.rays:,}")])
                for each in row.kinds
            ]
        # One plot a scene: the rungs take their time in the table.
        if not any(named(scene) in block.title for block in blocks):
            title = f"{named(scene)}, {accuracy}: time by device"
            blocks.append(Ranges(title, Axis("time", SECONDS), _by_kind(lines), note=BANDS))
    return [*blocks, tables.speed(record)]


def _by_kind(lines: Sequence[Range]) -> list[Range]:
    """The same work of all devices together."""
    kinds = [*dict.fromkeys(line.label.partition(", ")[0] for line in lines)]
    return sorted(lines, key=lambda line: kinds.index(line.label.partition(", ")[0]))
