"""scripts/upstream_trimesh: which tests it counts."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from clgrid.device import Device

trimesh = pytest.importorskip("trimesh")

SCRIPT = Path(__file__).resolve().parent.parent / "scripts" / "upstream_trimesh"


def test_the_script_counts_tests_that_ask_us(tmp_path: Path, device: Device) -> None:
    (tmp_path / "trimesh").symlink_to(Path(trimesh.__file__).parent)
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests" / "test_ray.py").write_text(
        "import trimesh\n"
        "def test_ours():\n"
        "    ray = trimesh.creation.box().ray\n"
        "    assert 'clgrid' in type(ray).__mro__[1].__module__\n"
        "    assert ray.intersects_any([[0, 0, 0]], [[0, 0, 1]])[0]\n"
        "def test_wrong():\n"
        "    assert not trimesh.creation.box().contains([[0, 0, 0]])[0]\n"
        "def test_other():\n"
        "    pass\n"
    )
    command = [sys.executable, str(SCRIPT), str(tmp_path), "--device", device.description.label]
    done = subprocess.run([*command, "--files", "test_ray.py"], capture_output=True, text=True, timeout=300)
    assert done.returncode == 2, done.stderr
    assert "1 of 2 tests that ask clgrid's RayMeshIntersector pass" in done.stdout
    assert "failed: tests/test_ray.py::test_wrong" in done.stdout
    done = subprocess.run([*command, "--files", "test_none.py"], capture_output=True, text=True, timeout=300)
    assert done.returncode == 1
    assert "test_none.py is missing" in done.stderr
