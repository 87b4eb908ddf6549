"""Processes of clgrid: the same clgrid, on some of the processors, and why one ended."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import clgrid


def processors() -> list[int]:
    """Processors that this process may use; empty where the system does not say."""
    return sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []


def run_clgrid(
    arguments: Sequence[str], threads: int | None = None, timeout: float | None = None
) -> subprocess.CompletedProcess[str]:
    """Run ``python -m clgrid`` to its end, on ``threads`` processors.

    Raises
    ------
    subprocess.TimeoutExpired
        After ``timeout`` seconds; the process is ended first.
    """
    # `-m` looks in the current folder first: it has to be the one of the clgrid imported here.
    home = Path(clgrid.__file__).resolve().parent.parent
    limits = {} if threads is None else thread_limits(threads)
    with pinned(threads):
        return subprocess.run(
            [sys.executable, "-m", "clgrid", *arguments],
            cwd=home,
            env={**os.environ, **limits},
            capture_output=True,
            text=True,
            timeout=timeout,
        )


def last_words(done: subprocess.CompletedProcess[str]) -> str:
    """Why a process failed, in one line."""
    if done.returncode < 0:
        cause = " (out of memory?)" if done.returncode == -signal.SIGKILL else ""
        return f"the process was ended by {signal.Signals(-done.returncode).name}{cause}"
    lines = done.stderr.strip().splitlines()
    said = lines[-1].strip().removeprefix("clgrid: error: ") if lines else "it said nothing"
    return f"{said} (exit code {done.returncode})"


@contextmanager
def pinned(threads: int | None) -> Iterator[None]:
    """Let processes started here inherit the first ``threads`` processors only."""
    allowed = processors()
    if not allowed or threads is None:
        yield
        return
    # The calling thread alone is moved; every runtime honours it, and a thread too many only waits.
    os.sched_setaffinity(0, allowed[:threads])
    try:
        yield
    finally:
        os.sched_setaffinity(0, allowed)


def thread_limits(threads: int) -> dict[str, str]:
    """PoCL, old and new, counts processors instead of asking which it may use."""
    return {"POCL_MAX_PTHREAD_COUNT": str(threads), "POCL_CPU_MAX_CU_COUNT": str(threads)}
