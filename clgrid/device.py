"""OpenCL devices: find, choose, describe; one context and queue each."""

from __future__ import annotations

import functools
from typing import Any

import pyopencl as cl

from clgrid.errors import DeviceError


class Device:
    """An OpenCL device with its context and queue."""

    def __init__(self, cl_device: Any) -> None:
        self.cl_device = cl_device
        self.context = cl.Context([cl_device])
        self.queue = cl.CommandQueue(self.context)

    @property
    def name(self) -> str:
        return str(self.cl_device.name)

    @property
    def driver_version(self) -> str:
        return str(self.cl_device.driver_version)


@functools.cache
def choose(selector: str | None = None) -> Device:
    for platform in cl.get_platforms():
        for dev in platform.get_devices():
            if selector is None or selector.lower() in platform.name.lower():
                return Device(dev)
    raise DeviceError("no device")
