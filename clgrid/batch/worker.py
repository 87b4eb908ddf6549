"""The child process that draws items: reads ahead and writes behind while the device works.

Orders come by stdin, events go by what was stdout. When stdin ends the parent is gone, or done with us: the
process ends at once, for a picture that is being written has no name yet.
"""

from __future__ import annotations

import importlib
import os
import queue
import signal
import socket
import sys
import threading
import time
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import BinaryIO

import msgspec

import clgrid
from clgrid.batch import messages
from clgrid.batch.item import DONE, FAILED, Item, ItemRecord, Written, about
from clgrid.batch.loader import Loaded, Loader
from clgrid.batch.painter import Painted, Painter, compiled
from clgrid.batch.plan import saving_of
from clgrid.errors import ClgridError, GridTooLargeError, InputError, MeshError, UnsupportedError
from clgrid.record import describe_device, process_peak_bytes

# Compressing a small picture takes longer than drawing it.
_WRITERS = 2
# Their reason is in the item itself: trying again would not help.
_FINAL = (MeshError, InputError, GridTooLargeError, UnsupportedError)


class _StoppedError(Exception):
    """The picture is to be given up."""


class Worker:
    """Draws what it is asked to, in order.

    Parameters
    ----------
    events : BinaryIO
        Where to say what happens.
    descriptors : socket.socket, optional
        Whence files come that are to be held open.
    """

    def __init__(self, events: BinaryIO, descriptors: socket.socket | None = None) -> None:
        self._events, self._socket = events, descriptors
        self._held: list[int] = []
        self._speaking = threading.Lock()
        self._stopping = threading.Event()
        self._orders: queue.SimpleQueue[tuple[Item, Future[Loaded]] | None] = queue.SimpleQueue()
        # One thread, so that scenes are read in order.
        self._reader = ThreadPoolExecutor(1, "read")
        self._writer = ThreadPoolExecutor(_WRITERS, "write")
        # One more than are written at once; others would only take memory.
        self._unwritten = threading.BoundedSemaphore(_WRITERS + 1)
        self._loader = Loader()

    def work(self, orders: BinaryIO) -> None:
        """Say hello, then draw until told to stop."""
        hello = messages.order_of(orders.readline())
        device = hello.device if isinstance(hello, messages.Hello) else None
        try:
            from clgrid.device import choose

            choose(device).require_usable()
        except ClgridError as error:
            self._say(messages.Refused(str(error)))
            return
        self._say(messages.Ready())
        threading.Thread(target=self._listen, args=(orders,), daemon=True).start()
        # While kernels are loaded; what is wrong with it is told where the first picture is written.
        self._writer.submit(importlib.import_module, "OpenImageIO")
        painter = Painter(device)
        while (order := self._orders.get()) is not None:
            if not self._stopping.is_set():
                self._draw(painter, *order)
        self._writer.shutdown(wait=True)

    def _listen(self, orders: BinaryIO) -> None:
        while line := orders.readline():
            order = messages.order_of(line)
            if isinstance(order, messages.Hold):
                self._held += socket.recv_fds(self._socket, 1, 1)[1] if self._socket is not None else []
            elif isinstance(order, messages.Draw):
                self._orders.put((order.item, self._reader.submit(self._loader.load, order.item)))
            else:
                self._stopping.set()
                self._orders.put(None)
        os._exit(0)

    def _say(self, event: messages.Event) -> None:
        with self._speaking:
            self._events.write(messages.encode(event) + b"\n")
            self._events.flush()

    def _draw(self, painter: Painter, item: Item, loading: Future[Loaded]) -> None:
        self._say(messages.Turn(item.number, "load"))
        start = time.perf_counter()
        try:
            loaded = loading.result()
            wait_s = time.perf_counter() - start
            painted = painter.paint(
                item,
                loaded,
                lambda stage: self._say(messages.Turn(item.number, stage)),
                lambda share: self._watch(item, share),
            )
        except _StoppedError:
            return
        except Exception as error:  # whatever an item provokes is this item's failure
            painter.release()
            self._say(failure(item, error))
            return
        self._unwritten.acquire()
        self._writer.submit(self._write, item, loaded, painted, wait_s)

    def _watch(self, item: Item, share: float) -> None:
        if self._stopping.is_set():
            raise _StoppedError
        self._say(messages.Share(item.number, share))

    def _write(self, item: Item, loaded: Loaded, painted: Painted, wait_s: float) -> None:
        try:
            start = time.perf_counter()
            written = write(item, painted)
            write_s = time.perf_counter() - start
            self._say(messages.Finished(_record(item, loaded, painted, written, wait_s, write_s)))
        except Exception as error:  # whatever an item provokes is this item's failure
            self._say(failure(item, error))
        finally:
            self._unwritten.release()


def write(item: Item, painted: Painted) -> tuple[Written, ...]:
    """Write an item's pictures, each under its name only when complete."""
    saving = saving_of(item.settings)
    written = []
    for name in item.outputs:
        path = Path(name)
        path.parent.mkdir(parents=True, exist_ok=True)
        painted.image.save(
            path,
            compression=saving.compression,
            half=saving.half,
            tile=saving.tile,
            quality=saving.quality,
            timings=False,
        )
        written.append(Written(name, path.stat().st_size))
    return tuple(written)


def failure(item: Item, error: Exception) -> messages.Finished:
    """What became of an item that failed."""
    known = isinstance(error, ClgridError)
    reason = str(error) if known else f"{type(error).__name__}: {error}"
    record = about(item, clgrid.__version__, FAILED)
    one_line = " ".join(reason.split())
    return messages.Finished(msgspec.structs.replace(record, error=one_line), not isinstance(error, _FINAL))


def _record(
    item: Item, loaded: Loaded, painted: Painted, written: tuple[Written, ...], wait_s: float, write_s: float
) -> ItemRecord:
    return msgspec.structs.replace(
        about(item, clgrid.__version__, DONE),
        device=describe_device(painted.device),
        compiled=compiled(painted.device),
        outputs=written,
        grid=painted.grid,
        triangles=painted.triangles,
        hits=painted.image.hits,
        load_s=[loaded.load_s],
        wait_s=[wait_s],
        compile_s=[painted.compile_s],
        build_s=[painted.build_s],
        render_s=[painted.render_s],
        write_s=[write_s],
        peak_bytes=process_peak_bytes() or 0,
        warnings=painted.warnings,
    )


def main() -> None:
    """Work as a child process: the parent alone decides when to stop."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    # Drivers write to stdout; what they say goes where errors go.
    events = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    descriptors = socket.socket(fileno=int(sys.argv[1])) if len(sys.argv) > 1 else None
    Worker(events, descriptors).work(sys.stdin.buffer)
    events.flush()
    # Drivers may hang in their own tear-down.
    os._exit(0)


if __name__ == "__main__":
    main()
