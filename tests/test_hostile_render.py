"""`clgrid render` on every hostile file: a picture, an empty one with a warning, or one line and exit code 1.

Each in 20 s and 2 GiB, without a traceback, and with no half-written picture left behind.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path

import pytest
from scenes import shared_file
from test_hostile_load import EMPTY, ERROR, EXPECTED

pytestmark = pytest.mark.slow

MOST_SECONDS = 20
MOST_BYTES = 2 << 30
COMMAND = [sys.executable, "-c", "from clgrid.cli import main; main()", "render"]


def run(arguments: list[str]) -> tuple[int, str, int]:
    """Exit code, stderr and peak resident bytes of ``clgrid render``; killed after MOST_SECONDS."""
    with tempfile.TemporaryFile("w+") as stderr, open(os.devnull, "w") as nothing:
        child = os.posix_spawn(
            COMMAND[0],
            [*COMMAND, *arguments],
            dict(os.environ),
            file_actions=[
                (os.POSIX_SPAWN_DUP2, nothing.fileno(), 1),
                (os.POSIX_SPAWN_DUP2, stderr.fileno(), 2),
            ],
        )
        deadline = time.monotonic() + MOST_SECONDS
        while True:
            done, status, usage = os.wait4(child, os.WNOHANG)
            if done:
                break
            if time.monotonic() > deadline:
                os.kill(child, 9)
                os.wait4(child, 0)
                pytest.fail(f"still running after {MOST_SECONDS} s")
            time.sleep(0.01)
        stderr.seek(0)
        return os.waitstatus_to_exitcode(status), stderr.read(), usage.ru_maxrss * 1024


@pytest.mark.parametrize("name", EXPECTED)
def test_a_hostile_file_renders_or_is_refused_in_one_line(name: str, tmp_path: Path) -> None:
    path = shared_file("hostile", name)
    picture = tmp_path / "out.png"
    code, stderr, peak = run([str(path), "-o", str(picture), "--size", "64x64"])
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
