"""The process of a device as its parent sees it: however it ends, that is a result."""

from __future__ import annotations

import contextlib
import queue
import subprocess
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import msgspec

from clgrid.batch.child import how_it_ended
from clgrid.compare import messages
from clgrid.compare.messages import Event, Order
from clgrid.compare.plan import Part
from clgrid.compare_record import (
    COMPLETED,
    CRASHED,
    HUNG,
    OUT_OF_MEMORY,
    REFUSED,
    CompareDevice,
    CompareRow,
    RungFailure,
)
from clgrid.driver_record import ArithmeticRecord, DriverRecord, SpeedRecord
from clgrid.probe import child_command, telling_line
from clgrid.record import DeviceRecord

Command = Callable[[str, Path], list[str]]
"""Of a selector and the file of an order: the words of a command line."""

Rows = dict[tuple[int, str], CompareRow]
"""By the number of the scene and the rung."""

# What processes say that had no memory left and aborted.
_NO_MEMORY = ("bad_alloc", "out of memory", "Cannot allocate memory", "MemoryError")
# What the system sends, where the parent did not.
_KILLED = -9
_LAST_BYTES = 1 << 16


def default_command(selector: str, order: Path) -> list[str]:
    """Of the process that does what the order says."""
    return child_command("clgrid.compare.child", str(order))


@dataclass
class Seen:
    """What a process has said so far."""

    found: messages.Found | None = None
    step: str = "start"
    arithmetic: list[ArithmeticRecord] = field(default_factory=list)
    speed: SpeedRecord | None = None
    rows: Rows = field(default_factory=dict)
    failures: list[RungFailure] = field(default_factory=list)
    last: messages.Refused | messages.NoMemory | messages.Finished | None = None

    def hear(self, event: Event) -> None:
        """Take note."""
        match event:
            case messages.Step():
                self.step = event.step
            case messages.Found():
                self.found = event
            case messages.Arithmetic():
                self.arithmetic = event.arithmetic
            case messages.Speed():
                self.speed = event.speed
            case messages.Done():
                self.rows[event.scene, event.row.accuracy] = event.row
            case messages.Failed():
                self.failures.append(event.failure)
            case messages.Refused() | messages.NoMemory() | messages.Finished():
                self.last = event


def run(
    part: Part,
    order: Order,
    time_limit: float,
    progress: Callable[[str], None],
    command: Command = default_command,
) -> tuple[CompareDevice, Rows]:
    """Run a device's process to its end, or to its time limit.

    Returns
    -------
    device : CompareDevice
    rows : Rows
        Those whose arrays are in the folder.
    """
    folder = Path(order.folder)
    file, said = folder / f"order-{order.number}.json", folder / f"stderr-{order.number}"
    file.write_bytes(messages.encode(order))
    start, seen = time.monotonic(), Seen()
    with said.open("wb") as stderr:
        process = subprocess.Popen(
            command(part.label, file),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=stderr,
            # The terminal's ^C is for the parent.
            start_new_session=True,
        )
        try:
            code = _listen(process, start + time_limit, seen, progress)
        finally:
            process.kill()
            process.wait()
    seconds = time.monotonic() - start
    status, reason = _ending(code, seen, _last_line(said), time_limit)
    return _record(part, seen, status, reason, _last_line(said), seconds), seen.rows


def _listen(
    process: subprocess.Popen[bytes], end: float, seen: Seen, progress: Callable[[str], None]
) -> int | None:
    """The exit code; None if time is up."""
    events: queue.SimpleQueue[Event] = queue.SimpleQueue()
    threading.Thread(target=_read, args=(process, events), daemon=True).start()
    while True:
        try:
            event = events.get(timeout=max(0.0, end - time.monotonic()))
        except queue.Empty:
            return None
        if isinstance(event, messages.Ended):
            return event.code
        seen.hear(event)
        if isinstance(event, messages.Step):
            progress(event.step)


def _read(process: subprocess.Popen[bytes], events: queue.SimpleQueue[Event]) -> None:
    stdout = process.stdout
    assert stdout is not None
    # A line that was cut short by death is no event.
    with contextlib.suppress(msgspec.DecodeError):
        for line in stdout:
            events.put(messages.event_of(line))
    events.put(messages.Ended(process.wait()))


def _ending(code: int | None, seen: Seen, last_words: str, time_limit: float) -> tuple[str, str]:
    """The status, and how the process ended in words."""
    if isinstance(seen.last, messages.Finished):
        if seen.failures and not seen.rows:
            return REFUSED, seen.failures[0].error
        return COMPLETED, ""
    if isinstance(seen.last, messages.Refused):
        return REFUSED, seen.last.error
    if isinstance(seen.last, messages.NoMemory):
        return OUT_OF_MEMORY, seen.last.error
    if code is None:
        return HUNG, f"took longer than the limit of {time_limit:g} s"
    if code == _KILLED:
        return OUT_OF_MEMORY, "was ended by SIGKILL, which the system sends where memory is short"
    status = OUT_OF_MEMORY if any(words in last_words for words in _NO_MEMORY) else CRASHED
    return status, how_it_ended(code)


def _last_line(file: Path) -> str:
    """The last line of a file that says something, or nothing."""
    return telling_line(file.read_bytes()[-_LAST_BYTES:].decode(errors="replace").split("\n"))


def _record(
    part: Part, seen: Seen, status: str, reason: str, last_words: str, seconds: float
) -> CompareDevice:
    whole, found = part.whole, seen.found
    completed, finished = status == COMPLETED, seen.last
    peak = finished.process_peak_bytes if isinstance(finished, messages.Finished) else None
    return CompareDevice(
        label=part.label,
        device=DeviceRecord(whole.name, whole.driver_version, whole.platform),
        units=found.units if found else part.units or whole.compute_units,
        limited_by=found.limited_by if found else "",
        status=status,
        reason=reason,
        last_words="" if completed else last_words,
        step="" if completed else seen.step,
        seconds=[seconds],
        driver=_driver(found, whole.compute_units),
        arithmetic=seen.arithmetic,
        speed=seen.speed,
        compiled=finished.compiled if isinstance(finished, messages.Finished) else (),
        process_peak_bytes=peak,
        rows=list(seen.rows.values()),
        failures=seen.failures,
    )


def _driver(found: messages.Found | None, compute_units: int) -> DriverRecord | None:
    """What the driver says, with the compute units of the whole device."""
    return msgspec.structs.replace(found.driver, compute_units=compute_units) if found else None
