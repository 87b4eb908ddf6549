"""The child process as its parent sees it: orders in, events out, and what it said when it died."""

from __future__ import annotations

import contextlib
import os
import queue
import signal
import socket
import subprocess
import threading
from collections import deque
from collections.abc import Sequence

import msgspec

from clgrid.batch import messages
from clgrid.batch.spawn import Spawned, spawn
from clgrid.probe import telling_line

# Lines of a dead child's stderr that are kept: a crash report lists the stack after the reason.
_LAST_LINES = 200


class Child:
    """A process that draws.

    Parameters
    ----------
    device : str or None
        For items that name none.
    cores : sequence of int, optional
        Cores that it may use.
    spawned : Spawned, optional
        The process, where it has been started already.
    """

    def __init__(
        self, device: str | None, cores: Sequence[int] | None = None, spawned: Spawned | None = None
    ) -> None:
        self._events: queue.SimpleQueue[messages.Event] = queue.SimpleQueue()
        self._last_lines: deque[str] = deque(maxlen=_LAST_LINES)
        self._spawned = spawned or spawn(cores)
        self._process = self._spawned.process
        self._complaints = threading.Thread(target=self._keep_last_lines, daemon=True)
        self._complaints.start()
        threading.Thread(target=self._listen, daemon=True).start()
        self.tell(messages.Hello(device))

    def tell(self, order: messages.Order) -> None:
        """Give an order; to a dead child it is lost, and its end is the next event."""
        stdin = self._process.stdin
        with contextlib.suppress(BrokenPipeError, ValueError):
            if stdin is not None:
                stdin.write(messages.encode(order) + b"\n")
                stdin.flush()

    def hold(self, descriptor: int) -> None:
        """Have it hold a file open as long as it lives: the lock on the records."""
        if os.name == "posix":
            with contextlib.suppress(BrokenPipeError):
                socket.send_fds(self._spawned.descriptors, [b"."], [descriptor])
            self.tell(messages.Hold())

    def event(self, timeout: float) -> messages.Event | None:
        """The next event; None if there is none in time."""
        try:
            return self._events.get(timeout=max(0.0, timeout))
        except queue.Empty:
            return None

    def kill(self) -> None:
        """End it at once."""
        self._spawned.kill()

    def close(self) -> None:
        """End it once it has nothing to do."""
        stdin = self._process.stdin
        with contextlib.suppress(BrokenPipeError):
            if stdin is not None:
                stdin.close()
        try:
            self._process.wait(10)
            self._spawned.descriptors.close()
        except subprocess.TimeoutExpired:
            self.kill()

    def last_words(self) -> str:
        """The last line that a dead child wrote and that says something, or nothing."""
        self._complaints.join(1.0)
        return telling_line(self._last_lines)

    def _listen(self) -> None:
        stdout = self._process.stdout
        assert stdout is not None
        # A line that was cut short by death is no event.
        with contextlib.suppress(msgspec.DecodeError):
            for line in stdout:
                self._events.put(messages.event_of(line))
        self._events.put(messages.Ended(self._process.wait()))

    def _keep_last_lines(self) -> None:
        stderr = self._process.stderr
        assert stderr is not None
        while line := stderr.readline(1 << 16):
            self._last_lines.append(line.decode(errors="replace").strip())


def how_it_ended(code: int) -> str:
    """An exit code in words."""
    if code >= 0:
        return f"ended with exit code {code}"
    try:
        return f"was ended by {signal.Signals(-code).name}"
    except ValueError:
        return f"was ended by signal {-code}"
