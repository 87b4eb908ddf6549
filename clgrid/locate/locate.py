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
from clgrid.locate.wording import labels_of, sentence
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
        If the rung is not strict, or the mesh has no triangles.
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


def _told(found: difference.Found, first: SideRecord, second: SideRecord) -> tuple[str, str]:
    """The kind of the finding, and a sentence."""
    if found.first is not None:
        return OPERATION, sentence(found.first, (first, second))
    labels = labels_of(first, second)
    ways = [way for way in ("alone", "together") if getattr(first, way) != getattr(second, way)]
    if not ways:
        return NONE, f"{labels[0]} and {labels[1]} agree in all {first.values:,} values and in what they cast"
    cast = {"alone": "casts the ray alone", "together": "casts 64 such rays together"}
    answers = "; ".join(
        f"{label} {_answer(getattr(side, ways[0]))}"
        for label, side in zip(labels, (first, second), strict=True)
    )
    return KERNEL, (
        f"all {first.values:,} values of the traces are equal, but cast_closest.cl, where it {cast[ways[0]]},"
        f" gives: {answers}: it is another compilation of the same code"
    )


def _answer(answer: AnswerRecord) -> str:
    if answer.triangle < 0:
        return "a miss"
    t, u, v = (float.fromhex(text) for text in (answer.t, answer.u, answer.v))
    return f"triangle {answer.triangle}, t {t!r} ({answer.t}), u {u!r}, v {v!r}"
