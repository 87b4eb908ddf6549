"""Clocks that tell repetitions which had the processors from those that waited for them."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import TypeVar

Made = TypeVar("Made")

# A repetition is clean that waited for at most this share of its time, and these seconds.
_SHARE, _SLACK = 0.03, 5e-4
_MOST_S = 3.0


def waited() -> float:
    """Seconds that this process's threads have been ready to run and not run; 0 where no one says."""
    nanoseconds = 0
    for path in Path("/proc/self/task").glob("*/schedstat"):
        try:
            nanoseconds += int(path.read_text().split()[1])
        except (OSError, IndexError):
            continue  # the thread has ended, or the system keeps no account
    return nanoseconds * 1e-9


class Timings:
    """Seconds of repetitions by name: the peers in C++ keep the same account."""

    def __init__(self) -> None:
        self._all: dict[str, list[tuple[float, float]]] = {}

    def time(self, name: str, work: Callable[[], Made]) -> Made:
        """Do the work with the clock running."""
        before = waited()
        start = time.perf_counter()
        made = work()
        seconds = time.perf_counter() - start
        self._all.setdefault(name, []).append((seconds, waited() - before))
        return made

    def note(self, name: str, seconds: float) -> None:
        """Take down seconds that were measured or extrapolated elsewhere."""
        self._all.setdefault(name, []).append((seconds, 0.0))

    def clean(self, name: str) -> int:
        """How many repetitions had the processors."""
        return len(self._clean(name))

    def _clean(self, name: str) -> list[float]:
        return [seconds for seconds, delay in self._all[name] if delay <= _SHARE * seconds + _SLACK]

    def value(self, name: str) -> float:
        """Median of the clean repetitions; the least of all where none is clean."""
        clean = self._clean(name)
        return median(clean) if clean else min(seconds for seconds, _ in self._all[name])

    def summary(self) -> dict[str, float]:
        """The value of each name."""
        return {name: self.value(name) for name in self._all}

    def raw(self) -> dict[str, list[float]]:
        """Seconds of all repetitions."""
        return {name: [seconds for seconds, _ in taken] for name, taken in self._all.items()}


def repeat(timings: Timings, repetitions: int, names: tuple[str, ...], work: Callable[[], object]) -> None:
    """Work until so many repetitions of all names are clean, at most four times as often, or for seconds.

    Without repetitions, work once.
    """
    end = time.perf_counter() + _MOST_S
    for turn in range(max(1, 4 * repetitions)):
        work()
        if time.perf_counter() > end:
            return
        if turn + 1 >= repetitions and min(timings.clean(name) for name in names) >= repetitions:
            return
