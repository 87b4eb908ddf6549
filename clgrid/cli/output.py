"""What goes to the terminal: tables and JSON on stdout, progress and warnings on stderr."""

from __future__ import annotations

import io
import shutil
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable

    from rich.table import Table

    from clgrid.record import Header

Signed = TypeVar("Signed", bound="Header")
_WIDTH_OF_FILES = 160


class OutputClosedError(Exception):
    """The reader of our stdout went away."""


def emit(text: str) -> None:
    """Write to stdout at once.

    Raises
    ------
    OutputClosedError
        If nobody reads it.
    """
    try:
        sys.stdout.write(text)
        sys.stdout.flush()
    except BrokenPipeError as error:
        raise OutputClosedError from error


def signed(made: Signed) -> Signed:
    """Return a record with the command line and the machine that made it."""
    import msgspec

    from clgrid.host import host_record

    return msgspec.structs.replace(made, command=("clgrid", *sys.argv[1:]), host=host_record())


def warn(messages: Iterable[str], *, quiet: bool) -> None:
    """Write warnings to stderr, a line each."""
    for message in () if quiet else messages:
        print(f"clgrid: warning: {message}", file=sys.stderr)


def emit_table(table: Table) -> None:
    """Write a rich table to stdout: as wide as the terminal, or wide and plain into a file."""
    from rich.console import Console

    terminal = sys.stdout.isatty()
    width = shutil.get_terminal_size().columns if terminal else _WIDTH_OF_FILES
    buffer = io.StringIO()
    Console(file=buffer, width=width, force_terminal=terminal, highlight=False).print(table)
    emit("".join(f"{line.rstrip()}\n" for line in buffer.getvalue().splitlines()))


def emit_pairs(rows: Sequence[tuple[str, str]], title: str | None = None) -> None:
    """Write names and values in two columns."""
    from rich.table import Table
    from rich.text import Text

    table = Table(title=title, title_justify="left", show_header=False, box=None, pad_edge=False)
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")
    for name, value in rows:
        # Text, so that brackets in file names are not taken for markup.
        table.add_row(name, Text(value))
    emit_table(table)


@contextmanager
def progress(*, quiet: bool) -> Iterator[Callable[[str, float | None], None] | None]:
    """Show what is going on on stderr; gives None where that is no terminal.

    The callable takes the name of the step and the share of it that is done, None if not known.
    """
    if quiet or not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=None)
        current = ""

        def show(step: str, share: float | None) -> None:
            nonlocal current
            if step != current:
                bar.reset(task, description=step, total=1.0 if share is not None else None)
                current = step
            bar.update(task, completed=share or 0.0)

        yield show
