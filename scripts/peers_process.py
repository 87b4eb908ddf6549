"""Processes of scripts/peers: children that stay, and the peers in C++, which are short."""

from __future__ import annotations

import json
import os
import select
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from figure1_child import pinned, thread_limits

HERE = Path(__file__).resolve().parent


class PeerError(Exception):
    """A peer that cannot be measured; one line."""


def _why(code: int | None, said: str) -> str:
    lines = [line for line in said.strip().splitlines() if line.strip()]
    last = lines[-1].strip()[:160] if lines else "it said nothing"
    return f"{last} (exit code {code})"


class Child:
    """peers_child.py for one library, on so many processors.

    Used as a context: it ends with it.
    """

    def __init__(self, words: Sequence[str], threads: int, timeout: float) -> None:
        self._timeout = timeout
        self._threads = threads
        self._words = [*words, "--threads", str(threads)]
        self._stderr = tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace")  # noqa: SIM115
        self._start()

    def _start(self) -> None:
        with pinned(self._threads):
            self._process = subprocess.Popen(
                [sys.executable, str(HERE / "peers_child.py"), *self._words],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._stderr,
                env={**os.environ, **thread_limits(self._threads)},
            )

    def ask(self, **command: Any) -> dict[str, Any]:
        """Send a command and wait for what it gives.

        Raises
        ------
        PeerError
            If it fails, ends or takes too long; the next command then finds a fresh process.
        """
        if self._process.poll() is not None:
            self._start()
        process = self._process
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            process.stdin.write((json.dumps(command) + "\n").encode())
            process.stdin.flush()
        except BrokenPipeError:
            raise PeerError(_why(process.wait(), self._said())) from None
        if not select.select([process.stdout], [], [], self._timeout)[0]:
            self.close()
            raise PeerError(f"not done after {self._timeout:g} s (--timeout)")
        line = process.stdout.readline()
        if not line:
            raise PeerError(_why(process.wait(), self._said()))
        reply: dict[str, Any] = json.loads(line)
        if "error" in reply:
            raise PeerError(reply["error"])
        return reply

    def _said(self) -> str:
        self._stderr.seek(0)
        return self._stderr.read()

    def close(self) -> None:
        """End the process."""
        process = self._process
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                pipe.close()
        try:
            process.wait(5)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    def __enter__(self) -> Child:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
        self._stderr.close()


def run_json(command: Sequence[str], threads: int, timeout: float) -> dict[str, Any]:
    """Run a peer in C++ to its end; the JSON of its last line.

    Raises
    ------
    PeerError
        If it fails, says no JSON or takes too long.
    """
    try:
        with pinned(threads):
            done = subprocess.run(command, capture_output=True, text=True, timeout=timeout)
        lines = done.stdout.strip().splitlines()
        if done.returncode or not lines:
            raise PeerError(_why(done.returncode, done.stderr))
        reply: dict[str, Any] = json.loads(lines[-1])
    except subprocess.TimeoutExpired:
        raise PeerError(f"not done after {timeout:g} s (--timeout)") from None
    except (OSError, ValueError) as error:
        raise PeerError(str(error)) from None
    return reply


def compile_moving(cpp: Path, program: Path) -> None:
    """Compile the peer for meshes that move, over Embree's of the folder of peers.

    Raises
    ------
    PeerError
        If there is no compiler, or it fails.
    """
    compiler = shlex.split(os.environ.get("CXX", "g++"))
    if shutil.which(compiler[0]) is None:
        raise PeerError(f"{compiler[0]} is missing: no compiler for the sequences")
    flags = ["-O3", "-march=native", "-std=c++20", "-fopenmp", "-DNDEBUG", "-w", "-I", str(cpp / "src")]
    source = str(HERE / "peers_moving.cpp")
    done = subprocess.run(
        [*compiler, *flags, source, "-o", str(program), "-lembree3"], capture_output=True, text=True
    )
    if done.returncode:
        raise PeerError(f"peers_moving.cpp does not compile: {_why(done.returncode, done.stderr)}")
