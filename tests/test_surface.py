"""The public surface, typed and run as a caller would."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from surface import use

from clgrid.device import Device

HERE = Path(__file__).resolve().parent


def test_the_whole_surface_runs_without_a_warning(tmp_path: Path, device: Device) -> None:
    use(tmp_path, device.label)


@pytest.mark.slow
def test_the_whole_surface_is_typed(tmp_path: Path) -> None:
    from mypy import api

    config = str(HERE.parent / "pyproject.toml")
    options = ["--strict", "--config-file", config, "--cache-dir", str(tmp_path), "--python-executable"]
    said, failed, status = api.run([*options, sys.executable, str(HERE / "surface.py")])
    assert status == 0, said + failed
