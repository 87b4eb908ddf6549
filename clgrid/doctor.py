"""Find out what is wrong with this machine's OpenCL, and say what cures it.

Whatever may crash or hang (loading a driver, listing devices, compiling) happens in child processes.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

from clgrid import device, pocl, probe, registration, selftest
from clgrid.description import Description, matching
from clgrid.errors import DeviceError
from clgrid.rungs import LOSSLESS

Status = Literal["ok", "warn", "fail"]

_SLOW_SECONDS = 10.0
_LIST_SECONDS = 60.0
# A buffer may take a quarter of memory by the standard; drivers that allow much less surprise.
_SMALL_SHARE = 1 / 8
_INTEL_PACKAGES = "pip install intel-opencl-rt intel-cmplr-lib-rt"


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at.

    Attributes
    ----------
    check : str
        What was looked at: ``pyopencl``, ``icd``, ``intel``, ``platforms``, ``compile``,
        ``processor``, ``fp64``, ``allocation``, ``selftest``, ``cache``, ``default``.
    status : {"ok", "warn", "fail"}
        ``fail`` where it keeps a device from working.
    device : str or None
        Label of the device it concerns.
    message, advice : str
        What was found, and what to do about it (empty if nothing).
    seconds : float or None
        Of the first compile and launch, with empty caches.
    """

    check: str
    status: Status
    device: str | None
    message: str
    advice: str = ""
    seconds: float | None = None


@dataclass(frozen=True)
class Report:
    """What ``examine`` found.

    Attributes
    ----------
    findings : tuple of Finding
        In the order of the checks.
    usable : tuple of str
        Labels of the devices that compiled and ran a kernel.
    default : str or None
        Label of the device that is used where none is named.
    """

    findings: tuple[Finding, ...]
    usable: tuple[str, ...]
    default: str | None


def examine(selector: str | None = None) -> Report:
    """Look at everything that clgrid needs of OpenCL.

    Parameters
    ----------
    selector : str or None
        Compile on the devices it matches only; see `device.choose`. None: on all but simulators.

    Raises
    ------
    DeviceError
        If ``selector`` matches no device.
    """
    findings = [_pyopencl()]
    findings += _icd_files()
    devices: list[Description] = []
    if findings[0].status == "ok":
        listing = _listing()
        findings.append(listing)
        if listing.status == "ok":
            devices = device.describe_all()
    findings += _intel(devices)
    findings += _cache()
    usable = []
    for description in _asked_for(devices, selector):
        compiled = _compile(description)
        findings += [compiled, *_abilities(description)]
        if compiled.status != "fail" and description.fp64:
            usable.append(description.label)
            findings += _selftest(description)
    choice, default = _default()
    return Report((*findings, choice), tuple(usable), default)


def _asked_for(devices: Sequence[Description], selector: str | None) -> list[Description]:
    if selector is None:
        return [description for description in devices if description.implicit]
    matches = matching(devices, selector)
    if devices and not matches:
        labels = ", ".join(description.line() for description in devices)
        raise DeviceError(f"no OpenCL device matches {selector!r}; there are: {labels}")
    return matches


def _pyopencl() -> Finding:
    try:
        module = registration.opencl()
    except DeviceError as error:
        return Finding("pyopencl", "fail", None, str(error), "pip install 'pyopencl[pocl]'")
    return Finding("pyopencl", "ok", None, f"pyopencl {module.VERSION_TEXT}")


def _icd_files() -> Iterator[Finding]:
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
    try:
        child = subprocess.run(
            command, capture_output=True, text=True, errors="replace", timeout=_LIST_SECONDS, check=False
        )
    except subprocess.TimeoutExpired:
        return f"no answer within {_LIST_SECONDS:.0f} s"
    if child.returncode == 0:
        return ""
    lines = [line.strip() for line in child.stderr.splitlines() if line.strip()]
    return lines[-1][:300] if lines and child.returncode > 0 else probe.ending(child.returncode)


def _listing() -> Finding:
    """Whether devices can be listed at all; in a child first, since a broken driver may crash there."""
    error = _child_error(probe.child_command("clgrid.doctor"))
    if error:
        advice = "remove the .icd files of drivers that you do not use, or set OCL_ICD_VENDORS to one of them"
        return Finding("platforms", "fail", None, f"listing OpenCL devices fails: {error}", advice)
    devices = device.describe_all()
    if not devices:
        advice = f"pip install 'pyopencl[pocl]', or: {_INTEL_PACKAGES}"
        return Finding("platforms", "fail", None, "no OpenCL platform with a device", advice)
    return Finding("platforms", "ok", None, "; ".join(description.line() for description in devices))


