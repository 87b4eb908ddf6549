"""Which point to take: from costs, errors and bytes to one point, so that two runs take the same.

Errors and bytes are the same in every run; seconds are not. So a time counts as better only by more than a
fixed share: whether intervals overlap would depend on how noisy the run was, and with it the choice. First
the rung is taken, by its errors, then its point. The turns are then drawn anew, with replacement, ``DRAWS``
times, and the point that follows most often is taken: an answer that hangs on one turn loses.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np

from clgrid.rungs import ACCURACIES
from clgrid.tradeoff.turns import F64, Turns

MARGIN = 0.10
"""Times of points of a rung that differ by no more than this share count as equal."""
FAST_PAYS = 0.15
"""The least share of the time that ``fast``, which promises nothing, must save to be taken."""
DRAWS = 400
_FAST = ACCURACIES.index("fast")

METHOD = (
    "the least strict rung that meets the need, but fast only where it saves more than"
    f" {FAST_PAYS:.0%} of the time; of this rung's points within {MARGIN:.0%} of its fastest, the one of"
    " fewest bytes, then of the simpler layout, then of the density nearer to auto's; where only a time is"
    " asked for, of all points that keep to it the one of least error, then of the stricter rung, then as"
    f" before. What follows from most of {DRAWS} bootstrap draws of the turns is recommended"
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
    grid : hashable
        What it has in common with the same layout and density on other rungs; None for nothing.
    """

    strictness: int
    nbytes: int
    simplicity: int = 0
    off_auto: float = 0.0
    error: float = 0.0
    fits: bool = True
    grid: Hashable = None

    @property
    def order(self) -> tuple[float, ...]:
        """Less is preferred among equals of a rung."""
        return (self.nbytes, self.simplicity, self.off_auto)


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
        return min(rows, key=lambda row: _least_error_first(candidates[row], row))
    fastest: dict[int, float] = {}
    for row in rows:
        rung = candidates[row].strictness
        fastest[rung] = min(fastest.get(rung, np.inf), float(costs[row]))
    rung = _rung(fastest)
    equal = [
        row
        for row in rows
        if candidates[row].strictness == rung and costs[row] <= fastest[rung] * (1.0 + MARGIN)
    ]
    return min(equal, key=lambda row: (*candidates[row].order, row))


def _rung(fastest: dict[int, float]) -> int:
    """The rung to take, from the seconds of the fastest point of each that does.

    What a stricter rung takes beside the next is anything from 1.0 to 1.3 (docs/performance.md, "The
    accuracy ladder"), so whatever share were allowed for it, noise would decide on some scene; and it never
    takes less.
    """
    promising = [rung for rung in fastest if rung > _FAST]
    if not promising:
        return _FAST
    saves = _FAST in fastest and fastest[_FAST] < (1.0 - FAST_PAYS) * fastest[min(promising)]
    return _FAST if saves else min(promising)


def _least_error_first(one: Candidate, row: int) -> tuple[float, ...]:
    return (one.error, -one.strictness, *one.order, row)


def choose(
    turns: Turns,
    candidates: Sequence[Candidate],
    most: float | None = None,
    *,
    least_error: bool = False,
    seed: int = 0,
    among: Sequence[int] | None = None,
) -> Choice:
    """The point that follows from most draws of the turns; of several, the one that all turns speak for.

    Parameters
    ----------
    turns : Turns
    among : sequence of int, optional
        The points that may be taken; by default all. One that had few turns can be the fastest by chance.
    candidates, most, least_error
        As of ``choose_by``.
    seed : int
        Of the draws.
    """
    out = np.ones(len(candidates), np.bool_)
    out[slice(None) if among is None else list(among)] = False
    wins, costs_of_all = np.zeros(len(candidates)), np.where(out, np.nan, turns.medians())
    whole = choose_by(costs_of_all, candidates, most, least_error=least_error)
    for costs in np.where(out, np.nan, turns.resampled(DRAWS, seed)):
        found = choose_by(costs, candidates, most, least_error=least_error)
        if found is not None:
            wins[found] += 1
    wins /= DRAWS
    # What is taken keeps to the limit by all turns, too.
    limit = np.inf if most is None else most
    kept = np.flatnonzero(costs_of_all <= limit).tolist()
    ranked = sorted(kept, key=lambda row: (-wins[row], row != whole, row))
    if whole is None:
        return Choice(None, 1.0 - float(wins.sum()), None, wins)
    others = [row for row in np.flatnonzero(wins).tolist() if row != ranked[0]]
    rival = max(others, key=lambda row: wins[row], default=None)
    return Choice(ranked[0], float(wins[ranked[0]]), rival, wins)
