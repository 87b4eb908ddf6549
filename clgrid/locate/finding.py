"""From a ray on which two devices differ to the operation in which they part."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from clgrid.errors import InputError
from clgrid.layouts.lists import NESTED
from clgrid.locate import difference
from clgrid.locate.setting import Setting
from clgrid.locate.sides import TIMEOUT_SECONDS, Seen, Side, ask
from clgrid.locate.stages import stages_of
from clgrid.locate.trace import Record, records
from clgrid.locate.wording import NO_HIT, answer_text, labels_of, sentence, value_of
from clgrid.mesh import Mesh
from clgrid.repro_record import (
    KERNEL,
    NONE,
    OPERATION,
    AnswerRecord,
    Located,
    ReproGrid,
    ReproRay,
    SideRecord,
)
from clgrid.rungs import LOSSLESS

# How a ray is cast, by the field of SideRecord that tells its hit.
_WAYS = {"alone": "cast alone", "together": "cast in a tile of 64 such rays"}


@dataclass(frozen=True)
class Finding:
    """What was found on a ray, and what it takes to see it again.

    Attributes
    ----------
    located : Located
        The finding itself.
    mesh : Mesh
    sides : (Side, Side)
    tested : tuple of int
        Triangles that the ray was tested against on either side, ascending.
    """

    located: Located
    mesh: Mesh
    sides: tuple[Side, Side]
    tested: tuple[int, ...]


def locate(
    mesh: Mesh,
    grid: ReproGrid,
    ray: ReproRay,
    sides: tuple[Side, Side],
    *,
    names: Sequence[int] | None = None,
    timeout: float = TIMEOUT_SECONDS,
) -> Finding:
    """Find where two devices part on a ray.

    Parameters
    ----------
    mesh : Mesh
    grid : ReproGrid
        Of a strict rung.
    ray : ReproRay
    sides : (Side, Side)
        ``Side("intel")``, or ``Side.here("intel")`` with the build options and kernels of this process.
    names : sequence of int, optional
        The numbers by which the mesh's triangles are told, if not their own.
    timeout : float
        Seconds for each side.

    Returns
    -------
    Finding
        Its ``located`` is of kind ``none`` if they agree.

    Raises
    ------
    InputError
        If the rung is not strict, or the mesh has no triangles, or too many for one buffer of a device.
    DeviceError
        If a device is not there, refuses, crashes or hangs.
    """
    if grid.accuracy not in LOSSLESS:
        raise InputError(
            f"{grid.accuracy} promises no bits, so nothing is located; choose {', '.join(LOSSLESS)}"
        )
    if not mesh.triangle_count:
        raise InputError(f"{mesh.source} has no triangles, so that no ray meets any")
    first, second = ask(mesh, grid, ray, sides, timeout)
    parts = max(len(seen.result.planes) for seen in (first, second))
    if parts > 1:
        raise InputError(
            f"{mesh.source} takes {parts} grids on a device, which is not followed; give fewer triangles"
        )
    traces = [_records(seen, grid) for seen in (first, second)]
    setting = Setting.of(mesh, grid, ray, first.result.planes[0], names)
    found = difference.compare(traces[0], traces[1], setting)
    one = _side(sides[0], first, traces[0], setting)
    other = _side(sides[1], second, traces[1], setting)
    kind, where = _told(found, one, other)
    located = Located(
        kind=kind,
        where=where,
        ray=ray,
        grid=grid,
        sides=(one, other),
        differing=found.differing,
        difference=found.first,
        decision=found.decision,
    )
    tested = {record.item for trace in traces for record in trace if record.stage.name == "triangle"}
    return Finding(located, mesh, sides, tuple(sorted(tested)))


def _records(seen: Seen, grid: ReproGrid) -> list[Record]:
    return list(records(seen.words, stages_of(grid.accuracy, nested=grid.layout in NESTED)))


def _side(side: Side, seen: Seen, trace: Sequence[Record], setting: Setting) -> SideRecord:
    result, checked = seen.result, difference.audit(trace, setting)
    return SideRecord(
        label=result.label,
        device=result.device,
        build_options=side.build_options,
        kernels=side.kernels,
        compiled=result.compiled,
        traced=_end_of(trace, setting),
        alone=_named(result.alone, setting),
        together=_named(result.together, setting),
        values=sum(len(record.bits) for record in trace),
        checked=checked.checked,
        off=checked.off,
        off_as=checked.off_as,
    )


def _named(answer: AnswerRecord, setting: Setting) -> AnswerRecord:
    known = answer.triangle if answer.triangle < 0 else setting.name_of(answer.triangle)
    return AnswerRecord(known, answer.t, answer.u, answer.v)


def _end_of(trace: Sequence[Record], setting: Setting) -> AnswerRecord:
    """The hit at the end of a trace."""
    last = trace[-1]
    number, *bits = last.bits[:4]
    kinds = [value.type for value in last.stage.values[1:4]]
    t, u, v = (value_of(*each)[0].hex() for each in zip(kinds, bits, strict=True))
    return AnswerRecord(-1 if number == NO_HIT else setting.name_of(number), t, u, v)


def _told(found: difference.Found, first: SideRecord, second: SideRecord) -> tuple[str, str]:
    """The kind of the finding, and a sentence."""
    sides = (first, second)
    labels = labels_of(*sides)
    way = next((way for way in _WAYS if getattr(first, way) != getattr(second, way)), None)
    answers = [getattr(side, way or "alone") for side in sides]
    said = ", ".join(f"{label} {answer_text(each)}" for label, each in zip(labels, answers, strict=True))
    if found.first is not None:
        so = f"; hits, {_WAYS[way]}: {said}" if way else "; the hits are the same all the same"
        return OPERATION, sentence(found.first, sides) + so
    if way is None:
        return NONE, f"{labels[0]} and {labels[1]} agree in all {first.values:,} values and in what they cast"
    astray = [
        label for label, side, answer in zip(labels, sides, answers, strict=True) if answer != side.traced
    ]
    return KERNEL, (
        f"the traces are equal, {first.values:,} values each, but cast_closest.cl, another compilation of the"
        f" same code, is not: {_WAYS[way]} it gives {said}; {' and '.join(astray)} not what its trace has"
    )
