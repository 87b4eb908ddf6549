"""Get items drawn by a child process, whatever it does: it may crash, hang, or be killed.

Several items are under way at once: one is drawn, the one before it is written, those behind it are read.
When the child dies, those under way are drawn again one at a time: an item is blamed only for what it did
alone.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import msgspec

import clgrid
from clgrid.batch import messages
from clgrid.batch.child import Child, how_it_ended
from clgrid.batch.item import FAILED, Item, ItemRecord, about
from clgrid.batch.spawn import Spawned
from clgrid.errors import DeviceError

DEFAULT_RETRIES = 1
# Items that wait in the child: one is being read, one is ready.
_AHEAD = 2
_START_SECONDS = 300.0
# Times that a child may die before it can draw.
_STARTS = 3
# A compiler that has not ended by then hangs.
_COMPILE_SECONDS = 600.0
_POLL_SECONDS = 0.5


@dataclass
class Try:
    """An item under way.

    Attributes
    ----------
    attempts : int
        Times that it was tried, this one included.
    alone : bool
        Whether nothing else may be under way with it.
    left : float
        Seconds of its limit that are left.
    since : float or None
        When its clock started; None while it waits or compiles.
    compiling : float or None
        When its kernels began to be compiled.
    """

    item: Item
    attempts: int = 1
    alone: bool = False
    left: float = float("inf")
    since: float | None = None
    compiling: float | None = None
    waiting: bool = True

    def enter(self, stage: str, now: float) -> None:
        """Its turn has come, or the next stage of it."""
        self.waiting = False
        if self.since is not None:
            self.left -= now - self.since
        self.since, self.compiling = (None, now) if stage == "compile" else (now, None)

    def late(self, now: float) -> bool:
        """Whether it has taken too long."""
        if self.compiling is not None:
            return now - self.compiling > max(self.limit, _COMPILE_SECONDS)
        return self.since is not None and now - self.since > self.left

    @property
    def limit(self) -> float:
        """Seconds that it may take."""
        limit = self.item.settings.time_limit
        return float("inf") if limit is None else limit

    @property
    def may_retry(self) -> bool:
        """Whether it may be tried once more."""
        retries = self.item.settings.retries
        return self.attempts <= (DEFAULT_RETRIES if retries is None else retries)


class Keeper:
    """Keeps one child process, and replaces it when it is gone.

    Parameters
    ----------
    device : str or None
        For items that name none.
    cores, spawned
        As of ``Child``, the latter for the first child.
    watch : callable
        Told each event as it comes.
    """

    def __init__(
        self,
        device: str | None = None,
        cores: Sequence[int] | None = None,
        watch: Callable[[messages.Event], None] = lambda event: None,
        spawned: Spawned | None = None,
    ) -> None:
        self._device, self._cores, self._watch, self._spawned = device, cores, watch, spawned
        self._held: int | None = None
        self._child: Child | None = None
        self._waiting: deque[Try] = deque()
        self._flight: dict[int, Try] = {}
        self.stopping = False
        self.replaced = 0

    def hold(self, descriptor: int) -> None:
        """Have every child hold a file open as long as it lives: the lock on the records."""
        self._held = descriptor

    def draw(self, items: Iterable[Item]) -> Iterator[ItemRecord]:
        """Draw items; what became of each comes as soon as it is known.

        Items are taken one by one, shortly before their turn. After ``stop`` no more are begun.

        Raises
        ------
        DeviceError
            If the device cannot be used at all.
        """
        source = iter(items)
        exhausted = False
        while True:
            while not exhausted and self.has_room:
                following = next(source, None)
                exhausted = following is None
                if following is not None:
                    self.begin(following)
            yield from self.go_on()
            if self.idle and (exhausted or self.stopping):
                return

    @property
    def has_room(self) -> bool:
        """Whether an item may be begun."""
        return not self.stopping and not self._waiting and self._room()

    @property
    def idle(self) -> bool:
        """Whether nothing is under way, nor will be."""
        return not self._flight and (self.stopping or not self._waiting)

    def begin(self, item: Item) -> None:
        """Take an item on, where there is room."""
        self._waiting.append(_tried(item))
        self._send()

    def go_on(self, seconds: float = _POLL_SECONDS) -> Iterator[ItemRecord]:
        """Wait for the next event, no longer than this; what has ended by it.

        Raises
        ------
        DeviceError
            If the device cannot be used at all.
        """
        self._send()
        if self._flight:
            yield from self._next_event(seconds)

    def stop(self) -> None:
        """Finish what is begun: the picture that is drawn or written, or the band of a large one."""
        self.stopping = True
        if self._child is not None:
            self._child.tell(messages.Stop())

    def kill(self) -> None:
        """End the child at once."""
        if self._child is not None:
            self._child.kill()
            self._child = None

    def close(self) -> None:
        """End the child, which has nothing to do."""
        if self._child is not None:
            self._child.close()
            self._child = None

    def _room(self) -> bool:
        if any(each.alone for each in self._flight.values()):
            return False
        return sum(each.waiting for each in self._flight.values()) < _AHEAD

    def _send(self) -> None:
        """Hand out what waits, as far as there is room."""
        while self._waiting and self._room() and not self.stopping:
            if self._waiting[0].alone and self._flight:
                return
            attempt = self._waiting.popleft()
            if self._child is None:
                self._child = self._started()
            self._flight[attempt.item.number] = attempt
            self._child.tell(messages.Draw(attempt.item))

    def _started(self) -> Child:
        """A child whose device works; one that dies at its start is replaced a few times."""
        for left in reversed(range(_STARTS)):
            child, self._spawned = Child(self._device, self._cores, self._spawned), None
            event = child.event(_START_SECONDS)
            if isinstance(event, messages.Ready):
                if self._held is not None:
                    child.hold(self._held)
                return child
            child.kill()
            if isinstance(event, messages.Refused):
                raise DeviceError(event.error)
            self.replaced += 1
            if not left or self.stopping:
                how = how_it_ended(event.code) if isinstance(event, messages.Ended) else "does not answer"
                said = child.last_words()
                break
        reason = f"{how}{f': {said}' if said else ''}"
        raise DeviceError(f"the process that draws {reason}, before it began; clgrid doctor says more")

    def _next_event(self, seconds: float) -> Iterator[ItemRecord]:
        child = self._child
        if child is None:
            return
        event = child.event(seconds)
        now = time.monotonic()
        if event is not None:
            self._watch(event)
        if isinstance(event, messages.Turn) and event.item in self._flight:
            self._flight[event.item].enter(event.stage, now)
        elif isinstance(event, messages.Finished):
            yield from self._finished(event)
        elif isinstance(event, messages.Ended):
            yield from self._ended(f"the process that drew it {how_it_ended(event.code)}", child.last_words())
        late = [each for each in self._flight.values() if each.late(now)]
        if late:
            yield from self._overdue(late[0])

    def _finished(self, event: messages.Finished) -> Iterator[ItemRecord]:
        attempt = self._flight.pop(event.record.item, None)
        if attempt is None:
            return
        if event.record.status == FAILED and event.again and attempt.may_retry and not self.stopping:
            self._again(attempt)
            return
        yield msgspec.structs.replace(event.record, attempts=attempt.attempts)

    def _again(self, attempt: Try, *, blamed: bool = True) -> None:
        attempts = attempt.attempts + 1 if blamed else attempt.attempts
        self._waiting.appendleft(_tried(attempt.item, attempts, alone=True))

    def _overdue(self, late: Try) -> Iterator[ItemRecord]:
        """The clock tells which item hangs; the others under way have done nothing."""
        self.kill()
        self.replaced += 1
        others = [each for each in self._flight.values() if each is not late]
        self._flight.clear()
        what = "compiling its kernels" if late.compiling is not None else f"the limit of {late.limit:g} s"
        yield from self._blame(late, f"took longer than {what}", "")
        for each in reversed(others):
            self._again(each, blamed=False)

    def _ended(self, how: str, said: str) -> Iterator[ItemRecord]:
        self._child = None
        under_way = list(self._flight.values())
        self._flight.clear()
        if self.stopping:
            return
        self.replaced += 1
        if len(under_way) == 1:
            yield from self._blame(under_way[0], how, said)
            return
        for each in reversed(under_way):
            self._again(each, blamed=False)

    def _blame(self, attempt: Try, how: str, said: str) -> Iterator[ItemRecord]:
        if attempt.may_retry and not self.stopping:
            self._again(attempt)
            return
        record = about(attempt.item, clgrid.__version__, FAILED)
        error = f"{how}{f': {said}' if said else ''}; tried {attempt.attempts}x"
        yield msgspec.structs.replace(record, error=error, attempts=attempt.attempts)


def _tried(item: Item, attempts: int = 1, *, alone: bool = False) -> Try:
    limit = item.settings.time_limit
    return Try(item, attempts, alone, float("inf") if limit is None else limit)
