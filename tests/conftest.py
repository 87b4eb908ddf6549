"""Fixtures that all tests share: every usable device."""

from __future__ import annotations

import os
import zlib
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from clgrid.description import Description, matching
from clgrid.device import Device, choose, describe_all, usable

# No test judges by the clock: a slow machine is not a fault.
settings.register_profile("clgrid", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("clgrid")


ROOT = Path(__file__).resolve().parent.parent


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--device",
        action="append",
        default=[],
        help="test on this OpenCL device only (index, label or part of a name; may be repeated); "
        "also CLGRID_TEST_DEVICES, separated by commas",
    )


def wanted(config: pytest.Config) -> list[Description]:
    """The devices to test on: the named ones, or every one that clgrid may choose itself."""
    named = config.getoption("--device") or os.environ.get("CLGRID_TEST_DEVICES", "").split(",")
    names = [name.strip() for name in named if name.strip()]
    present = describe_all()
    if not names:
        return [description for description in present if description.implicit]
    chosen: list[Description] = []
    for name in names:
        matches = matching(present, name)
        if not matches:
            raise pytest.UsageError(f"no OpenCL device matches {name!r}: {[d.label for d in present]}")
        chosen += [match for match in matches if match not in chosen]
    return chosen


def _parameters(descriptions: list[Description]) -> list[object]:
    """The devices. The fast part takes the first that works; one that cannot compile is skipped by name."""
    parameters: list[object] = []
    working = 0
    for description in descriptions:
        outcome = usable(description)
        reason = f"{description.label}: {outcome.reason}; {outcome.cure}"
        marks = [] if outcome.ok else [pytest.mark.skip(reason=reason)]
        if outcome.ok and working:
            marks = [pytest.mark.slow]
        working += outcome.ok
        parameters.append(pytest.param(description.label, id=description.label, marks=marks))
    return parameters


# Platforms whose compiler takes 7 s for a kernel that casts, where others take 2: they get no thorough tests.
SLOW_TO_COMPILE = ("Intel(R) OpenCL",)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Deal thorough tests to the devices by name, each case to one; what is the host's runs on the first."""
    working = [description for description in wanted(config) if usable(description).ok]
    labels = [each.label for each in working]
    quick = [each.label for each in working if each.platform not in SLOW_TO_COMPILE] or labels
    elsewhere = [
        item
        for item in items
        if (item.get_closest_marker("thorough") and _is_elsewhere(item, labels, quick))
        or (item.get_closest_marker("host") and _is_elsewhere(item, labels, labels[:1]))
    ]
    if elsewhere:
        config.hook.pytest_deselected(items=elsewhere)
        left = set(elsewhere)
        items[:] = [item for item in items if item not in left]


def _is_elsewhere(item: pytest.Item, labels: list[str], among: list[str]) -> bool:
    """Whether a case on one of the devices is dealt to another, of those among which it may be."""
    callspec = getattr(item, "callspec", None)
    label = callspec.params.get("device") if callspec is not None else None
    if label not in labels:
        return False
    case = item.nodeid.replace(str(label), "")
    return label != among[zlib.crc32(case.encode()) % len(among)]


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "device" in metafunc.fixturenames:
        parameters = _parameters(wanted(metafunc.config))
        # Without any device the tests must fail, not vanish.
        parameters = parameters or [pytest.param(None, id="none")]
        metafunc.parametrize("device", parameters, indirect=True, scope="session")


@pytest.fixture(autouse=True)
def _no_device_of_the_shell(monkeypatch: pytest.MonkeyPatch) -> None:
    """A device that the shell prefers must not change what a test checks."""
    monkeypatch.delenv("CLGRID_DEVICE", raising=False)


@pytest.fixture(scope="session")
def device(request: pytest.FixtureRequest) -> Device:
    """Each device in turn."""
    if request.param is None:
        pytest.fail("no OpenCL device to test on: run clgrid doctor")
    return choose(request.param)


@pytest.fixture(scope="session")
def all_devices(request: pytest.FixtureRequest) -> list[Device]:
    """All usable devices at once, for comparisons; skips where there is only one."""
    labels = [description.label for description in wanted(request.config) if usable(description).ok]
    if len(labels) < 2:
        pytest.skip(f"comparing devices needs two, there is {labels}")
    return [choose(label) for label in labels]
