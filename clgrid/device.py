"""OpenCL devices: find, describe, choose; one context and queue each."""

from __future__ import annotations

import logging
import os
import re
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from clgrid import pocl, probe, registration
from clgrid.errors import DeviceError

log = logging.getLogger(__name__)

# Platforms that are never taken unless named: a checker that interprets, and Mesa's drivers, which cut
# loops at 65,535 iterations on the CPU.
_NEVER_IMPLICIT = ("oclgrind", "rusticl", "clover", "llvmpipe", "fpga", "emulation")
INSTALL = "pip install 'pyopencl[pocl]', or: pip install intel-opencl-rt intel-cmplr-lib-rt"

_lock = threading.RLock()
_found: tuple[tuple[Description, Any], ...] | None = None
_found_by: int = 0  # process id
_devices: dict[int, Device] = {}


@dataclass(frozen=True)
class Description:
    """What ``clgrid devices`` says of one OpenCL device.

    Attributes
    ----------
    index : int
        Position in the list, as ``--device`` takes it.
    label : str
        Short name of this machine's device, unique in the list and a valid selector: ``intel``, ``pocl-3.0``.
    platform, platform_version, name, vendor, driver_version, version, c_version : str
        As the driver reports them.
    type : str
        ``CPU``, ``GPU``, ``ACCELERATOR``, joined by ``+``.
    compute_units : int
        Compute units (CPU devices: hardware threads).
    global_memory, max_allocation : int
        Bytes: the device's memory, and the largest single buffer.
    fp64 : bool
        Whether kernels can use ``double``.
    correctly_rounded_divide : bool
        Whether float32 ``/`` and ``sqrt`` are advertised as correctly rounded (on CPUs they are anyway).
    denormals : bool
        Whether float32 subnormals are kept.
    implicit : bool
        Whether the device may be chosen without being named.
    preferred : bool
        Whether the default order of preference puts it first.
    note : str
        What clgrid changed to make the device work; mostly empty.
    """

    index: int
    label: str
    platform: str
    platform_version: str
    name: str
    vendor: str
    driver_version: str
    version: str
    c_version: str
    type: str
    compute_units: int
    global_memory: int
    max_allocation: int
    fp64: bool
    correctly_rounded_divide: bool
    denormals: bool
    implicit: bool
    preferred: bool
    note: str

    @property
    def is_pocl(self) -> bool:
        """Whether the driver is PoCL, which links every kernel with the system's linker."""
        return pocl.is_pocl(self.platform_version)

    @property
    def is_intel_cpu(self) -> bool:
        """Whether the driver is Intel's CPU runtime."""
        return self.platform.startswith("Intel") and "CPU" in self.type and self.implicit

    def line(self) -> str:
        """One line for people: index, label, name and driver."""
        return f"{self.index} {self.label} ({self.platform}: {self.name}, driver {self.driver_version})"


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
        """Short name, a valid selector: ``intel``, ``pocl-3.0``."""
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
            In a process forked from the one that chose the device.
        """
        self._refuse_fork()
        with self._lock:
            if self._context is None:
                self._context = registration.opencl().Context([self.cl_device])
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
        self._refuse_fork()
        with self._lock:
            if not self._checked:
                outcome = usable(self.description)
                if not outcome.ok:
                    raise DeviceError(f"{self.description.label}: {outcome.reason}; {outcome.cure}")
                self._checked = True

    def _refuse_fork(self) -> None:
        if os.getpid() != self._made_by:
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
    for description in sorted(descriptions, key=_preference):
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


def matching(descriptions: Sequence[Description], text: str) -> list[Description]:
    """The devices that ``text`` may mean, by the most telling of their names that it fits.

    Parameters
    ----------
    descriptions : sequence of Description
        Among these.
    text : str
        A selector, see `choose`.
    """
    if text.isdecimal():
        return [d for d in descriptions if d.index == int(text)]
    fields: list[Callable[[Description], tuple[str, ...]]] = [
        lambda d: (d.platform, d.platform_version, d.vendor if d.is_intel_cpu else ""),
        lambda d: (d.name,),
        lambda d: (d.driver_version,),
    ]
    wanted = text.lower()
    exact = [d for d in descriptions if d.label == wanted]
    if exact:
        return exact
    for names in fields:
        hits = [d for d in descriptions if any(wanted in name.lower() for name in names(d))]
        if hits:
            return hits
    first, colon, second = text.partition(":")
    return _matches_pair(descriptions, first.strip(), second.strip()) if colon else []


def _matches_pair(descriptions: Sequence[Description], platform: str, device: str) -> list[Description]:
    """The devices that ``platform:device`` means, either part an index or part of a name."""
    platforms = list(dict.fromkeys((d.platform, d.platform_version) for d in descriptions))
    hits = []
    for number, key in enumerate(platforms):
        if not _part_fits(platform, number, *key):
            continue
        members = [d for d in descriptions if (d.platform, d.platform_version) == key]
        hits += [
            d
            for at, d in enumerate(members)
            if not device or _part_fits(device, at, d.name, d.driver_version, d.label)
        ]
    return hits


def _part_fits(part: str, index: int, *names: str) -> bool:
    if part.isdecimal():
        return int(part) == index
    return any(part.lower() in name.lower() for name in names)


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
        processor = pocl.name_processor(platform, device)
        note = f"compiles for {processor}: its LLVM does not know this processor" if processor else ""
        description = _describe(cl, index, platform, device, {d.label for d in found})
        found.append(replace(description, note=note))
    candidates = [d for d in found if d.implicit]
    first = min(candidates, key=_preference).index if candidates else -1
    return [
        (replace(d, preferred=d.index == first), device)
        for d, (_, device) in zip(found, devices, strict=True)
    ]


def _describe(cl: Any, index: int, platform: Any, device: Any, taken: set[str]) -> Description:
    kinds = cl.device_type
    types = [name for name in ("CPU", "GPU", "ACCELERATOR") if device.type & getattr(kinds, name)]
    names = f"{platform.name} {device.name} {platform.version}".lower()
    implicit = len(types) == 1 and not any(word in names for word in _NEVER_IMPLICIT)
    single = device.single_fp_config
    config = cl.device_fp_config
    type_ = "+".join(types) or "CUSTOM"
    return Description(
        index=index,
        label=_label(platform, device, type_, taken),
        platform=platform.name.strip(),
        platform_version=platform.version.strip(),
        name=device.name.strip(),
        vendor=device.vendor.strip(),
        driver_version=device.driver_version.strip(),
        version=device.version.strip(),
        c_version=device.opencl_c_version.strip(),
        type=type_,
        compute_units=device.max_compute_units,
        global_memory=device.global_mem_size,
        max_allocation=device.max_mem_alloc_size,
        fp64="cl_khr_fp64" in device.extensions.split(),
        correctly_rounded_divide=bool(single & config.CORRECTLY_ROUNDED_DIVIDE_SQRT),
        denormals=bool(single & config.DENORM),
        implicit=implicit,
        preferred=False,
        note="",
    )


def _label(platform: Any, device: Any, type_: str, taken: set[str]) -> str:
    """A short selector for the device, unlike those in ``taken``."""
    names = f"{platform.name} {platform.version}".lower()
    version = re.match(r"\d+(\.\d+)?", device.driver_version.strip())
    if pocl.is_pocl(platform.version):
        label = f"pocl-{version.group() if version else device.driver_version.strip()}"
    elif names.startswith("intel"):
        label = "intel" if type_ == "CPU" else f"intel-{type_.lower()}"
    else:
        label = re.sub(r"[^a-z0-9]+", "-", platform.name.lower()).strip("-").split("-")[0] or "device"
    number, unique = 2, label
    while unique in taken:
        number, unique = number + 1, f"{label}-{number}"
    return unique


def _preference(description: Description) -> tuple[int, tuple[int, ...], int]:
    """Sort key: Intel's CPU runtime, PoCL from the newest, other CPUs, GPUs, the rest; then by index."""
    newest_first = tuple(-int(number) for number in re.findall(r"\d+", description.driver_version))
    if description.type == "CPU":
        group = 0 if description.is_intel_cpu else 1 if description.is_pocl else 2
    else:
        group = 3 if description.type == "GPU" else 4
    return group, newest_first if group == 1 else (), description.index
