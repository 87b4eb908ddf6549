"""What the pages of all records have in common: where a record comes from, times with their bands."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import PurePath
from statistics import median

from clgrid.record import DeviceRecord, Header, HostRecord
from clgrid.report.model import Cell, Range
from clgrid.report.noise import band
from clgrid.report.quantity import BYTES, SECONDS, counted

BANDS = "Bars reach over the 95% band of the median, or over all repetitions where they are fewer than six."


def facts(record: Header) -> list[tuple[str, str]]:
    """Return machine and versions, as far as the record says them."""
    found = [*of_host(record.host), *of_device(record.device), ("clgrid", record.clgrid)]
    found += [(f"seed of {name}", str(seed)) for name, seed in record.seeds.items()]
    peak = getattr(record, "process_peak_bytes", None)
    if peak is not None:
        found.append(("memory of the process", f"at most {BYTES.text(peak)}"))
    return [*found, *(record.host.versions.items() if record.host else ())]


def of_host(host: HostRecord | None) -> list[tuple[str, str]]:
    """Return what is known of the machine."""
    if host is None:
        return []
    memory = "" if host.memory is None else f", {BYTES.text(host.memory)} of memory"
    return [
        ("machine", f"{host.processor}, {counted(host.cores, 'hardware thread')}{memory}"),
        ("system", host.system),
    ]


def of_device(device: DeviceRecord) -> list[tuple[str, str]]:
    """Return what a driver says of its device."""
    return [("device", device.name), ("driver", device.driver), ("platform", device.platform)]


def repeated(record: Header) -> list[str]:
    """Return the command line that repeats a record, if it says one."""
    return [shlex.join(record.command)] if record.command else []


def named(scene: str) -> str:
    """Return the name of a scene without its folder."""
    return PurePath(scene).name


def timed(times: Sequence[float]) -> Cell:
    """Return the median of times, with its band where the pointer rests."""
    if not times:
        return Cell(None)
    found = band(times)
    low, high = SECONDS.text(found.low), SECONDS.text(found.high)
    count = f"{found.count} repetitions" if found.count > 1 else "one repetition"
    return Cell(found.median, note=f"{low} to {high} ({found.confidence:.0%} band of {count})")


def time_range(
    label: str, times: Sequence[float], series: str = "", more: Sequence[tuple[str, str]] = ()
) -> Range:
    """Return times as a line of a range plot."""
    found = band(times)
    said = [
        ("median", SECONDS.text(found.median)),
        ("band", f"{SECONDS.text(found.low)} to {SECONDS.text(found.high)}, {found.count} repetitions"),
    ]
    return Range(label, found.median, found.low, found.high, series, "", [*said, *more])


def of(part: int | None, whole: int) -> str:
    """``3 of 4,096``; a dash where nothing was asked."""
    return "-" if part is None or not whole else f"{part:,} of {whole:,}"


def faults(part: int | None, whole: int, broken: bool) -> Cell:
    """Return a number of faults among rays, marked where it breaks a promise."""
    return Cell(None if not whole else part, of(part, whole), "bad" if broken and part else "")


def rate(count: int, times: Sequence[float]) -> float | None:
    """Return millions a second, by the median."""
    middle = median(times) if times else 0.0
    return count / middle / 1e6 if middle else None


def joined(parts: Sequence[str]) -> str:
    """``a``, ``a and b``, ``a, b and c``."""
    return " and ".join(filter(None, [", ".join(parts[:-1]), parts[-1]])) if parts else ""
