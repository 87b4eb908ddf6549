"""The file that replays a difference: written with as few triangles as still show it, read, run again."""

from __future__ import annotations

from pathlib import Path

import msgspec

from clgrid import cache, record
from clgrid.errors import ClgridError, InputError
from clgrid.locate import meshes
from clgrid.locate.finding import Finding, locate
from clgrid.locate.sides import TIMEOUT_SECONDS, Side
from clgrid.repro_record import NONE, Difference, Located, ReplayRecord, ReproMesh, ReproRecord, SideRecord

SCHEMA, REPLAY_SCHEMA = record.schema("repro"), record.schema("repro.run")
SAME, ANOTHER = "same", "another"
"""Outcomes of a replay, beside NONE."""


def write_repro(path: str | Path, finding: Finding, timeout: float = TIMEOUT_SECONDS) -> ReproRecord:
    """Write a file that ``clgrid repro`` replays.

    It has the triangles that the ray was tested against, if these alone show the same difference, which is
    tried; else the whole mesh. It appears under its name only when complete.

    Parameters
    ----------
    path : str or Path
    finding : Finding
        Of ``locate``.
    timeout : float
        Seconds for each side, to try it.

    Raises
    ------
    InputError
        If there is no difference, or the file cannot be written.
    """
    if finding.located.kind == NONE:
        raise InputError(f"the devices agree, so there is nothing to write to {path}")
    written = ReproRecord(
        schema=SCHEMA,
        clgrid=record.version(),
        mesh=_enough(finding, timeout),
        located=finding.located,
    )
    try:
        cache.write_whole(Path(path), record.encode(written))
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror or error}") from error
    return written


def _enough(finding: Finding, timeout: float) -> ReproMesh:
    """The triangles that show the difference."""
    some = meshes.some_of(finding.mesh, finding.tested)
    if some is None:
        return meshes.whole_of(finding.mesh)
    located = finding.located
    try:
        again = locate(
            meshes.mesh_of(some),
            located.grid,
            located.ray,
            finding.sides,
            names=some.triangle_ids,
            timeout=timeout,
        )
    except ClgridError:
        # Whatever befalls a side without the other triangles, it is not this difference.
        return meshes.whole_of(finding.mesh)
    return some if outcome_of(located, again.located) == SAME else meshes.whole_of(finding.mesh)


def read_repro(path: str | Path) -> ReproRecord:
    """Read a file that ``write_repro`` wrote.

    Raises
    ------
    InputError
        If it cannot be read, is none, or is damaged; one line.
    """
    try:
        text = Path(path).read_bytes()
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror or error}") from error
    try:
        told = msgspec.json.decode(text)
        schema = told.get("schema") if isinstance(told, dict) else None
        if schema != SCHEMA:
            raise InputError(f"{path} is no file of clgrid repro: its schema is {schema!r}, not {SCHEMA!r}")
        read = record.decode(text, ReproRecord)
    except msgspec.DecodeError as error:
        raise InputError(f"{path} is damaged: {error}; have it written again") from error
    try:
        meshes.mesh_of(read.mesh)
        _ = read.located.ray.arrays, read.located.ray.interval
    except (ClgridError, ValueError, TypeError, OverflowError) as error:
        raise InputError(f"{path} is damaged: {error}; have it written again") from error
    return read


def replay(
    path: str | Path,
    devices: tuple[str, str] | None = None,
    *,
    trust: bool = False,
    timeout: float = TIMEOUT_SECONDS,
) -> ReplayRecord:
    """Run what a file holds on the devices that are there now.

    Parameters
    ----------
    path : str or Path
    devices : (str, str), optional
        Selectors, instead of the file's.
    trust : bool
        Whether to run kernel sources that the file brings.
    timeout : float
        Seconds for each side.

    Raises
    ------
    InputError
        If the file is none, is damaged, or brings kernels and is not trusted.
    DeviceError
        If a device is not there, or fails.
    """
    read = read_repro(path)
    expected = read.located
    brought = sorted({name for side in expected.sides for name in side.kernels})
    if brought and not trust:
        raise InputError(
            f"{path} brings kernel sources of its own ({', '.join(brought)}), which would run here:"
            " look at them, then give --trust"
        )
    labels = devices or tuple(side.label for side in expected.sides)
    first, second = (_side(*each) for each in zip(labels, expected.sides, strict=True))
    found = locate(
        meshes.mesh_of(read.mesh),
        expected.grid,
        expected.ray,
        (first, second),
        names=read.mesh.triangle_ids or None,
        timeout=timeout,
    ).located
    return ReplayRecord(
        schema=REPLAY_SCHEMA,
        clgrid=record.version(),
        file=str(path),
        outcome=outcome_of(expected, found),
        written_by=read.clgrid,
        expected=expected,
        found=found,
    )


def _side(label: str, recorded: SideRecord) -> Side:
    return Side(label, recorded.build_options, recorded.kernels)


def outcome_of(expected: Located, found: Located) -> str:
    """``none`` if the devices agree, ``same`` if they part as expected, in either order, else ``another``."""
    if found.kind == NONE:
        return NONE
    return SAME if _essence(expected) == _essence(found) else ANOTHER


def _essence(located: Located) -> object:
    """What makes two findings the same."""
    difference = located.difference
    if difference is None:
        answers = {(side.alone, side.together) for side in located.sides}
        return located.kind, frozenset(answers)
    return located.kind, _place(difference), frozenset((difference.first, difference.second))


def _place(difference: Difference) -> tuple[object, ...]:
    return difference.stage, difference.value, difference.cell, difference.triangle
