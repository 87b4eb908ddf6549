"""Try a device in a child process: drivers that abort or hang must not take the caller along.

PoCL calls a linker for every kernel and aborts the process where it finds none, or where LLVM cannot
generate code for the CPU; so the first kernel of a PoCL is built by a child with a time-out.
"""

from __future__ import annotations

import json
import os
import platform as host
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from clgrid import cache

TIMEOUT_SECONDS = 120.0
# Files that a link needs; their dates are part of the key under which a success is remembered.
_LINK_INPUTS = ("lib*/crti.o", "lib*/*/crti.o", "lib*/libc.so", "lib*/*/libc.so", "lib*/gcc/*/*/libgcc.a")
_INTEL = "pip install intel-opencl-rt intel-cmplr-lib-rt"
# What LLVM adds to the reason for which it gives up: a plea for a report, and the stack.
_CRASH_REPORT = re.compile(r"PLEASE submit a bug report|Stack dump|#\d+ |\d+\.\t|\S+\(\S*\+0x[0-9a-f]+\)")
_SOURCE = """
kernel void clgrid_probe(global float *values, int n) {
    int g = get_global_id(0);
    if (g < n)
        values[g] = values[g] * 2.0f + 1.0f;
}
"""


@dataclass(frozen=True)
class Outcome:
    """What became of the trial.

    Attributes
    ----------
    ok : bool
        Whether a kernel was compiled and gave the right numbers.
    seconds : float
        Of the first compile and launch, with no cache.
    reason, cure : str
        One clause each; empty if ok.
    """

    ok: bool
    seconds: float
    reason: str
    cure: str


GOOD = Outcome(ok=True, seconds=0.0, reason="", cure="")
_known: dict[str, Outcome] = {}


def remembered(platform: str, name: str, driver_version: str) -> Outcome:
    """``attempt``, made once per driver, processor and linker; only a success outlives the process."""
    key = "probe-" + cache.key(platform, name, driver_version, *_environment())
    if key not in _known:
        record = cache.load(key)
        if record is not None and record.get("ok") is True:
            _known[key] = Outcome(ok=True, seconds=float(record.get("seconds", 0.0)), reason="", cure="")
        else:
            _known[key] = attempt(platform, name, driver_version)
            if _known[key].ok:
                cache.store(key, asdict(_known[key]))
    return _known[key]


def attempt(platform: str, name: str, driver_version: str, timeout: float = TIMEOUT_SECONDS) -> Outcome:
    """Compile and run a small kernel in a child process with empty kernel caches.

    Parameters
    ----------
    platform, name, driver_version : str
        The device, as OpenCL reports it.
    timeout : float
        Seconds until the child is killed.
    """
    with tempfile.TemporaryDirectory(prefix="clgrid-probe-") as scratch:
        environment = {**os.environ, "POCL_CACHE_DIR": scratch, "PYOPENCL_NO_CACHE": "1"}
        command = child_command("clgrid.probe", platform, name, driver_version)
        child = run_child(command, timeout, environment)
        if child is None:
            reason = f"compiling a small kernel takes more than {timeout:.0f} s"
            return Outcome(ok=False, seconds=timeout, reason=reason, cure=f"use another device: {_INTEL}")
    if child.returncode == 0:
        return Outcome(ok=True, seconds=float(json.loads(child.stdout)["seconds"]), reason="", cure="")
    reason, cure = explain(child.stderr, child.returncode)
    return Outcome(ok=False, seconds=0.0, reason=reason, cure=cure)


def child_command(module: str, *arguments: str) -> list[str]:
    """Command line that runs ``module.main(*arguments)`` in an interpreter that imports as this one does."""
    code = f"import sys; sys.path[:] = {sys.path!r}; import {module} as m; m.main(*sys.argv[1:])"
    return [sys.executable, "-c", code, *arguments]


