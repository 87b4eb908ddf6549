"""OpenCL devices: find, describe, choose; one context and queue each."""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from clgrid import pocl, probe, registration
from clgrid.description import Description, describe, matching, preference
from clgrid.errors import DeviceError

log = logging.getLogger(__name__)

INSTALL = "pip install 'pyopencl[pocl]', or: pip install intel-opencl-rt intel-cmplr-lib-rt"

_lock = threading.RLock()
_found: tuple[tuple[Description, Any], ...] | None = None
_found_by: int = 0  # process id
_devices: dict[int, Device] = {}


class Device:
    """An OpenCL device with its context and queue, both made at first use.

    Attributes
    ----------
    cl_device : pyopencl.Device
        The device itself.
    description : Description
        Names, sizes and abilities.
    """

    def __init__(self, cl_device: Any, description: Description) -> None:
        self.cl_device = cl_device
        self.description = description
        self._made_by = os.getpid()
        self._lock = threading.RLock()
        self._context: Any = None
        self._queue: Any = None
        self._checked = False

    def __repr__(self) -> str:
        return f"<clgrid.Device {self.description.line()}>"

    @property
    def name(self) -> str:
        """The device's name as its driver reports it."""
        return self.description.name

    @property
    def label(self) -> str:
        """Short name and valid selector, such as ``intel`` or ``pocl-3.0``."""
        return self.description.label

    @property
    def platform(self) -> str:
        """Name of the OpenCL platform."""
        return self.description.platform

    @property
    def driver_version(self) -> str:
        """The driver's version, which tells two PoCLs apart."""
        return self.description.driver_version

    @property
    def context(self) -> Any:
        """The ``pyopencl.Context``, one per device and process.

        Raises
        ------
        DeviceError
            In a process forked from the one that chose the device, or if the driver refuses.
        """
        self.refuse_fork()
        with self._lock:
            if self._context is None:
                cl = registration.opencl()
                try:
                    self._context = cl.Context([self.cl_device])
                except cl.Error as error:
                    message = f"{self.label} does not start: {error}; clgrid doctor says more"
                    raise DeviceError(message) from error
            return self._context

    @property
    def queue(self) -> Any:
        """The in-order ``pyopencl.CommandQueue``, one per device and process.

        Raises
        ------
        DeviceError
            In a process forked from the one that chose the device.
        """
        context = self.context
        with self._lock:
            if self._queue is None:
                self._queue = registration.opencl().CommandQueue(context)
            return self._queue

    def require_usable(self) -> None:
        """Find out, before the first build, that the device can compile and run a kernel.

        Only PoCL is tried (in a child process, once per driver and linker): it kills the process where
        it finds no linker.

        Raises
        ------
        DeviceError
            If it cannot, with the reason and the command that cures it.
        """
        self.refuse_fork()
        if not self.description.fp64:
            raise DeviceError(
                f"{self.description.label}: no double precision (cl_khr_fp64), which every rung of accuracy,"
                " robust and fast too, needs for planes and rays; name a device with fp64: clgrid devices"
            )
        with self._lock:
            if not self._checked:
                outcome = usable(self.description)
                if not outcome.ok:
                    raise DeviceError(f"{self.description.label}: {outcome.reason}; {outcome.cure}")
                self._checked = True

    @property
    def is_forked(self) -> bool:
        """Whether this process was forked from the one that chose the device."""
        return os.getpid() != self._made_by

    def refuse_fork(self) -> None:
        """Refuse use in a process forked from the one that chose the device.

        Raises
        ------
        DeviceError
            There, since drivers hang in forked processes.
        """
        if self.is_forked:
            raise _forked()


def _forked() -> DeviceError:
    return DeviceError(
        "OpenCL was started before this process was forked, and drivers hang in forked processes: "
        "start processes with multiprocessing.get_context('spawn')"
    )


def usable(description: Description) -> probe.Outcome:
    """Whether the device compiles and runs kernels; only PoCL, which may abort, is asked."""
    if not description.is_pocl:
        return probe.GOOD
    return probe.remembered(description.platform, description.name, description.driver_version)


