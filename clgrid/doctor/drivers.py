"""Drivers: whether those that are registered can be loaded, and whether devices can be listed at all."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from clgrid import device, probe, registration
from clgrid.description import Description
from clgrid.doctor.finding import Finding
from clgrid.errors import DeviceError

INTEL_PACKAGES = "pip install intel-opencl-rt intel-cmplr-lib-rt"

_LIST_SECONDS = 60.0


def pyopencl() -> Finding:
    """Whether pyopencl can be imported."""
    try:
        module = registration.opencl()
    except DeviceError as error:
        return Finding("pyopencl", "fail", None, str(error), "pip install 'pyopencl[pocl]'")
    return Finding("pyopencl", "ok", None, f"pyopencl {module.VERSION_TEXT}")


def icd_files() -> Iterator[Finding]:
    """Whether every driver that is registered can be loaded."""
    setting = registration.user_setting()
    if setting is not None:
        message = f"{setting[0]}={setting[1]} replaces {registration.SYSTEM_VENDORS}"
        yield Finding("icd", "ok", None, message, "unset it if drivers are missing")
    for file, library in registration.registered_libraries().items():
        error = _load_error(library) if library else "the file is empty"
        if not error:
            yield Finding("icd", "ok", None, f"{file}: {library}")
        elif registration.is_intel_cpu(library) and registration.intel_math_library() is None:
            # Said once, with its own cure, by the check "intel".
            continue
        else:
            message = f"{file} names {library or 'no library'}, which cannot be loaded: {error}"
            yield Finding("icd", "warn", None, message, f"install that driver again, or delete {file}")


def _load_error(library: str) -> str:
    """Why ``library`` cannot be loaded, asked in a child process; empty if it can."""
    command = [sys.executable, "-c", "import ctypes, sys; ctypes.CDLL(sys.argv[1])", library]
    return _child_error(command)


def _child_error(command: list[str]) -> str:
    child = probe.run_child(command, _LIST_SECONDS)
    if child is None:
        return f"no answer within {_LIST_SECONDS:.0f} s"
    return "" if child.returncode == 0 else probe.last_words(child.stderr, child.returncode)


def listing() -> Finding:
    """Whether devices can be listed at all; in a child first, since a broken driver may crash there."""
    error = _child_error(probe.child_command("clgrid.doctor.drivers"))
    if error:
        advice = "remove the .icd files of drivers that you do not use, or set OCL_ICD_VENDORS to one of them"
        return Finding("platforms", "fail", None, f"listing OpenCL devices fails: {error}", advice)
    devices = device.describe_all()
    if not devices:
        advice = f"pip install 'pyopencl[pocl]', or: {INTEL_PACKAGES}"
        return Finding("platforms", "fail", None, "no OpenCL platform with a device", advice)
    return Finding("platforms", "ok", None, "; ".join(description.line() for description in devices))


def intel(devices: Sequence[Description]) -> Iterator[Finding]:
    """Intel's runtime from PyPI: complete, and registered."""
    library = registration.intel_library()
    if library is None:
        return
    setting = registration.user_setting()
    if registration.intel_math_library() is None:
        message = f"{library} is installed without libimf.so, which it needs"
        yield Finding("intel", "warn", None, message, "pip install intel-cmplr-lib-rt")
    elif any(description.is_intel_cpu for description in devices):
        yield _registered(library)
    elif setting is not None:
        message = f"{library} is installed but {setting[0]}={setting[1]} leaves it out"
        yield Finding("intel", "warn", None, message, f"unset {setting[0]}")
    elif " " in str(library):
        message = f"{library} is installed, but it fails below a folder with a blank in its name"
        yield Finding("intel", "warn", None, message, "make the Python environment somewhere else")
    else:
        message = f"{library} is installed but not among the platforms"
        advice = "clgrid doctor --fix" if registration.in_virtual_environment() else _as_root(library)
        yield Finding("intel", "warn", None, message, advice)


def _registered(library: Path) -> Finding:
    """For whom it is: for all programs of this Python environment, or for clgrid alone."""
    file = registration.registered_for_all()
    if file is not None:
        message = f"{library} is registered by {file} for every program of this environment"
        return Finding("intel", "ok", None, message)
    setting = registration.user_setting()
    if setting is not None:
        return Finding("intel", "ok", None, f"{library} is registered by {setting[0]}={setting[1]}")
    message = f"{library} is registered, by clgrid and for clgrid alone"
    if registration.in_virtual_environment():
        advice = "to have other programs of this environment see it: clgrid doctor --fix"
    else:
        advice = f"to have other programs see it: {_as_root(library)}"
    return Finding("intel", "ok", None, message, advice)


def _as_root(library: Path) -> str:
    return f"as root: echo {library} > {registration.SYSTEM_VENDORS}/intel-cpu.icd"


def main() -> None:
    """Run in the child: list the devices."""
    device.describe_all()
