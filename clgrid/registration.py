"""Make OpenCL runtimes that pip installed known to the OpenCL loader, without root.

``intel-opencl-rt`` puts its library into the environment but leaves no .icd file that works. The loader
reads ``OCL_ICD_VENDORS=<folder>`` *instead of* ``/etc/OpenCL/vendors`` and in addition to the .icd files
inside pyopencl (PoCL from PyPI), so the folder made here repeats the system's files and adds Intel's.
"""

from __future__ import annotations

import contextlib
import importlib.util
import logging
import os
import re
import sys
import threading
from pathlib import Path
from typing import Any

from clgrid import cache
from clgrid.errors import DeviceError

log = logging.getLogger(__name__)

SYSTEM_VENDORS = Path("/etc/OpenCL/vendors")
# Either of them replaces the system's folder.
LOADER_VARIABLES = ("OCL_ICD_VENDORS", "OPENCL_VENDOR_PATH")

_lock = threading.Lock()
_pyopencl: Any = None


def intel_library() -> Path | None:
    """Intel's CPU runtime of this Python environment, or None."""
    path = Path(sys.prefix) / "lib" / "libintelocl.so"
    return path if path.exists() else None


def intel_math_library() -> Path | None:
    """The library of ``intel-cmplr-lib-rt`` that Intel's runtime cannot be loaded without, or None."""
    path = Path(sys.prefix) / "lib" / "libimf.so"
    return path if path.exists() else None


def icd_libraries(vendors: Path) -> dict[Path, str]:
    """The library that each .icd file in the folder ``vendors`` names (its first line)."""
    found: dict[Path, str] = {}
    with contextlib.suppress(OSError):
        for file in sorted(vendors.glob("*.icd")):
            with contextlib.suppress(OSError):
                lines = file.read_text(encoding="utf-8", errors="replace").split("\n")
                found[file] = lines[0].strip()
    return found


def in_virtual_environment() -> bool:
    """Whether this Python runs in a virtual environment."""
    return sys.prefix != sys.base_prefix


def loader_folder() -> Path | None:
    """The folder in pyopencl whose .icd files its own loader reads in any case, or None without one."""
    spec = importlib.util.find_spec("pyopencl")
    for folder in (spec.submodule_search_locations or []) if spec else []:
        libraries = Path(folder) / ".libs"
        if any(libraries.glob("libOpenCL*")):
            return libraries
    return None


def registered_for_all() -> Path | None:
    """The .icd file by which other programs of this Python find Intel's CPU runtime, or None."""
    folder = loader_folder()
    for vendors in (SYSTEM_VENDORS, *([folder] if folder else [])):
        for file, library in icd_libraries(vendors).items():
            if is_intel_cpu(library):
                return file
    return None


def registered_libraries() -> dict[Path, str]:
    """Every .icd file (or library) that the loader will read, and the library it leads to."""
    register()
    value = next((os.environ[v] for v in LOADER_VARIABLES if os.environ.get(v)), str(SYSTEM_VENDORS))
    place = Path(value)
    # Naming one file leaves out all others, those inside pyopencl too.
    if place.suffix == ".icd":
        return {place: icd_libraries(place.parent).get(place, "")}
    if not place.is_dir() and place != SYSTEM_VENDORS:
        return {place: value}
    found = icd_libraries(place)
    folder = loader_folder()
    for file, library in icd_libraries(folder).items() if folder else ():
        beside = file.parent / library
        found[file] = str(beside) if beside.exists() else library
    return found


def user_setting() -> tuple[str, str] | None:
    """The loader variable that the user set, and its value; folders made by ``register`` do not count."""
    for variable in LOADER_VARIABLES:
        value = os.environ.get(variable)
        if value and Path(value) not in _own_folders():
            return variable, value
    return None


def _own_folders() -> tuple[Path, ...]:
    """Where registrations may be written, best first."""
    prefix = Path(sys.prefix)
    return prefix / "etc" / "clgrid" / "icd", cache.folder() / f"icd-{cache.key(prefix)}"


def is_intel_cpu(library: str) -> bool:
    """Whether an .icd line leads to Intel's CPU runtime (and not to its FPGA emulator)."""
    path = Path(library)
    return path.name == "libintelocl.so" and (not path.is_absolute() or path.exists())


def _without_blanks(library: Path) -> Path | None:
    """``library``, or a hard link to it and its neighbours: it fails below a folder with a blank in its name.

    Symbolic links do not help, since it looks for its real path.
    """
    if not re.search(r"\s", str(library.resolve())):
        return library
    place = cache.folder() / f"intel-{cache.key(library.parent, library.stat().st_mtime_ns)}"
    if re.search(r"\s", str(place.resolve())):
        return None
    try:
        place.mkdir(parents=True, exist_ok=True)
        for file in library.parent.iterdir():
            if file.is_file() and not (place / file.name).exists():
                with contextlib.suppress(FileExistsError):
                    os.link(file, place / file.name)
    except OSError as error:
        log.debug("%s cannot be linked to %s: %s", library.parent, place, error)
        return None
    return place / library.name


def _fill(vendors: Path, library: Path) -> None:
    """Make ``vendors`` hold the system's .icd files and one that names ``library``.

    Raises
    ------
    OSError
        If the folder cannot be written.
    """
    wanted = {f"system-{file.name}": line for file, line in icd_libraries(SYSTEM_VENDORS).items() if line}
    wanted["clgrid-intel.icd"] = str(library)
    vendors.mkdir(parents=True, exist_ok=True)
    present = icd_libraries(vendors)
    for file in present:
        if file.name not in wanted:
            file.unlink(missing_ok=True)
    for name, line in wanted.items():
        if present.get(vendors / name) != line:
            cache.write_whole(vendors / name, line + "\n")


def register() -> Path | None:
    """Register Intel's runtime of this environment where nobody did, before the first OpenCL call.

    Returns
    -------
    Path or None
        The folder put into ``OCL_ICD_VENDORS``; None if the loader finds it without, the user's own
        ``OCL_ICD_VENDORS`` or ``OPENCL_VENDOR_PATH`` stands, no folder could be written, or the runtime
        lies below a folder with a blank in its name and cannot be linked to elsewhere.
    """
    library = intel_library()
    if library is None or user_setting() is not None:
        return None
    if registered_for_all() is not None:
        # A parent process may have registered it before: it would be there twice.
        for variable in LOADER_VARIABLES:
            os.environ.pop(variable, None)
        return None
    loadable = _without_blanks(library)
    if loadable is None:
        return None
    for vendors in _own_folders()[loadable != library :]:
        try:
            _fill(vendors, loadable)
        except OSError as error:
            log.debug("%s cannot be written: %s", vendors, error)
            continue
        os.environ["OCL_ICD_VENDORS"] = str(vendors)
        return vendors
    return None


def opencl() -> Any:
    """The module ``pyopencl``, imported after ``register``.

    Raises
    ------
    DeviceError
        If pyopencl cannot be imported.
    """
    global _pyopencl
    with _lock:
        if _pyopencl is None:
            register()
            try:
                import pyopencl
            except ImportError as error:
                raise DeviceError(
                    f"pyopencl cannot be imported ({error}): pip install 'pyopencl[pocl]'"
                ) from error
            _pyopencl = pyopencl
    return _pyopencl
