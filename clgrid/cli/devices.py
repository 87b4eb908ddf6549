"""``clgrid devices`` and ``clgrid doctor``: which OpenCL devices there are, and what is wrong with them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from clgrid.cli import options, output

if TYPE_CHECKING:
    from clgrid.description import Description
    from clgrid.doctor import Finding

_NO_DEVICE = 3
_COLOURS = {"ok": "green", "warn": "yellow", "fail": "red"}


def devices(json: options.Json = False) -> None:
    """List the OpenCL devices of this machine; --device takes the index or the label."""
    from clgrid import device

    found = device.describe_all()
    if json:
        _emit_json({"schema": "clgrid.devices/1", "devices": found})
    else:
        _emit_devices(found)
    if not found:
        from clgrid.errors import DeviceError

        raise DeviceError(f"no OpenCL device: {device.INSTALL}; clgrid doctor says more")


def doctor(
    json: options.Json = False,
    device: Annotated[
        str | None,
        typer.Option(metavar="INDEX|NAME", help="Try this device only.", show_default=False),
    ] = None,
    selftest: Annotated[
        bool,
        typer.Option(
            "--selftest/--no-selftest",
            help="Run the self-test of each strict rung, or tell what earlier ones found.",
        ),
    ] = True,
    fix: Annotated[
        bool,
        typer.Option(
            "--fix",
            help="First register Intel's runtime for every program of this virtual environment.",
        ),
    ] = False,
) -> None:
    """Find out what is wrong with OpenCL here, and how to cure it. Exit code 3: no usable device."""
    from clgrid.doctor import examine

    done = _fix() if fix else ()
    with output.progress(quiet=False) as show:
        report = examine(device, selftest=selftest, progress=show)
    if json:
        _emit_json(
            {
                "schema": "clgrid.doctor/1",
                "usable": report.usable,
                "default": report.default,
                "findings": (*done, *report.findings),
                "rungs": report.rungs,
            }
        )
    else:
        _emit_findings((*done, *report.findings))
    if not report.usable:
        raise typer.Exit(_NO_DEVICE)


def _fix() -> tuple[Finding, ...]:
    from clgrid.doctor import repair

    return (repair.fix(),)


def _emit_json(record: dict[str, Any]) -> None:
    import msgspec

    import clgrid

    schema = record.pop("schema")
    document = {"schema": schema, "clgrid": clgrid.__version__, **record}
    output.emit(msgspec.json.format(msgspec.json.encode(document), indent=2).decode() + "\n")


def _emit_devices(found: list[Description]) -> None:
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False)
    for heading in ("index", "label", "platform", "device", "driver", "OpenCL", "type", "units"):
        table.add_column(heading, overflow="fold")
    for heading in ("memory", "one buffer", "fp64", "divide", "denormals"):
        table.add_column(heading, no_wrap=True)
    for d in found:
        cells = (
            f"{d.index}{'*' if d.preferred else ''}",
            d.label,
            d.platform,
            d.name,
            d.driver_version,
            d.version.removeprefix("OpenCL ").split(" ")[0],
            d.type,
            str(d.compute_units),
            f"{d.global_memory / 2**30:.1f} GiB",
            f"{d.max_allocation / 2**30:.1f} GiB",
            "yes" if d.fp64 else "no",
            "exact" if d.correctly_rounded_divide else "not promised",
            "kept" if d.denormals else "flushed",
        )
        table.add_row(*(Text(cell) for cell in cells))
    if found:
        output.emit_table(table)
        notes = [f"{d.index} {d.note}\n" for d in found if d.note]
        output.emit("".join(notes) + "* used where none is named, if it works (clgrid doctor tries it)\n")


def _emit_findings(findings: tuple[Finding, ...]) -> None:
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False, show_header=False)
    table.add_column(no_wrap=True)
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for finding in findings:
        where = f"{finding.device}: " if finding.device else ""
        advice = f"\n-> {finding.advice}" if finding.advice else ""
        table.add_row(
            Text(finding.status, style=_COLOURS[finding.status]),
            finding.check,
            Text(where + finding.message + advice),
        )
    output.emit_table(table)
