"""Find out what is wrong with this machine's OpenCL, and say what cures it.

CONTROL FLOW. ``examine`` looks at the ``drivers``, at what each device can (``abilities``) and may run
(``trial``), at the environment variables that matter (``settings``) and at what could be installed
(``installing``); ``repair`` writes the one file that cures a thing. Whatever may crash or hang (loading a
driver, listing devices, compiling, the self-tests) happens in child processes.
"""

from __future__ import annotations

import os
from collections.abc import Sequence

from clgrid import device
from clgrid.description import Description, matching
from clgrid.doctor import abilities, drivers, installing, settings, trial
from clgrid.doctor.finding import Finding, Report, Verdict
from clgrid.errors import DeviceError

__all__ = ["Finding", "Report", "Verdict", "examine"]


def examine(
    selector: str | None = None, *, selftest: bool = True, progress: trial.Progress | None = None
) -> Report:
    """Look at everything that clgrid needs of OpenCL.

    Parameters
    ----------
    selector : str or None
        Compile on the devices it matches only; see `device.choose`. None: on all but simulators.
    selftest : bool
        Whether the self-tests of the strict rungs run; else what earlier ones found is told.
    progress : callable, optional
        Is told what runs.

    Raises
    ------
    DeviceError
        If ``selector`` matches no device.
    """
    findings = [drivers.pyopencl()]
    findings += drivers.icd_files()
    devices: list[Description] = []
    if findings[0].status == "ok":
        listing = drivers.listing()
        findings.append(listing)
        if listing.status == "ok":
            devices = device.describe_all()
    findings += drivers.intel(devices)
    findings += abilities.cache()
    usable: list[str] = []
    rungs: list[Verdict] = []
    for description in _asked_for(devices, selector):
        compiled = abilities.first_compile(description)
        findings += [compiled, *abilities.abilities(description)]
        if compiled.status != "fail" and description.fp64:
            usable.append(description.label)
        found = list(trial.verdicts(description, compiled, run=selftest, progress=progress))
        findings += trial.findings(description, found)
        findings += settings.settings(description)
        rungs += found
    findings += installing.installable(devices)
    choice, default = _default()
    return Report((*findings, choice), tuple(usable), default, tuple(rungs))


def _asked_for(devices: Sequence[Description], selector: str | None) -> list[Description]:
    if selector is None:
        return [description for description in devices if description.implicit]
    matches = matching(devices, selector)
    if devices and not matches:
        labels = ", ".join(description.line() for description in devices)
        raise DeviceError(f"no OpenCL device matches {selector!r}; there are: {labels}")
    return matches


def _default() -> tuple[Finding, str | None]:
    """Which device is used where none is named."""
    named = os.environ.get("CLGRID_DEVICE")
    try:
        chosen = device.choose()
        chosen.require_usable()
    except DeviceError as error:
        advice = "unset CLGRID_DEVICE or correct it" if named else "see the advice above"
        return Finding("default", "fail", None, str(error), advice), None
    how = f"CLGRID_DEVICE={named}" if named else "none named"
    return Finding("default", "ok", chosen.label, f"{chosen.label} is used ({how})"), chosen.label
