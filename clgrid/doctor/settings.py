"""Environment variables: those that help on this machine, and those that are set and do harm.

Only what was measured (docs/guide/devices.md); all others are best left alone.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from clgrid.description import Description
from clgrid.doctor.finding import Finding

# How many threads a driver starts.
_THREADS = {True: "POCL_MAX_PTHREAD_COUNT", False: "CL_CONFIG_CPU_TBB_NUM_WORKERS"}
_CPU_MAX = Path("/sys/fs/cgroup/cpu.max")


def settings(description: Description) -> Iterator[Finding]:
    """What to set or unset for a CPU device of PoCL or Intel."""
    if not (description.is_pocl or description.is_intel_cpu):
        return
    yield from _threads(description)
    if description.is_pocl:
        yield from _work_group_method(description)
        yield from _memory_limit(description)


def processors() -> int:
    """How many this process may use at once: by its affinity, and by the quota of its control group."""
    allowed = len(os.sched_getaffinity(0))
    try:
        quota, period = _CPU_MAX.read_text(encoding="utf-8").split()[:2]
    except (OSError, ValueError):
        return allowed
    return allowed if quota == "max" else min(allowed, max(1, round(int(quota) / int(period))))


def _threads(description: Description) -> Iterator[Finding]:
    variable, usable = _THREADS[description.is_pocl], processors()
    value = os.environ.get(variable, "")
    if value.isdecimal() and 0 < int(value) < usable:
        message = f"{variable}={value} leaves {usable - int(value)} of {usable} processors idle"
        yield Finding("settings", "warn", description.label, message, f"unset {variable}")
    elif not value and usable < description.compute_units:
        message = f"starts {description.compute_units} threads, but this process may use {usable} processors"
        yield Finding("settings", "warn", description.label, message, f"export {variable}={usable}")


def _work_group_method(description: Description) -> Iterator[Finding]:
    method = os.environ.get("POCL_WORK_GROUP_METHOD")
    if method not in (None, "loopvec"):
        message = f"POCL_WORK_GROUP_METHOD={method}: loopvec, which PoCL takes itself, is as fast or faster"
        yield Finding("settings", "warn", description.label, message, "unset POCL_WORK_GROUP_METHOD")


def _memory_limit(description: Description) -> Iterator[Finding]:
    limit = os.environ.get("POCL_MEMORY_LIMIT")
    if limit is not None:
        message = f"POCL_MEMORY_LIMIT={limit} lowers the device's memory; it never raises it"
        yield Finding("settings", "warn", description.label, message, "unset POCL_MEMORY_LIMIT")
