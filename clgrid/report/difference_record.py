"""The JSON record of ``clgrid report A.json B.json``."""

from __future__ import annotations

import msgspec

from clgrid.record import DeviceRecord

WORSE, BETTER, OTHER, SAME, UNJUDGED = "worse", "better", "other", "same", "not judged"


class RunRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Where one of the two records comes from.

    Attributes
    ----------
    file : str
    devices : list of DeviceRecord
        All that it measured on.
    """

    file: str
    schema: str
    clgrid: str
    devices: list[DeviceRecord]


class Circumstance(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Something beside the measurements in which the runs differ: a machine, a device, a version, a seed."""

    name: str
    first: str
    second: str


class Finding(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One field of one row in both runs.

    Attributes
    ----------
    row : str
        Names the row, in both.
    field : str
        As in the records; of parts ``field.field``.
    verdict : str
        ``worse``, ``better``; ``other``: changed, and neither; ``same``, within noise if it was timed;
        ``not judged``: a time that caches decide.
    first, second : list of float, or of one str, int, float, bool or None
        Seconds, one entry a repetition, or the value.
    timed : bool
    ratio, low, high : float or None
        Of the medians of times, second to first, and its band.
    noise_known : bool
        Whether the band comes from the repetitions of both; else from the default.
    """

    row: str
    field: str
    verdict: str
    timed: bool
    first: list[float | int | str | bool | None]
    second: list[float | int | str | bool | None]
    ratio: float | None = None
    low: float | None = None
    high: float | None = None
    noise_known: bool = True


class DifferenceRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """``clgrid report A.json B.json --json``.

    Attributes
    ----------
    threshold : float
        Share that a median must have changed by, beyond noise.
    unknown : float
        Share taken for noise where repetitions are too few to tell.
    few : int
        Fewer repetitions than that are too few.
    confidence : float
        Of the band of each run's median, where there are repetitions enough.
    circumstances : list of Circumstance
        Empty for two runs of the same version on the same machine and device.
    matched : int
        Rows that both records have.
    only_first, only_second : list of str
        The others.
    findings : list of Finding
        Of all matched rows.
    """

    schema: str
    clgrid: str
    first: RunRecord
    second: RunRecord
    threshold: float
    unknown: float
    few: int
    confidence: float
    circumstances: list[Circumstance]
    matched: int
    only_first: list[str]
    only_second: list[str]
    findings: list[Finding]
