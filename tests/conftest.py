"""Fixtures that all tests share: every usable device, and the folder of real scenes."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from clgrid.device import Device, choose, describe_all, usable

ROOT = Path(__file__).parent.parent


def usable_labels() -> list[str]:
    """Devices to test on: the one that CLGRID_DEVICE names, or every one that clgrid may choose itself."""
    if os.environ.get("CLGRID_DEVICE"):
        return [choose().label]
    return [found.label for found in describe_all() if found.implicit and usable(found).ok]


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "device" in metafunc.fixturenames:
        none = pytest.param(None, marks=pytest.mark.skip(reason="no usable OpenCL device"))
        metafunc.parametrize("device", usable_labels() or [none], indirect=True, scope="session")


@pytest.fixture(scope="session")
def device(request: pytest.FixtureRequest) -> Device:
    """Each usable device in turn."""
    return choose(request.param)


@pytest.fixture(scope="session")
def all_devices() -> list[Device]:
    """All usable devices at once, for comparisons; skips where there is only one."""
    labels = usable_labels()
    if len(labels) < 2:
        pytest.skip(f"comparing devices needs two, there is {labels}")
    return [choose(label) for label in labels]


@pytest.fixture(scope="session")
def scenes() -> Path:
    """The folder of real meshes: CLGRID_SCENES, or shared/scenes beside the checkout."""
    folder = Path(os.environ.get("CLGRID_SCENES") or ROOT.parent / "shared" / "scenes")
    if not folder.is_dir():
        pytest.skip(f"no real scenes in {folder}; set CLGRID_SCENES")
    return folder
