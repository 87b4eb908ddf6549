"""Parts of a device: ``pocl-3.0/1`` is one of its compute units.

A CPU device's compute units are threads, so a part is the same device with fewer threads.
"""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

from clgrid.description import Description
from clgrid.errors import DeviceError

_SELECTOR = re.compile(r"(?P<device>.+)/(?P<units>\d+)")


def split(selector: str) -> tuple[str, int | None]:
    """The selector of a whole device, and how many of its compute units are meant; None for all."""
    found = _SELECTOR.fullmatch(selector.strip())
    return (found["device"].strip(), int(found["units"])) if found else (selector.strip(), None)


def check_units(whole: Description, units: int) -> None:
    """Refuse a part that a device does not have.

    Raises
    ------
    DeviceError
    """
    if not 1 <= units <= whole.compute_units:
        raise DeviceError(
            f"{whole.label}/{units}: {whole.label} has {whole.compute_units} compute units; give 1 to"
            f" {whole.compute_units}"
        )


def part(cl_device: Any, whole: Description, units: int) -> tuple[Any, Description]:
    """A sub-device of so many compute units, and what is known of it.

    Parameters
    ----------
    cl_device : pyopencl.Device
    whole : Description
        Of it.
    units : int

    Raises
    ------
    DeviceError
        If it has no such part, or its driver does not divide devices.
    """
    from clgrid import registration

    check_units(whole, units)
    label = f"{whole.label}/{units}"
    known = replace(whole, label=label, compute_units=units, preferred=False)
    if units == whole.compute_units:
        return cl_device, known
    cl = registration.opencl()
    by_counts = cl.device_partition_property.BY_COUNTS
    if by_counts not in cl_device.partition_properties:
        raise DeviceError(f"{label}: the driver does not divide {whole.label}; leave out /{units}")
    try:
        parts = cl_device.create_sub_devices([by_counts, units, 0])
    except cl.Error as error:
        raise DeviceError(f"{label}: the driver does not divide {whole.label}: {error}") from error
    return parts[0], known
