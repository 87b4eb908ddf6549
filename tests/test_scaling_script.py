"""scripts/scaling: its tables, and lists that it refuses."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from clgrid.device import Device

SCRIPT = Path(__file__).resolve().parent.parent / "scripts" / "scaling"


def run(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, str(SCRIPT), *words], capture_output=True, text=True, timeout=300)


def test_each_table_has_a_row_for_each_number(device: Device) -> None:
    done = run("--triangles", "200,800", "--sizes", "16", "--threads", "1", "--reps", "1", "--starts", "0",
               "--device", device.description.label)  # fmt: skip
    assert done.returncode == 0, done.stderr
    rows = [line.split("|")[1].strip() for line in done.stdout.splitlines() if line.startswith("| ")]
    assert rows == ["triangles", "200", "800", "pixels along a side", "16", "threads", "1"]


def test_empty_lists_leave_tables_out(device: Device) -> None:
    done = run(
        "--triangles=", "--sizes=", "--threads=", "--starts", "0", "--device", device.description.label
    )
    assert done.returncode == 0, done.stderr
    assert "|" not in done.stdout


@pytest.mark.parametrize("words", [("--sizes", "16,x"), ("--triangles", "0"), ("--threads", "100000")])
def test_what_is_no_list_of_counts_is_refused_in_one_line(words: tuple[str, ...]) -> None:
    done = run(*words, "--starts", "0")
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 1
    assert words[0] in done.stderr
