"""What a device can: compile, float64, buffers of what size."""

from __future__ import annotations

import os
from collections.abc import Iterator

from clgrid import pocl, probe
from clgrid.description import Description
from clgrid.doctor.finding import Finding

_SLOW_SECONDS = 10.0
# A buffer may take a quarter of memory by the standard; drivers that allow much less surprise.
_SMALL_SHARE = 1 / 8


def cache() -> Iterator[Finding]:
    """Entries of PoCL's kernel cache that a crash left behind."""
    damaged = pocl.damaged_entries()
    if damaged:
        more = f" and {len(damaged) - 1} more" if len(damaged) > 1 else ""
        message = f"PoCL's kernel cache is damaged by an earlier crash: {damaged[0]}{more}"
        yield Finding("cache", "warn", None, message, f"rm -r {pocl.cache_folder()}")


def first_compile(description: Description) -> Finding:
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


def abilities(description: Description) -> Iterator[Finding]:
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
