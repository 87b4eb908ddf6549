"""The machine, for records."""

from __future__ import annotations

import os
import platform
import re
from importlib import metadata
from pathlib import Path

from clgrid.record import HostRecord

_PACKAGES = ("numpy", "pyopencl", "OpenImageIO")


def host_record() -> HostRecord:
    """What is known of the machine and of the packages that clgrid stands on."""
    versions = {"Python": platform.python_version()}
    for name in _PACKAGES:
        versions[name] = metadata.version(name)
    affinity = getattr(os, "sched_getaffinity", None)
    return HostRecord(
        processor=_processor(),
        cores=len(affinity(0)) if affinity else os.cpu_count() or 1,
        system=f"{platform.system()} {platform.release()}",
        memory=_memory(),
        versions=versions,
    )


def _processor() -> str:
    file = Path("/proc/cpuinfo")
    text = file.read_text(encoding="utf-8") if file.is_file() else ""
    found = re.search(r"^model name\s*:\s*(.+)$", text, re.MULTILINE)
    return found.group(1).strip() if found else platform.processor() or platform.machine()


def _memory() -> int | None:
    names = getattr(os, "sysconf_names", {})
    if "SC_PHYS_PAGES" not in names:
        return None
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
