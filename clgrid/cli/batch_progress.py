"""What a batch shows while it runs: bars on a terminal, a line an item in a log."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from clgrid import units
from clgrid.cli import output

if TYPE_CHECKING:
    from clgrid.batch.item import ItemRecord
    from clgrid.batch.messages import Event


class Quiet:
    """Shows nothing."""

    def event(self, event: Event) -> None:
        """Nothing."""

    def item(self, record: ItemRecord) -> None:
        """Nothing."""


class Lines:
    """A line on stderr for each item.

    Parameters
    ----------
    asked : int
        Items of the run.
    """

    def __init__(self, asked: int) -> None:
        self._asked = asked
        self._ended = 0
        self._warned: set[str] = set()

    def event(self, event: Event) -> None:
        """Nothing: logs are for what has ended."""

    def item(self, record: ItemRecord) -> None:
        """Say what became of it, and what was left out of its files."""
        output.warn(unsaid(record, self._warned), quiet=False)
        self._ended += 1
        print(f"clgrid: [{self._ended}/{self._asked}] {line_of(record)}", file=sys.stderr, flush=True)


def unsaid(record: ItemRecord, said: set[str]) -> list[str]:
    """Warnings of an item that no item had before: those of a scene are in all of its records."""
    fresh = [line for line in record.warnings if line not in said]
    said.update(fresh)
    return fresh


def line_of(record: ItemRecord) -> str:
    """What became of an item, in a line."""
    what = f"item {record.item} {record.scene} {record.camera}"
    what += "" if record.frame is None else f" frame {record.frame}"
    if record.error:
        return f"{what}: failed: {record.error}"
    taken = [
        f"{name} {units.seconds(sum(getattr(record, f'{name}_s')))}"
        for name in ("compile", "build", "render", "write")
        if sum(getattr(record, f"{name}_s")) > 0
    ]
    return f"{what}: {record.status}{': ' if taken else ''}{', '.join(taken)}"


class Bars:
    """Two bars: items with their rate and the time that is left, and the rows of a large picture.

    Parameters
    ----------
    asked : int
        Items of the run.
    bars : rich.progress.Progress
    """

    def __init__(self, asked: int, bars: Any) -> None:
        self._bars = bars
        self._asked = asked
        self._ended = 0
        self._begun = time.monotonic()
        self._failed = 0
        self._warned: set[str] = set()
        self._items = bars.add_task("items", total=asked, told=f"0/{asked}")
        self._rows = bars.add_task("", total=1.0, told="", visible=False)

    def event(self, event: Event) -> None:
        """Show the stage, and the rows of a large picture."""
        from clgrid.batch.messages import Share, Turn

        if isinstance(event, Turn):
            self._bars.update(
                self._rows, description=f"{event.stage} {event.item}", completed=0, told="", visible=True
            )
        elif isinstance(event, Share):
            self._bars.update(self._rows, completed=event.share, told=f"{event.share:.0%}")

    def item(self, record: ItemRecord) -> None:
        """Count it; say above the bars if it failed, and what was left out of its files."""
        for line in unsaid(record, self._warned):
            self._bars.console.print(f"warning: {line}", markup=False, highlight=False)
        if record.error:
            self._failed += 1
            self._bars.console.print(line_of(record), style="red", markup=False, highlight=False)
        self._ended += 1
        rate = self._ended / max(1e-9, time.monotonic() - self._begun)
        failed = f", {self._failed} failed" if self._failed else ""
        self._bars.update(self._items, advance=1, told=f"{self._ended}/{self._asked} {rate:.3g}/s{failed}")


@contextmanager
def shown(asked: int, *, quiet: bool) -> Iterator[Quiet | Lines | Bars]:
    """What suits stderr."""
    if quiet:
        yield Quiet()
        return
    if not sys.stderr.isatty():
        yield Lines(asked)
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("{task.fields[told]}"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bars:
        yield Bars(asked, bars)
