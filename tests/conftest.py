"""Fixtures: every usable OpenCL device, the folder of real scenes."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from clgrid import device as device_module
from clgrid.device import Description, Device

ROOT = Path(__file__).resolve().parent.parent


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--device",
        action="append",
        default=[],
        help="run tests on this OpenCL device only (index, label or part of a name; may be repeated); "
        "also CLGRID_TEST_DEVICES, separated by commas",
    )


def wanted_devices(config: pytest.Config) -> list[Description]:
    """The devices to test: the named ones, or all but simulators and software rasterisers."""
    names = config.getoption("--device") or os.environ.get("CLGRID_TEST_DEVICES", "").split(",")
    names = [name.strip() for name in names if name.strip()]
    present = device_module.describe_all()
    if not names:
        return [description for description in present if description.implicit]
    chosen: list[Description] = []
    for name in names:
        matches = device_module.matching(present, name)
        if not matches:
            raise pytest.UsageError(f"no OpenCL device matches {name!r}: {[d.label for d in present]}")
        chosen += [match for match in matches if match not in chosen]
    return chosen


def _parameter(description: Description) -> object:
    outcome = device_module.usable(description)
    if outcome.ok:
        return pytest.param(description.label, id=description.label)
    reason = f"{description.label}: {outcome.reason}; {outcome.cure}"
    return pytest.param(description.label, id=description.label, marks=pytest.mark.skip(reason=reason))


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "device" in metafunc.fixturenames:
        parameters = [_parameter(description) for description in wanted_devices(metafunc.config)]
        # Without any device the tests must fail, not vanish.
        parameters = parameters or [pytest.param("none", id="none")]
        metafunc.parametrize("device", parameters, indirect=True, scope="session")


@pytest.fixture(scope="session")
def device(request: pytest.FixtureRequest) -> Device:
    """Each OpenCL device of this machine in turn."""
    if request.param == "none":
        pytest.fail("no OpenCL device to test on: run clgrid doctor")
    return device_module.choose(request.param)


@pytest.fixture(scope="session")
def scenes() -> Path:
    """The folder of real scenes: ``CLGRID_SCENES``, or ``../shared/scenes`` beside the checkout."""
    named = os.environ.get("CLGRID_SCENES")
    folder = Path(named) if named else ROOT.parent / "shared" / "scenes"
    if not folder.is_dir():
        pytest.skip(f"no folder of scenes at {folder}: set CLGRID_SCENES")
    return folder


@pytest.fixture(autouse=True)
def _no_device_setting(monkeypatch: pytest.MonkeyPatch) -> None:
    """A device that the shell prefers must not change what a test checks."""
    monkeypatch.delenv("CLGRID_DEVICE", raising=False)
