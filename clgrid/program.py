"""Programs: real .cl files, specialised by -D, built once and kept."""

from __future__ import annotations

import atexit
import functools
import hashlib
import logging
import os
import re
import shutil
import tempfile
import threading
import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clgrid import cache, pocl, registration, structs
from clgrid.device import Device
from clgrid.errors import DeviceError

log = logging.getLogger(__name__)

_INCLUDE = re.compile(r'^[ \t]*#[ \t]*include[ \t]+"([^"]+)"', re.MULTILINE)
_ERROR = re.compile(r"^(?:error: )?(?P<where>[^\s:]*:\d+:\d+:)? ?(?:fatal )?error: .*$", re.MULTILINE)

_lock = threading.RLock()
_programs: dict[_Variant, Any] = {}
_builds: list[Build] = []
_checked: set[Device] = set()
_swept: set[Device] = set()
_local = threading.local()


@dataclass(frozen=True)
class _Variant:
    """A file with its options on a device; ``digest`` is of the file and all it includes."""

    device: Device
    file: str
    digest: str
    options: tuple[str, ...]


@dataclass(frozen=True)
class Build:
    """One variant of a program, built in this process.

    Attributes
    ----------
    device : Device
        Where it was built.
    file : str
        The .cl file.
    options : tuple of str
        The ``-D`` options compiled in, and those of ``build_options``.
    kernels : str
        Digest of the sources, where they are not clgrid's own (``CLGRID_KERNELS``); else empty.
    """

    device: Device
    file: str
    options: tuple[str, ...]
    kernels: str = ""


@functools.cache
def source_folder() -> Path:
    """Folder of the .cl and .h files: ``own_source_folder``, or the one that ``CLGRID_KERNELS`` names.

    Raises
    ------
    DeviceError
        If that holds no kernels.
    """
    named = os.environ.get("CLGRID_KERNELS", "")
    if not named:
        return own_source_folder()
    folder = Path(named).absolute()
    if not (folder / "config.h").is_file():
        raise DeviceError(f"CLGRID_KERNELS is {named!r}, which holds no kernels of clgrid; unset it")
    log.warning("kernels come from %s (CLGRID_KERNELS): clgrid promises nothing of them", folder)
    return folder


@functools.cache
def build_options() -> tuple[str, ...]:
    """What ``CLGRID_BUILD_OPTIONS`` adds to the options of every build, to try what a driver does with it."""
    options = tuple(os.environ.get("CLGRID_BUILD_OPTIONS", "").split())
    if options:
        log.warning("built with %s (CLGRID_BUILD_OPTIONS): clgrid promises nothing", " ".join(options))
    return options


def own_source_folder() -> Path:
    """Folder of clgrid's kernels: clgrid/cl when installed, the checkout's cl/ when editable."""
    inside = Path(__file__).parent / "cl"
    return inside if inside.is_dir() else Path(__file__).parent.parent / "cl"


def kernel(device: Device, file: str, name: str, **defines: bool | int | str) -> Any:
    """The kernel ``name`` of ``file``, built with ``-Dkey=value`` options.

    Each variant is built once a process. The kernel object is kept per thread: setting the arguments of
    one kernel from two threads is a race.

    Parameters
    ----------
    device : Device
        Where to build.
    file, name : str
        File name in ``source_folder()`` and the kernel in it.
    **defines : bool, int or str
        Macros: booleans become 1 and 0, strings are written as they are.

    Raises
    ------
    DeviceError
        If the device cannot build kernels at all, the file does not compile (with the compiler's first
        error) or has no such kernel.
    ValueError
        If a macro cannot be passed to every OpenCL compiler.
    """
    kernels: dict[tuple[_Variant, str], Any] = _local.__dict__.setdefault("kernels", {})
    variant = _Variant(device, file, _digest(file), (*_options(defines), *build_options()))
    if (variant, name) not in kernels:
        with _lock:
            _check_once(device)
            kernels[variant, name] = _fetch(variant, name)
    return kernels[variant, name]


