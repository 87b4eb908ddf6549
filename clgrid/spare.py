"""Buffers that wait for the next build on their device: memory is dear the first time it is touched.

A page that the system hands out anew takes some microseconds: up to a fifth of a small build in all.
"""

from __future__ import annotations

import threading
from typing import Any

from clgrid.device import Device

MOST_BYTES = 1 << 26
"""That wait on a device; the oldest go first."""

_lock = threading.RLock()
_waiting: dict[Device, list[tuple[int, Any]]] = {}
# Bytes of them all.
_held: dict[Device, int] = {}


def take(device: Device, nbytes: int) -> Any:
    """A waiting buffer of so many bytes, which no longer waits; or None.

    None that is larger: a grid takes the bytes that are said of it.
    """
    with _lock:
        waiting = _waiting.get(device, [])
        for number, (size, buffer) in enumerate(waiting):
            if size == nbytes:
                # At once: a grid that is collected meanwhile gives buffers, and numbers change.
                waiting.pop(number)
                _held[device] -= nbytes
                return buffer
        return None


def give(device: Device, *buffers: Any) -> None:
    """Let buffers wait that no kernel to come reads; nobody may use them any more.

    Those of a forked process do not: they are not its own.
    """
    if device.is_forked:
        return
    with _lock:
        waiting = _waiting.setdefault(device, [])
        given = [(size, each) for each in buffers if (size := each.size) <= MOST_BYTES]
        waiting += given
        _held[device] = _held.get(device, 0) + sum(size for size, _ in given)
        while _held[device] > MOST_BYTES:
            _held[device] -= waiting.pop(0)[0]


def forget(device: Device) -> None:
    """Give all that wait back to the device."""
    with _lock:
        _waiting.pop(device, None)
        _held.pop(device, None)
