"""Devices that could be installed on this system, and what is wrong with some of them."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence

from clgrid import registration
from clgrid.description import Description
from clgrid.doctor.drivers import INTEL_PACKAGES
from clgrid.doctor.finding import Finding

# Of PyPI's PoCL, and the platform of Debian's packages.
_PYPI_POCL = "3.0-rc2"


def installable(devices: Sequence[Description]) -> Iterator[Finding]:
    """What is not here yet, a finding each."""
    pocls = [description.driver_version for description in devices if description.is_pocl]
    if _PYPI_POCL not in pocls:
        message = "PoCL 3.0 from PyPI: open source, 58 MB, needs no root; needs a linker (gcc) at run time"
        yield Finding("install", "ok", None, message, "pip install 'pyopencl[pocl]'")
    if registration.intel_library() is None and not any(description.is_intel_cpu for description in devices):
        message = (
            "Intel's CPU runtime from PyPI: works on AMD too, 280 MB, needs no linker; proprietary licence"
        )
        yield Finding("install", "ok", None, message, INTEL_PACKAGES)
    if shutil.which("apt-get") is not None:
        yield from _debian(devices, pocls)


def _debian(devices: Sequence[Description], pocls: Sequence[str]) -> Iterator[Finding]:
    platforms = " ".join(f"{description.platform} {description.name}" for description in devices).lower()
    if not any(version != _PYPI_POCL for version in pocls):
        message = "Debian's own PoCL (3.1 in Debian 12): open source, 43 MB"
        yield Finding("install", "ok", None, message, _as_root("pocl-opencl-icd"))
    if "oclgrind" not in platforms:
        message = (
            "Oclgrind interprets kernels and finds races and accesses out of bounds, but slowly;"
            " taken only where it is named"
        )
        yield Finding("install", "ok", None, message, f"{_as_root('oclgrind')}; then: oclgrind COMMAND")
    if not any(word in platforms for word in ("rusticl", "llvmpipe", "clover")):
        message = (
            "not recommended: Mesa's rusticl (mesa-opencl-icd) has no double precision, which clgrid needs,"
            " and 22.3 in Debian 12 ends every loop after 65,535 turns without a word"
        )
        yield Finding("install", "ok", None, message)


def _as_root(package: str) -> str:
    return f"as root: apt-get install -y --no-install-recommends {package}"
