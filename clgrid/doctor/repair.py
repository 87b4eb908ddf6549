"""Registers Intel's runtime for every program of a virtual environment, not for clgrid alone.

``intel-opencl-rt`` leaves ``<environment>/etc/OpenCL/vendors/intel-cpu.icd``, which names a place on its
maker's machine, and which no loader reads. The loader inside pyopencl reads the .icd files beside itself,
whatever the system and ``OCL_ICD_VENDORS`` have; so one more there is all that it takes.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

from clgrid import cache, probe, registration
from clgrid.doctor.drivers import INTEL_PACKAGES
from clgrid.doctor.finding import Finding
from clgrid.errors import DeviceError, InputError

FILE_NAME = "clgrid-intel.icd"

_SECONDS = 60.0
# What another program of the environment sees; it knows nothing of clgrid.
_LIST = "import pyopencl as cl; print(sum(p.name.strip() == 'Intel(R) OpenCL' for p in cl.get_platforms()))"


def fix() -> Finding:
    """Write the .icd file, unless one is there, and see that it works.

    Returns
    -------
    Finding
        What was done, and how to undo it.

    Raises
    ------
    InputError
        Outside of a virtual environment, or without a complete runtime or a loader in it.
    DeviceError
        If other programs then do not see Intel's runtime once; nothing stays behind.
    """
    library, folder = _library(), _folder()
    present = registration.registered_for_all()
    if present is not None:
        named = registration.icd_libraries(present.parent)[present]
        return Finding("fix", "ok", None, f"nothing to do: {present} names {named} already")
    file = folder / FILE_NAME
    try:
        cache.write_whole(file, f"{library}\n", mode=0o644)
    except OSError as error:
        raise InputError(f"{file} cannot be written: {error.strerror or error}") from error
    fault = _fault()
    if fault:
        file.unlink(missing_ok=True)
        raise DeviceError(f"{file} was written and removed again, since it did not help: {fault}")
    message = f"wrote {file}, which names {library}: pyopencl of this environment now finds Intel's runtime"
    return Finding("fix", "ok", None, message, f"to undo it: rm {file}")


def _library() -> Path:
    """Intel's runtime in this virtual environment."""
    if not registration.in_virtual_environment():
        raise InputError(
            f"--fix writes only into virtual environments; {sys.prefix} is none, python3 -m venv makes one"
        )
    library = registration.intel_library()
    if library is None or registration.intel_math_library() is None:
        missing = "Intel's runtime" if library is None else "libimf.so, which Intel's runtime needs,"
        raise InputError(f"{missing} is not in {sys.prefix}: {INTEL_PACKAGES}; then clgrid doctor --fix")
    if " " in str(library):
        raise InputError(
            f"{library} fails below a folder with a blank in its name: make the environment elsewhere"
        )
    return library


def _folder() -> Path:
    """Where the loader of this virtual environment reads .icd files."""
    folder = registration.loader_folder()
    if folder is None:
        raise InputError(
            "this pyopencl brings no loader that reads files beside it: pip install 'pyopencl[pocl]'"
        )
    if not folder.resolve().is_relative_to(Path(sys.prefix).resolve()):
        raise InputError(
            f"pyopencl is in {folder}, outside of {sys.prefix}: install it there, pip install pyopencl"
        )
    return folder


def _fault() -> str:
    """Why another program does not see Intel's runtime once; empty if it does."""
    hidden = registration.LOADER_VARIABLES
    environment = {name: value for name, value in os.environ.items() if name not in hidden}
    child = probe.run_child([sys.executable, "-c", _LIST], _SECONDS, environment)
    if child is None:
        return f"listing platforms takes more than {_SECONDS:.0f} s"
    if child.returncode != 0:
        return f"listing platforms fails: {probe.last_words(child.stderr, child.returncode)}"
    count = child.stdout.strip()
    return "" if count == "1" else f"{count} of Intel's platforms are seen"
