"""What a doctor says: findings, and which rungs a device may run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Status = Literal["ok", "warn", "fail"]


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at.

    Attributes
    ----------
    check : str
        What was looked at: ``fix``, ``pyopencl``, ``icd``, ``intel``, ``platforms``, ``compile``,
        ``processor``, ``fp64``, ``allocation``, ``selftest``, ``settings``, ``cache``, ``install``,
        ``default``.
    status : {"ok", "warn", "fail"}
        ``fail`` where it keeps a device, or a rung of it, from working.
    device : str or None
        Label of the device it concerns.
    message, advice : str
        What was found, and what to do about it (empty if nothing).
    seconds : float or None
        Of the first compile and launch, with empty caches.
    """

    check: str
    status: Status
    device: str | None
    message: str
    advice: str = ""
    seconds: float | None = None


@dataclass(frozen=True)
class Verdict:
    """Whether a device may run a rung of accuracy.

    Attributes
    ----------
    device, rung : str
        Label and name.
    may_run : bool
    why : str
        One clause.
    tested : bool
        Whether the rung's self-test ran, now or before.
    seconds : float or None
        Of the self-test that ran now, the compilation of its kernels included.
    """

    device: str
    rung: str
    may_run: bool
    why: str
    tested: bool = False
    seconds: float | None = None


@dataclass(frozen=True)
class Report:
    """What ``examine`` found.

    Attributes
    ----------
    findings : tuple of Finding
        In the order of the checks.
    usable : tuple of str
        Labels of the devices that compiled and ran a kernel.
    default : str or None
        Label of the device that is used where none is named.
    rungs : tuple of Verdict
        For every device that was looked at and every rung.
    """

    findings: tuple[Finding, ...]
    usable: tuple[str, ...]
    default: str | None
    rungs: tuple[Verdict, ...] = ()
