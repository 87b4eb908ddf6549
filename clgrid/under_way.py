"""Kernels that still read a grid's memory after the call that started them has returned."""

from __future__ import annotations

import threading
from typing import Any

from clgrid.device import Device


class UnderWay:
    """The events of such kernels, which whoever frees or rewrites the memory waits for.

    OpenCL keeps buffers until kernels are done, but not the numpy arrays that ours lie over. What they read
    is kept here, since a grid may be replaced meanwhile.
    """

    def __init__(self, device: Device) -> None:
        self._device = device
        self._events: list[tuple[Any, object]] = []
        self._lock = threading.Lock()

    def add(self, event: Any, reads: object) -> None:
        """Note a kernel, and what it reads; those that are done are forgotten."""
        import pyopencl as cl

        done = cl.command_execution_status.COMPLETE
        with self._lock:
            self._events = [each for each in self._events if each[0].command_execution_status > done]
            self._events.append((event, reads))

    def wait(self) -> None:
        """Until all are done. A forked process waits for none: they are not its own."""
        if not self._events or self._device.is_forked:
            return
        import pyopencl as cl

        with self._lock:
            events, self._events = self._events, []
        for event, _ in events:
            try:
                event.wait()
            except cl.Error:
                # A failed kernel reads no more; who waits for its results is told.
                continue
