"""`clgrid render` on every hostile file: a picture, an empty one with a warning, or one line and exit code 1.

Each in 20 s and 2 GiB, without a traceback, and with no half-written picture left behind.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from scenes import shared_file
from test_hostile_load import EMPTY, ERROR, EXPECTED

pytestmark = pytest.mark.slow

MOST_SECONDS = 20
MOST_BYTES = 2 << 30
COMMAND = [sys.executable, "-c", "from clgrid.cli import main; main()", "render"]


# A process counts among its own peak what it was before it became another program. So the test run, which is
# large, starts this small one, whose child is the one that is measured.
LAUNCH = f"""
import resource, subprocess, sys
done = subprocess.run(sys.argv[2:], stdout=subprocess.DEVNULL, timeout={MOST_SECONDS})
peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024
open(sys.argv[1], "w").write(f"{{done.returncode}} {{peak}}")
"""


def run(arguments: list[str], report: Path) -> tuple[int, str, int]:
    """Exit code, stderr and peak resident bytes of ``clgrid render``; killed after MOST_SECONDS."""
    launch = [sys.executable, "-c", LAUNCH, str(report), *COMMAND, *arguments]
    done = subprocess.run(launch, stderr=subprocess.PIPE, text=True)
    assert report.is_file(), f"no end within {MOST_SECONDS} s: {done.stderr[-500:]}"
    code, peak = map(int, report.read_text().split())
    report.unlink()
    return code, done.stderr, peak


def test_the_peak_is_the_childs_own(tmp_path: Path) -> None:
    ballast = bytearray(b"x" * (256 << 20))
    code, _, peak = run(["--help"], tmp_path / "report")
    assert code == 0
    assert peak < len(ballast)


@pytest.mark.parametrize("name", EXPECTED)
def test_a_hostile_file_renders_or_is_refused_in_one_line(name: str, tmp_path: Path) -> None:
    path = shared_file("hostile", name)
    picture = tmp_path / "out.png"
    code, stderr, peak = run([str(path), "-o", str(picture), "--size", "64x64"], tmp_path / "report")
    assert "Traceback" not in stderr
    assert peak < MOST_BYTES
    if code == 0:
        assert any(outcome != ERROR for outcome in EXPECTED[name])
        assert picture.stat().st_size > 0
        assert EXPECTED[name] != (EMPTY,) or "warning" in stderr
    else:
        assert code == 1
        assert ERROR in EXPECTED[name]
        assert len(stderr.splitlines()) == 1
        assert path.name in stderr
    # Nothing but the picture: no temporary file survives success or failure.
    assert sorted(os.listdir(tmp_path)) == (["out.png"] if code == 0 else [])