def run_child(
    command: list[str], timeout: float, environment: dict[str, str] | None = None
) -> subprocess.CompletedProcess[str] | None:
    """What became of a child process; None if it did not end within so many seconds, and was killed."""
    try:
        return subprocess.run(
            command,
            env=environment,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=timeout,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return None


def last_words(output: str, returncode: int) -> str:
    """What a child that failed said last, or how it was killed."""
    said = telling_line(output.splitlines())
    return said[:300] if said and returncode > 0 else ending(returncode)


def telling_line(lines: Iterable[str]) -> str:
    """The last line that says something, or nothing.

    LLVM, where it catches a signal, asks for a bug report and lists the stack after the line that says why.
    """
    said = [line.strip() for line in lines if line.strip()]
    return next((line for line in reversed(said) if not _CRASH_REPORT.match(line)), said[-1] if said else "")


def explain(output: str, returncode: int) -> tuple[str, str]:
    """Reason and cure for a child that failed with ``output`` on stderr."""
    library = re.search(r"cannot find (-l\w+|\S*crt\w*\.o)", output)
    if library:
        return f"PoCL cannot link kernels: {library.group(1)} is missing", linker_cure()
    if shutil.which("ld") is None and "unknown target CPU" not in output:
        return "PoCL cannot link kernels: there is no linker (ld)", linker_cure()
    if "unknown target CPU" in output:
        return (
            "the LLVM in this PoCL is older than this processor and cannot compile for it",
            f"use Intel's runtime ({_INTEL}) or a newer PoCL ({pocl_package()})",
        )
    lines = [line.strip() for line in output.splitlines() if line.strip()]
    said = next((line for line in lines if "error" in line.lower()), lines[-1] if lines else "no message")
    failure = f"compiling a small kernel failed ({ending(returncode)}): {said[:200]}"
    return failure, f"use another device: {_INTEL}"


def ending(returncode: int) -> str:
    """How a process ended, in words."""
    return f"killed by {signal.Signals(-returncode).name}" if returncode < 0 else f"exit code {returncode}"


def linker_cure() -> str:
    """The one command that brings a linker, libgcc and libc's development files on this system."""
    family = _distribution()
    if "debian" in family or "ubuntu" in family:
        return "run: apt-get install -y gcc"
    if "fedora" in family or "rhel" in family:
        return "run: dnf install -y gcc"
    if "suse" in family:
        return "run: zypper install -y gcc"
    if "arch" in family:
        return "run: pacman -S gcc"
    return "install gcc with the system's package manager"


def pocl_package() -> str:
    """How this system's own PoCL is installed."""
    family = _distribution()
    if "debian" in family or "ubuntu" in family:
        return "apt-get install -y pocl-opencl-icd"
    return "conda install -c conda-forge pocl"


def _distribution() -> set[str]:
    try:
        release = host.freedesktop_os_release()
    except OSError:
        return set()
    return {release.get("ID", ""), *release.get("ID_LIKE", "").split()}


def _environment() -> list[object]:
    """What decides whether a link works, besides the driver: the processor, the linker, libc's files."""
    linker = shutil.which("ld")
    inputs = sorted(path for pattern in _LINK_INPUTS for path in Path("/usr").glob(pattern))
    return [_processor(), *((p, _modified(p)) for p in [Path(linker or "none"), *inputs])]


def _processor() -> str:
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        return host.processor()
    wanted = ("vendor_id", "cpu family", "model", "flags")
    return " ".join(line for line in text.split("\n\n")[0].splitlines() if line.startswith(wanted))


def _modified(path: Path) -> int:
    try:
        return path.stat().st_mtime_ns
    except OSError:
        return 0


def main(platform: str, name: str, driver_version: str) -> None:
    """Run in the child: compile and run one kernel, write the seconds as JSON on stdout."""
    import numpy as np

    from clgrid import pocl, registration

    cl: Any = registration.opencl()
    for candidate in cl.get_platforms():
        for device in candidate.get_devices():
            found = (candidate.name.strip(), device.name.strip(), device.driver_version.strip())
            if found == (platform, name, driver_version):
                pocl.name_processor(candidate, device)
                start = time.perf_counter()
                context = cl.Context([device])
                queue = cl.CommandQueue(context)
                values = np.arange(64, dtype=np.float32)
                flags = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
                buffer = cl.Buffer(context, flags, hostbuf=values)
                kernel = cl.Kernel(cl.Program(context, _SOURCE).build(), "clgrid_probe")
                kernel(queue, (64,), (64,), buffer, np.int32(64))
                result = np.empty_like(values)
                cl.enqueue_copy(queue, result, buffer)
                seconds = time.perf_counter() - start
                if not np.array_equal(result, values * 2 + 1):
                    sys.exit("error: the kernel gave wrong numbers")
                sys.stdout.write(json.dumps({"seconds": seconds}))
                sys.stdout.flush()
                return
    sys.exit(f"error: {platform}: {name} is not there")
