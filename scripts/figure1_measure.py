"""Measurements, each a process of its own; what was measured once is kept and not measured again."""

from __future__ import annotations

import functools
import hashlib
import json
import subprocess
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any

from figure1_child import last_words, run_clgrid
from figure1_files import write_text
from figure1_scenes import Ready


@dataclass(frozen=True)
class Settings:
    """What every measurement of a run has in common."""

    device: str
    driver: str
    size: str
    density: str
    repetitions: int
    timeout: float
    records: Path
    fresh: bool


@dataclass(frozen=True)
class Task:
    """One layout of one row on so many processors, the ``round``-th time."""

    row: str
    layout: str
    threads: int
    round: int

    def describe(self) -> str:
        plural = "" if self.threads == 1 else "s"
        return f"{self.row}, {self.layout}, {self.threads} thread{plural}, round {self.round + 1}"


@dataclass
class Measured:
    """All rounds of one layout of one row on so many threads.

    Attributes
    ----------
    rows : list of dict
        A row of ``clgrid bench --json`` each round; empty after a failure.
    failure : str
        Why there is none, in one line.
    """

    row: str
    layout: str
    threads: int
    scene: Ready | None
    rows: list[dict[str, Any]] = field(default_factory=list)
    codes: set[str] = field(default_factory=set)
    failure: str = ""

    def seconds(self, name: str) -> list[float]:
        """Every repetition of every round."""
        return [float(value) for row in self.rows for value in row.get(name, [])]

    def median(self, name: str) -> float | None:
        values = self.seconds(name)
        return median(values) if values else None

    def value(self, name: str) -> Any:
        """A number that is the same in every round, None where the record lacks it."""
        return self.rows[0].get(name) if self.rows else None

    def largest(self, name: str) -> int | None:
        """The largest of all rounds, None where the record lacks it."""
        values = [row[name] for row in self.rows if row.get(name) is not None]
        return max(values) if values else None


def code_digest() -> str:
    """Digest of clgrid's version and sources: what makes a measurement out of date."""
    import clgrid
    from clgrid.program import source_folder

    package = Path(clgrid.__file__).parent
    files = {*package.rglob("*.py"), *source_folder().iterdir()}
    digest = hashlib.sha256(clgrid.__version__.encode())
    for path in sorted(path for path in files if path.is_file()):
        digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()[:12]


@functools.cache
def commit() -> str:
    """The checkout's commit, empty where there is none to ask."""
    asked = ["git", "-C", str(Path(__file__).parent), "rev-parse", "--short", "HEAD"]
    try:
        return subprocess.run(asked, capture_output=True, text=True).stdout.strip()
    except OSError:
        return ""


class Measurer:
    """Runs tasks, or finds what they gave before; counts both."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.measured = 0
        self.kept = 0

    def run(self, task: Task, scene: Ready) -> tuple[dict[str, Any], str]:
        """Return the row of the record and the digest of the code that it is of.

        Raises
        ------
        TaskError
            If the process gave no row.
        """
        code = code_digest()
        facts = self._facts(task, scene, code)
        name = f"{task.row}-{task.layout}-{task.threads}-{task.round}".lower().replace(" ", "-")
        path = self.settings.records / f"{name}-{_short(facts)}.json"
        record = None if self.settings.fresh else _kept(path, facts)
        if record is not None:
            self.kept += 1
        else:
            record = self._measure(task, scene)
            # Code that changed under the measurement belongs to neither digest: it is reported, not kept.
            if code_digest() == code:
                write_text(path, json.dumps({"facts": facts, "commit": commit(), "bench": record}, indent=1))
            self.measured += 1
        # What the whole process held is said once a record, and a record here has one row.
        return {**record["rows"][0], "process_peak_bytes": record.get("process_peak_bytes")}, code

    def _facts(self, task: Task, scene: Ready, code: str) -> dict[str, Any]:
        mine = self.settings
        return {
            "code": code,
            "row": task.row,
            "scene": Path(scene.argument).name,
            "triangles": scene.triangles,
            "layout": task.layout,
            "threads": task.threads,
            "round": task.round,
            "device": mine.device,
            "driver": mine.driver,
            "size": mine.size,
            "density": mine.density,
            "repetitions": mine.repetitions,
        }

    def _measure(self, task: Task, scene: Ready) -> dict[str, Any]:
        mine = self.settings
        arguments = ["bench", scene.argument, "--layout", task.layout, "--density", mine.density, "--size"]
        arguments += [mine.size, "--reps", str(mine.repetitions), "--device", mine.device, "--json"]
        try:
            done = run_clgrid(arguments, task.threads, mine.timeout)
        except subprocess.TimeoutExpired:
            raise TaskError(f"not done after {mine.timeout:g} s (--timeout)") from None
        record = _record(done.stdout)
        if record is None or not record["rows"]:
            reason = record["failures"][0]["error"] if record else last_words(done)
            raise TaskError(reason.replace(scene.argument, Path(scene.argument).name))
        return record


class TaskError(Exception):
    """A measurement that gave nothing; one line."""


def _kept(path: Path, facts: dict[str, Any]) -> dict[str, Any] | None:
    """The record of earlier, if it is of the same facts."""
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return stored["bench"] if stored.get("facts") == facts else None


def _record(text: str) -> dict[str, Any] | None:
    try:
        record = json.loads(text)
    except ValueError:
        return None
    return record if isinstance(record, dict) and "rows" in record and "failures" in record else None


def _short(facts: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()[:10]
