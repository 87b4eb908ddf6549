"""The process that draws starts early, holds the lock on the records, and is gone when it is not needed."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from clgrid.batch import job, messages, spawn
from clgrid.batch.child import Child
from clgrid.batch.ledger import Ledger
from clgrid.batch.spawn import Spawned, spawned_early
from clgrid.cli import main
from clgrid.device import Device


def is_locked(path: Path) -> bool:
    """Whether somebody has the lock on a file."""
    file = os.open(path, os.O_RDWR)
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(file)
    return False


def noted(name: str, call: Callable[..., Any], order: list[str]) -> Callable[..., Any]:
    """The call, which writes down that it was made."""

    def made(*arguments: Any) -> Any:
        order.append(name)
        return call(*arguments)

    return made


def test_an_error_before_anything_is_drawn_ends_it() -> None:
    kept: list[Spawned] = []
    with suppress(ZeroDivisionError), spawned_early(wanted=True) as spawned:
        assert spawned is not None
        assert spawned.process.poll() is None
        kept.append(spawned)
        raise ZeroDivisionError
    assert kept[0].process.poll() is not None


def test_none_is_started_where_none_is_wanted() -> None:
    with spawned_early(wanted=False) as spawned:
        assert spawned is None


@pytest.mark.host
def test_the_command_line_starts_it_first_and_it_draws(
    device: Device, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    order: list[str] = []
    for module, name in ((spawn, "spawn"), (job, "read_job")):
        monkeypatch.setattr(module, name, noted(name, getattr(module, name), order))
    (tmp_path / "job.toml").write_text("scenes = 3\n")
    with pytest.raises(SystemExit, match="1"):
        main(["batch", str(tmp_path / "job.toml"), "--device", device.label])
    assert "scenes" in capsys.readouterr().err
    (tmp_path / "job.toml").write_text('scenes = ["cube"]\nsize = [8, 8]\noutput = "a.png"\n')
    with pytest.raises(SystemExit, match="0"):
        main(["batch", str(tmp_path / "job.toml"), "--device", device.label, "-q"])
    assert (tmp_path / "a.png").stat().st_size > 0
    assert order == ["spawn", "read_job"] * 2


@pytest.mark.host
def test_it_holds_the_lock_as_long_as_it_lives(device: Device, tmp_path: Path) -> None:
    path = tmp_path / "run.jsonl"
    ledger = Ledger(path)
    child = Child(device.label)
    try:
        assert isinstance(child.event(60), messages.Ready)
        child.hold(ledger.descriptor)
        ledger.close()
        assert is_locked(path), "the child has it too"
        child.kill()
        assert not is_locked(path)
    finally:
        child.kill()
