"""How surely two lists of times differ.

The median of the times that a run could have taken lies between two of its repetitions, whatever their
distribution (``tradeoff.intervals``). So each run has a band, and the ratio of two medians lies between the
ratios of the bands' ends. Nothing is resampled: the same records give the same answer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from clgrid.tradeoff.intervals import left_out, median_interval

FEW = 4
"""Repetitions below which a band says too little: three of each fall apart by chance once in ten times."""
SAME, SLOWER, FASTER = "same", "slower", "faster"


@dataclass(frozen=True)
class Band:
    """A median, and where that of all times lies with the given confidence; seconds.

    Attributes
    ----------
    confidence : float
        At least ``tradeoff.intervals.CONFIDENCE``, or what so few repetitions give.
    """

    median: float
    low: float
    high: float
    confidence: float
    count: int


@dataclass(frozen=True)
class Change:
    """The ratio of two medians, of the second run to the first, and where it lies.

    Attributes
    ----------
    known : bool
        Whether both runs have repetitions enough to know their noise; else the band is the default's.
    verdict : str
        ``same``, ``slower`` or ``faster``.
    """

    ratio: float
    low: float
    high: float
    known: bool
    verdict: str


def band(times: Sequence[float]) -> Band:
    """Return the narrowest band between order statistics that holds the median as surely as asked.

    Parameters
    ----------
    times : sequence of float
        At least one.
    """
    middle, low, high = median_interval(times)
    return Band(middle, low, high, left_out(len(times))[1], len(times))


def change(first: Sequence[float], second: Sequence[float], threshold: float, unknown: float) -> Change:
    """Compare the times of two runs.

    Parameters
    ----------
    threshold : float
        Changes of the median up to this share do not count, however sure they are.
    unknown : float
        Where a run has fewer than ``FEW`` repetitions, changes up to this share are taken for noise.

    Notes
    -----
    A change counts if the whole band of the ratio lies on one side of 1, and the ratio beyond the threshold.
    """
    one, two = band(first), band(second)
    if not one.low > 0 or not two.low > 0:
        return Change(1.0, 0.0, float("inf"), False, SAME)
    ratio, low, high = two.median / one.median, two.low / one.high, two.high / one.low
    known = min(one.count, two.count) >= FEW
    if not known:
        low, high = min(low, ratio / (1 + unknown)), max(high, ratio * (1 + unknown))
    verdict = SAME
    if low > 1 and ratio > 1 + threshold:
        verdict = SLOWER
    elif high < 1 and ratio < 1 / (1 + threshold):
        verdict = FASTER
    return Change(ratio, low, high, known, verdict)
