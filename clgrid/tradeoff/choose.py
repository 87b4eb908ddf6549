"""Which point to take: from costs, errors and bytes to one point, so that two runs take the same.

Errors and bytes are the same in every run; seconds are not. So a time counts as better only by more than
``MARGIN``, a fixed share: whether intervals overlap would depend on how noisy the run was, and with it the
choice. Among what counts as equal a fixed order decides. The turns are then drawn anew, with replacement,
``DRAWS`` times, and the point that follows most often is taken: an answer that hangs on one turn loses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clgrid.tradeoff.turns import F64, Turns

MARGIN = 0.10
"""Times that differ by no more than this share count as equal.

Wider than what is left of the noise in a dozen evened turns, and where few ratios lie: ``precise`` takes
1.02 to 1.08 of the time to image of ``robust``, ``exact`` 1.1 and more (docs/performance.md, "The accuracy
ladder").
"""
DRAWS = 400

METHOD = (
    f"of the points that meet the need, those within {MARGIN:.0%} of the fastest count as equal, and the"
    " first by: stricter rung, fewer bytes, simpler layout, density nearer to auto's is taken; where only a"
    " time is asked for, the first of those that keep to it by: less error, then the same order. What follows"
    f" from most of {DRAWS} bootstrap draws of the turns is recommended"
)


@dataclass(frozen=True)
class Candidate:
    """What a choice is made by, beside seconds.

    Attributes
    ----------
    strictness : int
        Place of the rung on the ladder.
    nbytes : int
    simplicity : int
        Place of the layout, the simplest first.
    off_auto : float
        How far the density is from auto's, in doublings.
    error : float
    fits : bool
        Whether it meets what the need says of error and bytes.
    """

    strictness: int
    nbytes: int
    simplicity: int = 0
    off_auto: float = 0.0
    error: float = 0.0
    fits: bool = True

    @property
    def order(self) -> tuple[float, ...]:
        """Less is preferred among equals."""
        return (-self.strictness, self.nbytes, self.simplicity, self.off_auto)


@dataclass(frozen=True)
class Choice:
    """The point taken, and how surely.

    Attributes
    ----------
    point : int or None
        None where no point meets the need.
    support : float
        Share of the draws from which it follows.
    rival : int or None
        What follows from most of the others.
    wins : (points,) float64
        Share of the draws from which each point follows.
    """

    point: int | None
    support: float
    rival: int | None
    wins: F64


def choose_by(
    costs: F64, candidates: Sequence[Candidate], most: float | None = None, *, least_error: bool = False
) -> int | None:
    """The point that follows from one cost a point.

    Parameters
    ----------
    costs : (points,) float64
        Seconds; NaN was not measured, and is not taken.
    candidates : sequence of Candidate
    most : float, optional
        Seconds that the need allows.
    least_error : bool
        Whether error, not time, is what is to be least.
    """
    allowed = np.array([each.fits for each in candidates], np.bool_) & np.isfinite(costs)
    if most is not None:
        allowed &= costs <= most
    rows = np.flatnonzero(allowed).tolist()
    if not rows:
        return None
    if least_error:
        return min(rows, key=lambda row: (candidates[row].error, *candidates[row].order, row))
    fastest = float(costs[rows].min())
    equal = [row for row in rows if costs[row] <= fastest * (1.0 + MARGIN)]
    return min(equal, key=lambda row: (*candidates[row].order, row))


def choose(
    turns: Turns,
    candidates: Sequence[Candidate],
    most: float | None = None,
    *,
    least_error: bool = False,
    seed: int = 0,
) -> Choice:
    """The point that follows from most draws of the turns; of several, the one that all turns speak for.

    Parameters
    ----------
    turns : Turns
    candidates, most, least_error
        As of ``choose_by``.
    seed : int
        Of the draws.
    """
    wins, costs_of_all = np.zeros(len(candidates)), turns.medians()
    whole = choose_by(costs_of_all, candidates, most, least_error=least_error)
    for costs in turns.resampled(DRAWS, seed):
        found = choose_by(costs, candidates, most, least_error=least_error)
        if found is not None:
            wins[found] += 1
    wins /= DRAWS
    # What is taken keeps to the limit by all turns, too.
    kept = [row for row in range(len(wins)) if most is None or costs_of_all[row] <= most]
    ranked = sorted(kept, key=lambda row: (-wins[row], row != whole, row))
    if whole is None:
        return Choice(None, 1.0 - float(wins.sum()), None, wins)
    others = [row for row in np.flatnonzero(wins).tolist() if row != ranked[0]]
    rival = max(others, key=lambda row: wins[row], default=None)
    return Choice(ranked[0], float(wins[ranked[0]]), rival, wins)
