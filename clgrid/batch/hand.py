"""One child process for several askers: each waits for its own item while the next is read and drawn."""

from __future__ import annotations

import queue
import threading
from collections.abc import Sequence
from concurrent.futures import Future
from itertools import count

import msgspec

import clgrid
from clgrid.batch.item import FAILED, Item, ItemRecord, about
from clgrid.batch.keeper import Keeper
from clgrid.errors import DeviceError

UNDER_WAY = 2
"""Items that keep a child busy: one is drawn while the one before it is written and told of."""
_POLL_SECONDS = 0.02


class Hand:
    """Draws items for any number of threads, in the order in which they ask.

    Parameters
    ----------
    device, cores
        As of ``Keeper``.
    """

    def __init__(self, device: str | None, cores: Sequence[int] | None = None) -> None:
        self._device, self._cores = device, cores
        self._keeper = self._new_keeper()
        self._asked: queue.SimpleQueue[tuple[Item, Future[ItemRecord]] | None] = queue.SimpleQueue()
        self._under_way: dict[int, tuple[Item, Future[ItemRecord]]] = {}
        # Items have numbers of this hand here: those of two jobs may be the same.
        self._numbers = count()
        threading.Thread(target=self._serve, name="hand", daemon=True).start()

    def draw(self, item: Item) -> ItemRecord:
        """Draw an item, and wait for what becomes of it."""
        promised: Future[ItemRecord] = Future()
        self._asked.put((item, promised))
        return promised.result()

    def close(self) -> None:
        """End the child at once; what it was drawing has failed."""
        self._keeper.stop()
        self._keeper.kill()
        self._asked.put(None)

    def _new_keeper(self) -> Keeper:
        return Keeper(self._device, cores=self._cores)

    def _serve(self) -> None:
        while not self._keeper.stopping:
            try:
                self._take_on()
                for record in self._keeper.go_on(_POLL_SECONDS):
                    self._hand_over(record.item, record)
            except DeviceError as error:
                self._fail_all(str(error))
                self._keeper = self._new_keeper()
        self._fail_all("the worker was told to end")

    def _take_on(self) -> None:
        """Begin what is asked for, as far as there is room; wait for it where nothing is under way."""
        while self._keeper.has_room:
            try:
                asked = self._asked.get(block=not self._under_way)
            except queue.Empty:
                return
            if asked is not None:
                number = next(self._numbers)
                self._under_way[number] = asked
                self._keeper.begin(msgspec.structs.replace(asked[0], number=number))

    def _fail_all(self, reason: str) -> None:
        for number, (item, _) in list(self._under_way.items()):
            failed = about(item, clgrid.__version__, FAILED)
            self._hand_over(number, msgspec.structs.replace(failed, error=reason))

    def _hand_over(self, number: int, record: ItemRecord) -> None:
        item, promised = self._under_way.pop(number)
        promised.set_result(msgspec.structs.replace(record, item=item.number))