def source_digest(file: str) -> str:
    """Digest of a .cl file, every file that it includes, directly or not, and ``build_options``."""
    return _digest(file)


def builds(device: Device) -> list[Build]:
    """The variants built on ``device`` in this process, in order."""
    with _lock:
        return [build for build in _builds if build.device is device]


def check_structs(device: Device, table: Sequence[structs.Struct] = ()) -> None:
    """Assert on the device that structs are laid out as numpy lays them out.

    Parameters
    ----------
    device : Device
        Where to check.
    table : sequence of Struct
        Instead of the whole table.

    Raises
    ------
    DeviceError
        Naming the first size or offset that differs.
    """
    expected = structs.layout(table)
    with _lock:
        prologue = structs.declarations(table)
        _, check = _kernel_of(device, "check_structs.cl", (), prologue, "check_structs")
        found = _run_check(device, check, len(expected))
    for (what, size), reported in zip(expected, found, strict=True):
        if size != reported:
            raise DeviceError(
                f"{device.label}: {what} is {reported} bytes on the device and {size} in numpy; "
                "reorder the struct's members in clgrid/structs.py"
            )


def _run_check(device: Device, check: Any, count: int) -> list[int]:
    cl = registration.opencl()
    found = np.zeros(count, np.uint32)
    buffer = cl.Buffer(device.context, cl.mem_flags.WRITE_ONLY, found.nbytes)
    check(device.queue, (1,), (1,), buffer)
    cl.enqueue_copy(device.queue, found, buffer)
    return [int(value) for value in found]


def _check_once(device: Device) -> None:
    """``check_structs`` before a device's first program; remembered on disk per driver and struct table."""
    if device in _checked:
        return
    facts = device.description
    source = (source_folder() / "check_structs.cl").read_text(encoding="utf-8")
    name = "structs-" + cache.key(
        facts.platform_version, facts.name, facts.driver_version, structs.declarations(), source
    )
    if cache.load(name) is None:
        check_structs(device)
        cache.store(name, {"driver": facts.driver_version})
    _checked.add(device)


def _fetch(variant: _Variant, name: str) -> Any:
    """The kernel of a variant, which is built if it is new."""
    known = _programs.get(variant)
    program, found = _kernel_of(
        variant.device, variant.file, variant.options, structs.declarations(), name, known
    )
    if known is None:
        foreign = variant.digest if _folder_of(variant.file) != own_source_folder() else ""
        _builds.append(Build(variant.device, variant.file, variant.options, foreign))
    _programs[variant] = program
    return found


def _kernel_of(
    device: Device, file: str, options: Sequence[str], prologue: str, name: str, built: Any = None
) -> tuple[Any, Any]:
    """The program (``built``, if it is already) and its kernel ``name``.

    Raises
    ------
    DeviceError
        If the file does not compile or has no such kernel.
    """
    cl = registration.opencl()
    program = built or _compile(device, file, options, prologue)
    try:
        return program, cl.Kernel(program, name)
    except cl.LogicError as error:
        if "INVALID_KERNEL_NAME" not in str(error) or not device.description.is_pocl:
            raise DeviceError(f"{file} has no kernel {name} on {device.label}: {error}") from error
    # A PoCL that died while it made this program's code left an entry without kernels in its cache.
    # Another source text is another entry.
    salt = f"typedef int clg_again_{os.getpid()}_{time.time_ns()};\n"
    program = _compile(device, file, options, prologue + salt)
    try:
        found = cl.Kernel(program, name)
    except cl.LogicError as error:
        raise DeviceError(f"{file} has no kernel {name} on {device.label}: {error}") from error
    folder = pocl.cache_folder()
    log.warning("PoCL's kernel cache is damaged by an earlier crash: delete the folder %s", folder)
    return program, found


