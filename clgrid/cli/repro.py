"""``clgrid repro``: the difference between two devices that a file holds, run again on the devices of now."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from clgrid.cli import options, output
from clgrid.errors import InputError

if TYPE_CHECKING:
    from clgrid.repro_record import Difference, Located, ReplayRecord

_DIFFER = 2
_OUTCOMES = {
    "same": "the difference of the file",
    "another": "another difference than that of the file",
    "none": "no difference: the devices agree",
}


def repro(
    file: Annotated[
        str, typer.Argument(metavar="FILE", help="As clgrid compare writes it.", show_default=False)
    ],
    devices: Annotated[
        str | None,
        typer.Option(
            metavar="A,B",
            help="Two devices instead of the file's, each an index or a name; a device may be named twice.",
            show_default=False,
            rich_help_panel=options.GRID,
        ),
    ] = None,
    trust: Annotated[
        bool,
        typer.Option(
            "--trust",
            help="Run the kernel sources that the file brings: they are programs like any other.",
            rich_help_panel=options.GRID,
        ),
    ] = False,
    json: options.Json = False,
) -> None:
    """Run a difference between two devices again. Exit code 2: they differ; 3: one is not there."""
    from clgrid import record
    from clgrid.locate import replay

    replayed = replay(file, _pair(devices), trust=trust)
    if json:
        output.emit(record.encode(replayed))
    else:
        _emit(replayed)
    if replayed.outcome != "none":
        raise typer.Exit(_DIFFER)


def _pair(devices: str | None) -> tuple[str, str] | None:
    if devices is None:
        return None
    names = [name.strip() for name in devices.split(",")]
    if len(names) != 2 or not all(names):
        raise InputError(f"--devices {devices!r}: give two, such as intel,pocl-3.0")
    return names[0], names[1]


def _emit(replayed: ReplayRecord) -> None:
    from clgrid.locate.wording import sentence

    found, grid = replayed.found, replayed.found.grid
    rows = [("found", _OUTCOMES[replayed.outcome])]
    rows += [("where", found.where)]
    if found.decision is not None and found.decision != found.difference:
        rows += [("first decision", sentence(found.decision, found.sides))]
    if replayed.outcome == "another":
        rows += [("in the file", replayed.expected.where)]
    cells = "x".join(str(n) for n in grid.resolution)
    rows += [("grid", f"{grid.layout}, {grid.accuracy}, {cells} cells")]
    rows += [
        (label, f"{side.device.platform}: {side.device.name}, driver {side.device.driver}")
        for label, side in zip(("first", "second"), found.sides, strict=True)
    ]
    rows += _answers(found)
    if found.difference is not None:
        rows += _inputs(found.difference)
    output.emit_pairs(rows)


def _answers(found: Located) -> list[tuple[str, str]]:
    from clgrid.locate.wording import answer_text

    rows = []
    for way, what in (("alone", "hit, cast alone"), ("together", "hit, in a tile of 64")):
        one, other = (getattr(side, way) for side in found.sides)
        for label, answer in (("first", one), ("second", other)) if one != other else (("both", one),):
            rows.append((what, f"{label}: {answer_text(answer)}"))
    return rows


def _inputs(difference: Difference) -> list[tuple[str, str]]:
    """The statements that give the differing value, and what goes into them."""
    rows = [("computed by", "; ".join((*difference.steps, difference.operation)))]
    rows += [(name, f"{value.bits}  {value.decimal}") for name, value in difference.inputs.items()]
    return rows