def _intel(devices: Sequence[Description]) -> Iterator[Finding]:
    """Intel's runtime from PyPI: complete, and registered."""
    library = registration.intel_library()
    if library is None:
        return
    setting = registration.user_setting()
    if registration.intel_math_library() is None:
        message = f"{library} is installed without libimf.so, which it needs"
        yield Finding("intel", "warn", None, message, "pip install intel-cmplr-lib-rt")
    elif any(description.is_intel_cpu for description in devices):
        yield Finding("intel", "ok", None, f"{library} is registered")
    elif setting is not None:
        message = f"{library} is installed but {setting[0]}={setting[1]} leaves it out"
        yield Finding("intel", "warn", None, message, f"unset {setting[0]}")
    elif " " in str(library):
        message = f"{library} is installed, but it fails below a folder with a blank in its name"
        yield Finding("intel", "warn", None, message, "make the Python environment somewhere else")
    else:
        message = f"{library} is installed but not among the platforms"
        advice = f"as root: echo {library} > {registration.SYSTEM_VENDORS}/intel-cpu.icd"
        yield Finding("intel", "warn", None, message, advice)


def _cache() -> Iterator[Finding]:
    """Entries of PoCL's kernel cache that a crash left behind."""
    damaged = pocl.damaged_entries()
    if damaged:
        more = f" and {len(damaged) - 1} more" if len(damaged) > 1 else ""
        message = f"PoCL's kernel cache is damaged by an earlier crash: {damaged[0]}{more}"
        yield Finding("cache", "warn", None, message, f"rm -r {pocl.cache_folder()}")


def _compile(description: Description) -> Finding:
    """Time a first compile on the device, or say why it fails."""
    outcome = probe.attempt(description.platform, description.name, description.driver_version)
    label = description.label
    if not outcome.ok:
        return Finding("compile", "fail", label, outcome.reason, outcome.cure)
    message = f"first compile and launch of a small kernel: {outcome.seconds:.2f} s"
    if outcome.seconds > _SLOW_SECONDS:
        advice = "is the machine busy, or POCL_CACHE_DIR or XDG_CACHE_HOME on a slow disk?"
        return Finding("compile", "warn", label, message, advice, outcome.seconds)
    return Finding("compile", "ok", label, message, seconds=outcome.seconds)


def _abilities(description: Description) -> Iterator[Finding]:
    """What the device lacks."""
    label = description.label
    if description.note:
        yield Finding("processor", "ok", label, description.note)
    if not description.fp64:
        message = "no double precision (cl_khr_fp64), which building and casting need"
        yield Finding("fp64", "fail", label, message, "name a device with fp64: clgrid devices")
    memory = _machine_memory() if "CPU" in description.type else description.global_memory
    limit = f"one buffer may take {description.max_allocation / 2**30:.1f} of {memory / 2**30:.1f} GiB"
    if description.max_allocation < _SMALL_SHARE * memory:
        yield Finding("allocation", "warn", label, limit, _more_memory(description, memory))
    else:
        yield Finding("allocation", "ok", label, limit)


def _selftest(description: Description) -> Iterator[Finding]:
    """What the self-tests of strict rungs found, which run before the first grid of each."""
    found = {rung: selftest.remembered(description, rung) for rung in LOSSLESS}
    faults = [f"{rung}: {fault}" for rung, fault in found.items() if fault]
    if faults:
        message = f"refused, the self-test failed: {'; '.join(faults)}"
        advice = (
            "use another device or another version of its driver; the next grid of that accuracy tests again"
        )
        yield Finding("selftest", "fail", description.label, message, advice)
        return
    passed = [rung for rung, fault in found.items() if fault == ""]
    later = [rung for rung, fault in found.items() if fault is None]
    parts = [f"passed: {', '.join(passed)}"] if passed else []
    parts += [f"not run yet: {', '.join(later)} (the first grid does it)"] if later else []
    yield Finding("selftest", "ok", description.label, f"self-test {'; '.join(parts)}")


def _more_memory(description: Description, memory: int) -> str:
    if not description.is_pocl:
        return "use a smaller mesh or density, or another device, if a grid does not fit"
    # PoCL asks hwloc, which takes the memory of one NUMA node that some machines report late.
    cores = os.cpu_count() or 1
    return (
        "if a grid does not fit: export HWLOC_THISSYSTEM=1 "
        f"HWLOC_SYNTHETIC='numa:1(memory={memory // 2**30}GB) l3:1 l2:{cores} core:1 pu:1'"
    )


def _machine_memory() -> int:
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def _default() -> tuple[Finding, str | None]:
    """Which device is used where none is named."""
    named = os.environ.get("CLGRID_DEVICE")
    try:
        chosen = device.choose()
        chosen.require_usable()
    except DeviceError as error:
        advice = "unset CLGRID_DEVICE or correct it" if named else "see the advice above"
        return Finding("default", "fail", None, str(error), advice), None
    how = f"CLGRID_DEVICE={named}" if named else "none named"
    return Finding("default", "ok", chosen.label, f"{chosen.label} is used ({how})"), chosen.label


def main() -> None:
    """Run in the child: list the devices."""
    device.describe_all()
