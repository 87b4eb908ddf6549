"""``clgrid report``: a saved record as a table, page, CSV or plot; two records compared."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from clgrid.cli import options, output, report_files
from clgrid.errors import InputError

if TYPE_CHECKING:
    from rich.table import Table as RichTable

    from clgrid.report.difference_record import DifferenceRecord
    from clgrid.report.model import Page, Table
    from clgrid.report.read import Run

NOISE = "Two runs"

Records = Annotated[
    list[Path],
    typer.Argument(
        metavar="A.json [B.json]",
        help="Records that --json wrote: of bench, compare, tradeoff, verify or render.",
        show_default=False,
    ),
]
Threshold = Annotated[
    str | None,
    typer.Option(
        metavar="SHARE",
        help="Count a time as changed only beyond this share, and beyond noise. Default: 10%.",
        rich_help_panel=NOISE,
        show_default=False,
    ),
]
Unknown = Annotated[
    str | None,
    typer.Option(
        "--unknown-noise",
        metavar="SHARE",
        help="Taken for noise where there are fewer than 4 repetitions. Default: 25%.",
        rich_help_panel=NOISE,
        show_default=False,
    ),
]


def report(
    records: Records,
    html: report_files.Html = None,
    csv: report_files.Csv = None,
    plot: report_files.Plot = None,
    threshold: Threshold = None,
    unknown_noise: Unknown = None,
    json: options.Json = False,
    quiet: options.Quiet = False,
) -> int:
    """Show a saved record again, or compare two runs. Exit code 2: the second is worse than the first.

    Rows are matched by scene, layout, rung and so on; times are compared beyond the noise of their
    repetitions, counts and bytes exactly. Machines, devices and versions that differ are named first.
    """
    if len(records) > 2:
        raise InputError(f"report: {len(records)} records; give one, or two to compare")
    if len(records) < 2 and (threshold is not None or unknown_noise is not None):
        option = "threshold" if threshold is not None else "unknown-noise"
        raise InputError(f"report: --{option} belongs to two records; give another")
    wanted = report_files.Files(html, csv, plot)
    wanted.check()

    from clgrid.report.read import read

    runs = [read(path) for path in records]
    if len(runs) == 1:
        return _one(runs[0], wanted, json=json, quiet=quiet)

    from clgrid.report import csvfile, difference, files
    from clgrid.report.pages.difference import page

    result = difference.compare(
        runs[0],
        runs[1],
        threshold=_share(threshold, "--threshold", difference.THRESHOLD),
        unknown=_share(unknown_noise, "--unknown-noise", difference.UNKNOWN),
    )
    wanted.write_page(page(result))
    if csv is not None:
        files.save_text(csv, "--csv", csvfile.of_difference(result))
    if json:
        from clgrid.record import encode

        output.emit(encode(result))
    elif not quiet:
        _show(page(result), without=("All fields",))
    return _judge(result)


def _one(run: Run, wanted: report_files.Files, *, json: bool, quiet: bool) -> int:
    wanted.write(run.record)
    if json:
        from clgrid.record import encode

        output.emit(encode(run.record))
    elif not quiet:
        from clgrid.report.pages import page

        _show(page(run))
    return 0


def _judge(result: DifferenceRecord) -> int:
    from clgrid.report.difference import regressions
    from clgrid.report.pages.difference import said, words

    worse = regressions(result)
    if not worse:
        return 0
    first = worse[0]
    more = f" and {len(worse) - 1} more" if len(worse) > 1 else ""
    typer.echo(
        f"clgrid: error: {result.second.file} is worse than {result.first.file}: {first.row}:"
        f" {words(first.field)} {said(first)}{more}",
        err=True,
    )
    return 2


def _share(text: str | None, option: str, default: float) -> float:
    """Read ``5%`` or ``0.05``."""
    if text is None:
        return default
    try:
        share = float(text.removesuffix("%")) / (100.0 if text.endswith("%") else 1.0)
    except ValueError:
        share = -1.0
    if not 0 <= share < 100:
        raise InputError(f"{option} {text!r}: give a share such as 5% or 0.05")
    return share


def _show(page: Page, without: Sequence[str] = ()) -> None:
    """Write what a page says, and its tables."""
    from clgrid.report.model import Table

    output.emit("".join(f"{line}\n" for line in (page.title, *page.warnings, *page.says)))
    for section in page.sections:
        for block in section.blocks:
            if isinstance(block, Table) and block.title not in without:
                output.emit_table(_table(block, section.title))
        if section.text and not section.blocks:
            output.emit(f"{section.text}\n")


def _table(table: Table, section: str) -> RichTable:
    from rich.table import Table as RichTable
    from rich.text import Text

    from clgrid.report.cells import scale, shown
    from clgrid.report.model import BAD, CHOSEN, GOOD, cell

    styles = {BAD: "red", GOOD: "green"}
    rich = RichTable(title=f"{section}: {table.title}", title_justify="left", pad_edge=False)
    kept = [k for k, column in enumerate(table.columns) if not column.detail]
    columns = [table.columns[k] for k in kept]
    units = [scale(table, k) for k in kept]
    for column, unit in zip(columns, units, strict=True):
        name = f"{column.name} [{unit.name}]" if unit.name else column.name
        justify = "right" if column.quantity else "left"
        rich.add_column(Text(name), justify=justify, overflow="fold")  # type: ignore[arg-type]
    signs = {CHOSEN: "* ", GOOD: "+ "}
    for number, row in enumerate(table.rows):
        texts = [
            Text(shown(column, value, unit), style=styles.get(cell(value).mark, ""))
            for column, value, unit in zip(columns, [row[k] for k in kept], units, strict=True)
        ]
        texts[0] = Text(signs.get(table.marks.get(number, ""), "")) + texts[0]
        rich.add_row(*texts)
    return rich