def _compile(device: Device, file: str, options: Sequence[str], prologue: str) -> Any:
    """Build ``file`` behind ``prologue``, its errors reported with the file's own line numbers.

    Raises
    ------
    DeviceError
        With the compiler's first error, or if the device cannot build at all.
    """
    _make_ready(device)
    cl = registration.opencl()
    folder = _folder_of(file)
    source = f'{prologue}#line 1 "{file}"\n{(folder / file).read_text(encoding="utf-8")}'
    arguments = ["-I", str(include_folder(folder)), f"-DCLG_SOURCE_HASH=0x{_digest(file)}UL", *options]
    with warnings.catch_warnings():
        # Intel's compiler says that it started and finished, which pyopencl takes for a warning.
        warnings.simplefilter("ignore", cl.CompilerWarning)
        try:
            return cl.Program(device.context, source).build(arguments)
        except cl.Error as error:
            what = _first_error(str(error))
            raise DeviceError(f"{file} does not compile on {device.label}: {what}") from error


def _folder_of(file: str) -> Path:
    """Where a file is taken from: clgrid's own folder, if it and all it includes are the same there.

    The folder's path is part of the keys of drivers' caches.
    """
    folder, own = source_folder(), own_source_folder()
    same = folder != own and (own / file).is_file() and _digest_of(own / file) == _digest(file)
    return own if same else folder


def _make_ready(device: Device) -> None:
    """Before a device's first build: it can build, and its cache holds nothing that breaks it."""
    device.require_usable()
    if device not in _swept:
        if device.description.is_pocl:
            pocl.remove_damaged_entries()
        _swept.add(device)


@functools.cache
def include_folder(folder: Path) -> Path:
    """``folder``, or a link to it if its path has blanks: PoCL splits options there, quoted or not.

    The link stays, since its path is part of the keys of drivers' caches.
    """
    if not re.search(r"\s", str(folder)):
        return folder
    link = cache.folder() / f"cl-{cache.key(folder)}"
    if re.search(r"\s", str(link)) or not cache.link(link, folder):
        link = Path(tempfile.mkdtemp(prefix="clgrid-")) / "cl"
        atexit.register(shutil.rmtree, link.parent, ignore_errors=True)
        link.symlink_to(folder, target_is_directory=True)
    return link


def _options(defines: dict[str, bool | int | str]) -> tuple[str, ...]:
    """``-D`` options in a fixed order.

    Raises
    ------
    ValueError
        If a value would not survive an option string.
    """
    options = []
    for macro, value in sorted(defines.items()):
        text = value if isinstance(value, str) else str(int(value))
        if not macro.isidentifier() or re.search(r"[\s\"'\\]", text):
            raise ValueError(f"-D{macro}={text!r} is not a macro that every OpenCL compiler takes")
        options.append(f"-D{macro}={text}")
    return tuple(options)


@functools.cache
def _digest(file: str) -> str:
    """Digest of ``file``, every file that it includes, directly or not, and ``build_options``."""
    return _digest_of(source_folder() / file)


def _digest_of(source: Path) -> str:
    digest = hashlib.sha256("".join(f"{option}\0" for option in build_options()).encode())
    for path in _reachable(source):
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


def _reachable(path: Path) -> list[Path]:
    """``path`` and the files it includes, each once, in order of first mention.

    Raises
    ------
    DeviceError
        If one of them is not there.
    """
    found: list[Path] = []
    waiting = [path]
    while waiting:
        current = waiting.pop(0)
        if current in found:
            continue
        if not current.is_file():
            raise DeviceError(f"kernel source {current} is missing: reinstall clgrid")
        found.append(current)
        waiting += [current.parent / name for name in _INCLUDE.findall(current.read_text(encoding="utf-8"))]
    return found


def _first_error(message: str) -> str:
    """The compiler's first error line in pyopencl's long message."""
    found = _ERROR.search(message)
    if found:
        return found.group().strip()
    lines = [line.strip() for line in message.splitlines() if line.strip()]
    return lines[0] if lines else "no message"
