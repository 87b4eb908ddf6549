"""The files that a record can be written to beside its table: options of several verbs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from clgrid.cli.options import OUTPUT

if TYPE_CHECKING:
    from clgrid.record import Header
    from clgrid.report.model import Page

Html = Annotated[
    Path | None,
    typer.Option(
        "--html",
        metavar="FILE.html",
        help="Write a page: what it says, tables that sort, plots; one file that needs no network.",
        rich_help_panel=OUTPUT,
        show_default=False,
    ),
]
Csv = Annotated[
    Path | None,
    typer.Option(
        "--csv",
        metavar="FILE.csv",
        help="Write a line a row: medians, and every repetition.",
        rich_help_panel=OUTPUT,
        show_default=False,
    ),
]
Plot = Annotated[
    Path | None,
    typer.Option(
        "--plot",
        metavar="FILE.png|svg",
        help="Draw the page's plots; needs matplotlib: pip install 'clgrid[plot]'.",
        rich_help_panel=OUTPUT,
        show_default=False,
    ),
]


def check_files(html: Path | None, csv: Path | None, plot: Path | None) -> None:
    """Find out before the work whether the files could be written.

    Raises
    ------
    InputError
        If a folder is missing, or a plot's format is unknown.
    UnsupportedError
        If there is no matplotlib for the plot.
    """
    if html is None and csv is None and plot is None:
        return
    from clgrid.report import files

    for path, option in ((html, "--html"), (csv, "--csv")):
        if path is not None:
            files.check(path, option)
    if plot is not None:
        files.check_plot(plot)


def write_files(
    record: Header,
    html: Path | None,
    csv: Path | None,
    plot: Path | None,
    command: Sequence[str] = (),
) -> None:
    """Write a record to the files asked for.

    Parameters
    ----------
    command : sequence of str
        Words of the command line that repeats it, where the record does not say them.

    Raises
    ------
    InputError
        If one cannot be written.
    """
    if html is None and csv is None and plot is None:
        return
    from clgrid.report import csvfile, files
    from clgrid.report.pages import page
    from clgrid.report.pages.shared import command_line
    from clgrid.report.read import Run

    run = Run.of(record, record.schema)
    if csv is not None:
        files.save_text(csv, "--csv", csvfile.of_run(run))
    if html is not None or plot is not None:
        write_page(page(run, [command_line(command)] if command else []), html, plot)


def write_page(page: Page, html: Path | None, plot: Path | None) -> None:
    """Write a page as HTML and as a picture of its plots, if asked for."""
    from clgrid.report import files

    if html is not None:
        from clgrid.report.html import html as written

        files.save_text(html, "--html", written(page))
    if plot is not None:
        from clgrid.report.plot import draw

        files.save(plot, "--plot", lambda partial: draw(page, partial))
