"""The files that a record can be written to beside its table: options of several verbs."""

from __future__ import annotations

from dataclasses import dataclass
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
        help="Draw the page's plots; needs matplotlib: pip install 'clgrid\\[plot]'.",
        rich_help_panel=OUTPUT,
        show_default=False,
    ),
]


@dataclass(frozen=True)
class Files:
    """The files asked for; None is not written."""

    html: Path | None = None
    csv: Path | None = None
    plot: Path | None = None

    def __bool__(self) -> bool:
        return (self.html, self.csv, self.plot) != (None, None, None)

    def check(self) -> None:
        """Find out before the work whether the files could be written.

        Raises
        ------
        InputError
            If a folder is missing, or a plot's format is unknown.
        UnsupportedError
            If there is no matplotlib for the plot.
        """
        if not self:
            return
        from clgrid.report import files

        for path, option in ((self.html, "--html"), (self.csv, "--csv")):
            if path is not None:
                files.check(path, option)
        if self.plot is not None:
            files.check_plot(self.plot)

    def write(self, record: Header) -> None:
        """Write a record.

        Raises
        ------
        InputError
            If a file cannot be written.
        """
        if not self:
            return
        from clgrid.report import csvfile, files
        from clgrid.report.pages import page
        from clgrid.report.read import Run

        run = Run.of(record, record.schema)
        if self.csv is not None:
            files.save_text(self.csv, "--csv", csvfile.of_run(run))
        self.write_page(page(run))

    def write_page(self, page: Page) -> None:
        """Write a page as HTML and as a picture of its plots, if they are asked for."""
        if self.html is None and self.plot is None:
            return
        from clgrid.report import files

        if self.html is not None:
            from clgrid.report.html import html

            files.save_text(self.html, "--html", html(page))
        if self.plot is not None:
            from clgrid.report.plot import draw

            files.save(self.plot, "--plot", lambda partial: draw(page, partial))
