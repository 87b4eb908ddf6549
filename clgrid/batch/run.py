"""Go through the items of a job: leave out what is there, draw the rest, write down what became of each."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from datetime import datetime, timezone
from pathlib import Path
from types import FrameType
from typing import Protocol

import msgspec

import clgrid
from clgrid.batch import messages
from clgrid.batch.item import DONE, FAILED, SKIPPED, Item, ItemRecord, Written, about
from clgrid.batch.keeper import Keeper
from clgrid.batch.keys import Hashes, has_picture
from clgrid.batch.ledger import Ledger
from clgrid.batch.plan import WHOLE_JOB, Plan, Shard
from clgrid.batch.spawn import Spawned
from clgrid.imagefile import target_of


class Crew(Protocol):
    """Who draws: a child process here, or processes on many machines."""

    def draw(self, items: Iterable[Item]) -> Iterator[ItemRecord]:
        """Draw items; records come as items end."""
        ...

    def stop(self) -> None:
        """Finish what is begun, and no more."""
        ...

    def kill(self) -> None:
        """End at once."""
        ...

    def close(self) -> None:
        """There is nothing more to do."""
        ...


class Show(Protocol):
    """Who looks on."""

    def event(self, event: messages.Event) -> None:
        """Something happened within an item."""
        ...

    def item(self, record: ItemRecord) -> None:
        """An item has ended."""
        ...


@dataclass(frozen=True)
class Choices:
    """What a run is told beside the job.

    Attributes
    ----------
    shard : Shard
    skip_existing : bool
        Whether pictures that are there, of the same content key and whole, are left as they are.
    keep_going : bool
        Whether items are drawn after one that failed.
    device : str or None
        For items that name none.
    """

    shard: Shard = WHOLE_JOB
    skip_existing: bool = False
    keep_going: bool = True
    device: str | None = None


@dataclass
class Outcome:
    """What became of a run.

    Attributes
    ----------
    asked : int
        Items of the job, or of its shard.
    records : list of ItemRecord
        Of those that ended, in that order.
    seconds : float
    signal : int
        That ended the run early; 0 if none did.
    replaced : int
        Child processes that died or were ended.
    """

    asked: int
    ledger: Path
    records: list[ItemRecord] = field(default_factory=list)
    seconds: float = 0.0
    signal: int = 0

    def count(self, status: str) -> int:
        """Items that ended so."""
        return sum(record.status == status for record in self.records)

    @property
    def complete(self) -> bool:
        """Whether the pictures of all items are there."""
        return self.count(DONE) + self.count(SKIPPED) == self.asked


def ledger_path(plan: Plan, shard: Shard) -> Path:
    """Where records go: each shard has a file of its own, since machines cannot share one safely."""
    if shard.count == 1:
        return plan.records
    part = f"{shard.index + 1}-of-{shard.count}"
    return plan.records.with_name(f"{plan.records.stem}.{part}{plan.records.suffix}")


def run(
    plan: Plan,
    choices: Choices,
    show: Show,
    crew: Callable[[Ledger], Crew] | None = None,
    spawned: Spawned | None = None,
) -> Outcome:
    """Draw what a plan asks for.

    Parameters
    ----------
    plan : Plan
    choices : Choices
    show : Show
        Told what happens.
    crew : callable, optional
        Makes those who draw; by default one child process of this one.
    spawned : Spawned, optional
        That process, where it has been started already; who started it ends it where nothing was to be drawn.

    Raises
    ------
    DeviceError
        If the device cannot be used at all.
    ClgridError
        If records cannot be written.
    """
    items = choices.shard.of(plan.items)
    begun = time.monotonic()
    ledger = Ledger(ledger_path(plan, choices.shard))
    outcome = Outcome(len(items), ledger.path)
    try:
        remove_partials(items)
        hands = crew(ledger) if crew else _keeper(choices, show, ledger, spawned)
        _draw_all(items, choices, show, ledger, hands, outcome)
    finally:
        ledger.close()
        outcome.seconds = time.monotonic() - begun
    return outcome


def _keeper(choices: Choices, show: Show, ledger: Ledger, spawned: Spawned | None) -> Keeper:
    keeper = Keeper(choices.device, watch=show.event, spawned=spawned)
    keeper.hold(ledger.descriptor)
    return keeper


def _draw_all(
    items: list[Item], choices: Choices, show: Show, ledger: Ledger, hands: Crew, outcome: Outcome
) -> None:
    name = f"{datetime.now(timezone.utc):%Y-%m-%dT%H:%M:%SZ} {os.getpid()}"

    def note(record: ItemRecord) -> None:
        named = msgspec.structs.replace(record, run=name)
        outcome.records.append(named)
        ledger.append(named)
        show.item(named)

    def to_draw() -> Iterator[Item]:
        hashes = Hashes()
        for item in items:
            keyed = hashes.with_key(item)
            if choices.skip_existing and all(has_picture(Path(each), keyed.key) for each in keyed.outputs):
                there = tuple(Written(each, Path(each).stat().st_size) for each in keyed.outputs)
                note(msgspec.structs.replace(about(keyed, clgrid.__version__, SKIPPED), outputs=there))
            else:
                yield keyed

    done = False
    try:
        with _signals(hands, items, outcome):
            for record in hands.draw(to_draw()):
                note(record)
                if record.status == FAILED and not choices.keep_going:
                    hands.stop()
        done = True
    finally:
        if done:
            hands.close()
        else:
            hands.kill()
        # Of children that died on the way, too.
        remove_partials(items)


@contextmanager
def _signals(hands: Crew, items: list[Item], outcome: Outcome) -> Iterator[None]:
    """The first SIGINT or SIGTERM finishes what is begun, the second ends at once."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def on_signal(number: int, _: FrameType | None) -> None:
        if outcome.signal:
            hands.kill()
            remove_partials(items)
            os._exit(128 + number)
        outcome.signal = number
        hands.stop()

    numbers = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(number, on_signal) for number in numbers]
    try:
        yield
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)


def remove_partials(items: Iterable[Item]) -> list[Path]:
    """Remove what killed runs left half written of these items' pictures, and nothing else."""
    targets = {Path(name) for item in items for name in item.outputs}
    # Partial files have their suffix in small letters.
    known = {target.with_suffix(target.suffix.lower()) for target in targets}
    removed = []
    for folder in {target.parent for target in targets}:
        with suppress(FileNotFoundError):
            for path in folder.iterdir():
                if target_of(path) in known:
                    path.unlink(missing_ok=True)
                    removed.append(path)
    return removed
