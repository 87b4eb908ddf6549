"""PoCL's own ways: its kernel cache, and the processor that the build on PyPI compiles for."""

from __future__ import annotations

import ctypes
import logging
import os
import re
import shutil
import sys
import time
from pathlib import Path
from typing import Any

log = logging.getLogger(__name__)

# The one PoCL on PyPI (pocl-binary-distribution 3.0, of 2022) and where its device struct keeps the name
# of the processor to compile for.
_PYPI_VERSION = "PoCL 3.0-rc2  Linux, Release, RELOC, LLVM 14.0.6"
_PYPI_PROCESSOR_OFFSET = 640
# The processors that PoCL's own distribution builds compile for, by the features they need; best first.
_PROCESSORS = (
    ("skylake-avx512", {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl", "avx2", "fma", "bmi2"}),
    ("haswell", {"avx2", "fma", "bmi1", "bmi2", "f16c", "movbe", "abm"}),
    ("x86-64", set[str]()),
)
# What it compiles for that is renamed: what its LLVM does not know, and what it inlines none of PoCL's own
# functions into. Those are compiled for processors of the list, and to LLVM 14 "znver3" is unlike "haswell"
# in features that only tune, so that every fabs, min and vload is a call.
_RENAMED = {
    "generic": "its LLVM does not know this processor",
    **dict.fromkeys(
        ("znver1", "znver2", "znver3"), "for this processor its LLVM inlines no built-in functions"
    ),
}
# Whatever is younger may be in the making by another process.
_SETTLED_SECONDS = 60.0


def is_pocl(platform_version: str) -> bool:
    """Whether ``CL_PLATFORM_VERSION`` is PoCL's."""
    return "pocl" in platform_version.lower()


def cache_folder() -> Path:
    """Where PoCL keeps compiled kernels: ``$POCL_CACHE_DIR``, else below ``$XDG_CACHE_HOME`` or ~/.cache."""
    own = os.environ.get("POCL_CACHE_DIR")
    if own:
        return Path(own)
    home = os.environ.get("XDG_CACHE_HOME")
    return (Path(home) if home else Path("~/.cache").expanduser()) / "pocl" / "kcache"


def damaged_entries() -> list[Path]:
    """Cache entries that a crash left half written: their kernels are "not found" from then on."""
    damaged = []
    for program in cache_folder().glob("*/*/program.bc"):
        try:
            if _damaged(program):
                damaged.append(program.parent)
        except OSError as error:
            log.debug("%s cannot be read: %s", program, error)
    return sorted(damaged)


def _damaged(program: Path) -> bool:
    """Whether code generation died in this entry, or its program was cut short.

    A launch makes ``<kernel>/<work-group size>/<kernel>.so``; the folder without the file is what a
    crash of the code generator or of the linker leaves.
    """
    variants = [folder for folder in program.parent.glob("*/*") if folder.is_dir()]
    if not variants:
        return _settled(program) and not _whole_bitcode(program.read_bytes())
    return any(_settled(folder) and not any(folder.iterdir()) for folder in variants)


def _settled(path: Path) -> bool:
    return time.time() - path.stat().st_mtime > _SETTLED_SECONDS


def remove_damaged_entries() -> None:
    """Delete what ``damaged_entries`` finds; PoCL compiles those programs anew."""
    for entry in damaged_entries():
        log.warning("deleting %s from PoCL's kernel cache: left damaged by a crash", entry)
        shutil.rmtree(entry, ignore_errors=True)


def _whole_bitcode(content: bytes) -> bool:
    """Whether the top-level blocks of LLVM bitcode add up to the file's length."""
    if content[:4] != b"BC\xc0\xde":
        return False
    at = 4
    while at + 8 <= len(content):
        # A block: two bits ENTER_SUBBLOCK, its id and width padded to a word; its length in words; itself.
        if content[at] & 3 != 1:
            return False
        at += 8 + 4 * int.from_bytes(content[at + 4 : at + 8], "little")
    return at == len(content)


def name_processor(platform: Any, device: Any) -> str:
    """Let the PoCL of PyPI compile for a processor that its LLVM of 2022 does not know or serves badly.

    For one that it does not know it compiles for "generic", which its compiler refuses ("unknown target
    CPU"); for AMD's that it knows, pictures take half as long again; and no option or variable names another.
    PoCL's later builds fall back to the best processor of a short
    list that has no more features than the machine; here the same name is put in the same place. Only
    the one build is touched whose layout is known, and only if the word to change leads to that very name.

    Parameters
    ----------
    platform : pyopencl.Platform
    device : pyopencl.Device

    Returns
    -------
    str
        The processor that the device now compiles for and why, for ``Description.note``; empty if nothing
        was changed.
    """
    known = sys.platform == "linux" and platform.version.find(_PYPI_VERSION) >= 0
    now = device.version.strip().rpartition("-x86_64-unknown-linux-gnu-")[2]
    if not known or now not in _RENAMED:
        return ""
    place = device.int_ptr + _PYPI_PROCESSOR_OFFSET
    name = int.from_bytes(_memory(place, 8), sys.byteorder)
    if _memory(name, len(now) + 1) != now.encode() + b"\0":
        return ""
    processor = _processor()
    # PoCL frees the name with the device, so it must be malloc's.
    libc = ctypes.CDLL(None)
    libc.strdup.restype = ctypes.c_void_p
    ctypes.c_void_p.from_address(place).value = libc.strdup(processor.encode())
    log.debug("%s compiles for %s", device.name, processor)
    return f"compiles for {processor}: {_RENAMED[now]}"


def _memory(address: int, count: int) -> bytes:
    """``count`` bytes of this process at ``address``; empty where nothing can be read."""
    try:
        with open("/proc/self/mem", "rb", buffering=0) as memory:
            memory.seek(address)
            return memory.read(count)
    except (OSError, OverflowError, ValueError):
        return b""


def _processor() -> str:
    """The best processor of the list whose features this machine has."""
    text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    flags = re.search(r"^flags\s*:(.*)$", text, re.MULTILINE)
    features = set(flags.group(1).split()) if flags else set()
    return next(name for name, needed in _PROCESSORS if needed <= features)
