"""The process that draws, started before anything is known that it will be asked.

It imports the drivers' libraries meanwhile; so this module imports nothing heavy.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

MODULE = "clgrid.batch.worker"


@dataclass(frozen=True)
class Spawned:
    """A process that waits for its first order.

    Attributes
    ----------
    process : subprocess.Popen
        Orders go to its stdin, events come from its stdout.
    descriptors : socket.socket
        For files that it is to hold open.
    """

    process: subprocess.Popen[bytes]
    descriptors: socket.socket

    def kill(self) -> None:
        """End it at once."""
        self.process.kill()
        self.process.wait()
        self.descriptors.close()


def spawn(cores: Sequence[int] | None = None) -> Spawned:
    """Start a process that draws, on so many cores if they are given."""
    command = [sys.executable, "-m", MODULE]
    if cores:
        # Before a driver counts them.
        start = f"import os, runpy; os.sched_setaffinity(0, {list(cores)!r}); "
        command[1:] = ["-c", start + f"runpy.run_module({MODULE!r}, run_name='__main__')"]
    ours, theirs = socket.socketpair()
    with theirs:
        # Elsewhere a process cannot be sent files, nor are records locked.
        passed = (theirs.fileno(),) if os.name == "posix" else ()
        process = subprocess.Popen(
            [*command, *map(str, passed)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            pass_fds=passed,
            # The terminal's ^C is for the parent.
            start_new_session=True,
        )
    return Spawned(process, ours)


@contextmanager
def spawned_early(*, wanted: bool) -> Iterator[Spawned | None]:
    """A process that starts while the job is read and planned, and is gone at the end; None if not wanted."""
    spawned = spawn() if wanted else None
    try:
        yield spawned
    finally:
        if spawned is not None:
            spawned.kill()
