"""``clgrid diff``: how two pictures differ."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from clgrid.cli import options, output

if TYPE_CHECKING:
    from rich.table import Table

    from clgrid.difference_record import DiffRecord

WITHIN = "Tolerance"

First = Annotated[str, typer.Argument(metavar="A", help="EXR, PNG or JPEG; the reference.")]
Second = Annotated[str, typer.Argument(metavar="B", help="What is compared with it.")]
Tolerance = Annotated[
    float,
    typer.Option(
        min=0.0,
        help="Largest absolute difference of a channel, linear; ids and steps have none.",
        rich_help_panel=WITHIN,
    ),
]
MaxFlip = Annotated[
    float | None,
    typer.Option(
        min=0.0,
        help="Largest mean of FLIP, 0 to 1, in place of --tolerance for colours.",
        rich_help_panel=WITHIN,
        show_default=False,
    ),
]
Groups = Annotated[
    str,
    typer.Option(
        metavar="NAMES",
        help="Compare these: rgba,depth,normal,id,... Default: all that either has.",
        rich_help_panel=WITHIN,
        show_default=False,
    ),
]


def diff(
    first: First,
    second: Second,
    tolerance: Tolerance = 0.0,
    max_flip: MaxFlip = None,
    groups: Groups = "",
    json: options.Json = False,
    quiet: options.Quiet = False,
) -> int:
    """Compare two pictures, group by group. Exit code 2: they differ beyond the tolerance.

    A group that only one of them has is a difference.
    """
    from clgrid import record
    from clgrid.picture_difference import compare_pictures

    names = [name.strip() for name in groups.split(",") if name.strip()]
    result = compare_pictures(first, second, tolerance, max_flip, names)
    if json:
        output.emit(record.encode(result))
    elif not quiet:
        output.emit_table(_table(result))
        if result.flip is not None:
            output.emit(f"FLIP {result.flip:.3g}, at most {result.largest_flip:.3g}\n")
        for name in result.missing:
            output.emit(f"only one of them has the group {name}\n")
    return 0 if result.within else 2


def _table(result: DiffRecord) -> Table:
    from rich.table import Table
    from rich.text import Text

    title = Text(f"{result.first}, {result.second}: {result.width} x {result.height}")
    table = Table(title=title, title_justify="left", pad_edge=False)
    table.add_column("group")
    for number in ("pixels that differ", "beyond tolerance", "largest", "mean", "PSNR"):
        table.add_column(number, justify="right")
    for each in result.groups:
        table.add_row(
            each.group,
            f"{each.differing:,} of {result.pixels:,}",
            f"{each.beyond:,}",
            _number(each.largest),
            _number(each.mean),
            _psnr(each.psnr, equal=each.largest == 0),
        )
    return table


def _number(value: float | None) -> str:
    return "infinite" if value is None else f"{value:.3g}"


def _psnr(value: float | None, *, equal: bool) -> str:
    return f"{value:.1f} dB" if value is not None else "equal" if equal else "-"