def describe_all() -> list[Description]:
    """Every OpenCL device of this machine, in the order of ``clgrid devices``.

    Raises
    ------
    DeviceError
        If pyopencl cannot be imported, or in a forked process. No device is an empty list.
    """
    return [description for description, _ in _find()]


def choose(selector: str | Device | None = None) -> Device:
    """The device that ``selector`` names; the same object for the same device.

    Parameters
    ----------
    selector : str, Device or None
        An index of ``clgrid devices``, a label, part of a platform's or device's name or driver version
        (any case), or ``platform:device`` where either is such a part or an index within its list. None
        takes ``CLGRID_DEVICE``, or else the first CPU that works: Intel's runtime, the newest PoCL,
        other CPUs, then GPUs; never Oclgrind or Mesa's software drivers.

    Raises
    ------
    DeviceError
        If nothing matches, several devices match, or no device works.
    """
    if isinstance(selector, Device):
        return selector
    with _lock:
        found = _find()
        text = (selector if selector is not None else os.environ.get("CLGRID_DEVICE", "")).strip()
        descriptions = [description for description, _ in found]
        chosen = _select(descriptions, text) if text else _default(descriptions)
        if chosen.index not in _devices:
            _devices[chosen.index] = Device(found[chosen.index][1], chosen)
        return _devices[chosen.index]


def _default(descriptions: Sequence[Description]) -> Description:
    """The first device in the order of preference that can compile kernels."""
    refused: list[str] = []
    for description in sorted(descriptions, key=preference):
        if not description.implicit:
            continue
        outcome = usable(description)
        if outcome.ok:
            for message in refused:
                log.warning("%s; using %s", message, description.label)
            return description
        refused.append(f"{description.label} passed over: {outcome.reason}; {outcome.cure}")
    if refused:
        raise DeviceError("no usable OpenCL device: " + " | ".join(refused))
    if descriptions:
        raise DeviceError(f"no OpenCL device for everyday use, only {_lines(descriptions)}: {INSTALL}")
    raise DeviceError(f"no OpenCL device: {INSTALL}; clgrid doctor says more")


def _select(descriptions: Sequence[Description], text: str) -> Description:
    """The one device that ``text`` names.

    Raises
    ------
    DeviceError
        If nothing matches or devices that differ match.
    """
    matches = matching(descriptions, text)
    distinct = {(d.platform, d.name, d.driver_version, d.version): d for d in reversed(matches)}
    if len(distinct) == 1:
        return next(iter(distinct.values()))
    if not descriptions:
        raise DeviceError(f"no OpenCL device {text!r}, nor any other: {INSTALL}")
    if not matches:
        raise DeviceError(f"no OpenCL device matches {text!r}; there are: {_lines(descriptions)}")
    raise DeviceError(f"{text!r} matches several OpenCL devices, name one: {_lines(matches)}")


def _lines(descriptions: Sequence[Description]) -> str:
    return ", ".join(description.line() for description in descriptions)


def _find() -> tuple[tuple[Description, Any], ...]:
    """Every device with its description, asked of the loader once a process."""
    global _found, _found_by
    with _lock:
        if _found is not None and _found_by != os.getpid():
            raise _forked()
        if _found is None:
            _found = tuple(_ask_loader())
            _found_by = os.getpid()
        return _found


def _ask_loader() -> list[tuple[Description, Any]]:
    cl = registration.opencl()
    try:
        platforms = cl.get_platforms()
    except cl.Error as error:
        # The loader's answer where there is no .icd file that works.
        if "PLATFORM_NOT_FOUND_KHR" not in str(error):
            raise DeviceError(f"the OpenCL loader failed: {error}") from error
        platforms = []
    devices = []
    for platform in platforms:
        try:
            devices += [(platform, device) for device in platform.get_devices()]
        except cl.Error as error:
            log.debug("platform %s has no devices: %s", platform.name, error)
    found: list[Description] = []
    for index, (platform, device) in enumerate(devices):
        note = pocl.name_processor(platform, device)
        description = describe(cl, index, platform, device, {d.label for d in found})
        found.append(replace(description, note=note))
    candidates = [d for d in found if d.implicit]
    first = min(candidates, key=preference).index if candidates else -1
    return [
        (replace(d, preferred=d.index == first), device)
        for d, (_, device) in zip(found, devices, strict=True)
    ]
