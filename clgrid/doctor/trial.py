"""Which rungs of accuracy a device may run: the self-test of each, in a child process of its own.

A rung whose driver crashes, hangs or miscompiles is refused, and says nothing of the others.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterator

from clgrid import probe, selftest
from clgrid.description import Description
from clgrid.doctor.finding import Finding, Verdict
from clgrid.errors import ClgridError
from clgrid.rungs import ACCURACIES, LOSSLESS

TIMEOUT_SECONDS = 120.0

_NEVER_TRIED = ("the device compiles no kernel", "the device has no double precision")
_PASSED = "its self-test gives the bits of exact rounding"

Progress = Callable[[str, float | None], None]


def verdicts(
    description: Description, compiled: Finding, *, run: bool, progress: Progress | None
) -> Iterator[Verdict]:
    """One for each rung.

    Parameters
    ----------
    description : Description
    compiled : Finding
        Of its first compile.
    run : bool
        Whether the self-tests run; else what earlier ones found is told.
    progress : callable or None
        Is told which.
    """
    label = description.label
    for rung in ACCURACIES:
        if compiled.status == "fail":
            yield Verdict(label, rung, may_run=False, why=_NEVER_TRIED[0])
        elif not description.fp64:
            yield Verdict(label, rung, may_run=False, why=_NEVER_TRIED[1])
        elif rung not in LOSSLESS:
            yield Verdict(label, rung, may_run=True, why="it promises nothing that a driver could break")
        elif not run:
            yield _remembered(description, rung)
        else:
            if progress is not None:
                progress(f"{label}: self-test of {rung}", None)
            yield attempt(description, rung)


def attempt(description: Description, rung: str, timeout: float = TIMEOUT_SECONDS) -> Verdict:
    """Run the self-test of a strict rung in a child process, and have it remembered."""
    label = description.label
    start = time.perf_counter()
    child = probe.run_child(probe.child_command("clgrid.doctor.trial", label, rung), timeout)
    if child is None:
        why = f"its self-test does not end within {timeout:.0f} s"
        return Verdict(label, rung, may_run=False, why=why, tested=True, seconds=timeout)
    seconds = time.perf_counter() - start
    if child.returncode != 0:
        why = f"its self-test ends the process: {probe.last_words(child.stderr, child.returncode)}"
        return Verdict(label, rung, may_run=False, why=why, tested=True, seconds=seconds)
    fault = json.loads(child.stdout)["fault"]
    return Verdict(label, rung, may_run=not fault, why=fault or _PASSED, tested=True, seconds=seconds)


def _remembered(description: Description, rung: str) -> Verdict:
    fault = selftest.remembered(description, rung)
    if fault is None:
        why = "its self-test has not run yet; the first grid does it"
        return Verdict(description.label, rung, may_run=True, why=why)
    return Verdict(description.label, rung, may_run=not fault, why=fault or _PASSED, tested=True)


def findings(description: Description, found: list[Verdict]) -> Iterator[Finding]:
    """What the verdicts on a device come to, those of one reason together."""
    for why in dict.fromkeys(verdict.why for verdict in found):
        alike = [verdict for verdict in found if verdict.why == why]
        names = ", ".join(_timed(verdict) for verdict in alike)
        if alike[0].may_run:
            yield Finding("selftest", "ok", description.label, f"may run {names}: {why}")
        else:
            untried = alike[0].why in _NEVER_TRIED
            advice = "see above" if untried else "use another device or another version of its driver"
            yield Finding("selftest", "fail", description.label, f"refused for {names}: {why}", advice)


def _timed(verdict: Verdict) -> str:
    return verdict.rung if verdict.seconds is None else f"{verdict.rung} ({verdict.seconds:.1f} s)"


def main(label: str, rung: str) -> None:
    """Run in the child: a rung's self-test on the device of that label; what is wrong as JSON on stdout."""
    from clgrid.device import choose
    from clgrid.grid import require_tested

    device, fault = choose(label), ""
    try:
        require_tested(device, rung, again=True)
    except ClgridError as error:
        fault = selftest.remembered(device.description, rung) or str(error)
    sys.stdout.write(json.dumps({"fault": fault}))
    sys.stdout.flush()
