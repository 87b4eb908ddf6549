"""A device's process with a fault of its own: what a driver may do, done on purpose."""

from __future__ import annotations

import os
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path

from clgrid.compare.process import Command, default_command
from clgrid.probe import child_command

# Beyond what the process has.
_ROOM = 1 << 28


def _abort() -> None:
    sys.stderr.write("LLVM ERROR: Cannot select: planted\n")
    sys.stderr.flush()
    os.abort()


def _hang() -> None:
    time.sleep(600)


def _take_memory() -> None:
    import numpy as np

    with open("/proc/self/statm", encoding="ascii") as statm:
        held = int(statm.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    resource.setrlimit(resource.RLIMIT_AS, (held + _ROOM, held + _ROOM))
    np.ones(2 * _ROOM, np.uint8)


FAULTS: dict[str, Callable[[], None]] = {"abort": _abort, "hang": _hang, "memory": _take_memory}


def faulty(selector: str, fault: str) -> Command:
    """Processes as ever, but for one device: its own has the fault where it first builds."""

    def command(label: str, order: Path) -> list[str]:
        if label != selector:
            return default_command(label, order)
        return child_command("compare_faults", fault, str(order))

    return command


def altered(selector: str, kernels: Path) -> Command:
    """Processes as ever, but for one device: its kernels come from a folder of their own."""

    def command(label: str, order: Path) -> list[str]:
        words = default_command(label, order)
        return ["env", f"CLGRID_KERNELS={kernels}", *words] if label == selector else words

    return command


def main(fault: str, order: str) -> None:
    """Run in the child."""
    from clgrid.compare import child

    def measure(*arguments: object) -> None:
        FAULTS[fault]()

    child.measure = measure  # type: ignore[assignment]
    child.main(order)
