"""What is known of an OpenCL device, and which of several devices a name means."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from clgrid import pocl

# Platforms that are never taken unless named: a checker that interprets, and Mesa's drivers, which cut
# loops at 65,535 iterations on the CPU.
_NEVER_IMPLICIT = ("oclgrind", "rusticl", "clover", "llvmpipe", "fpga", "emulation")


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


def describe(cl: Any, index: int, platform: Any, device: Any, taken: set[str]) -> Description:
    """Ask the driver; ``taken`` are the labels given so far."""
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


def preference(description: Description) -> tuple[int, tuple[int, ...], int]:
    """Sort key: Intel's CPU runtime, PoCL from the newest, other CPUs, GPUs, the rest; then by index."""
    newest_first = tuple(-int(number) for number in re.findall(r"\d+", description.driver_version))
    if description.type == "CPU":
        group = 0 if description.is_intel_cpu else 1 if description.is_pocl else 2
    else:
        group = 3 if description.type == "GPU" else 4
    return group, newest_first if group == 1 else (), description.index


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
