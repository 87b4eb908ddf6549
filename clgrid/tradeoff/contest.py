"""Points measured in turns: repetitions go to those that may still be recommended, by successive halving.

All points have a turn, and those of grids that are slow on every rung no more; the others have a few, then
the better half has a few more, and so on, until few are left, and those have turns until the choice stands or
the time is over (Karnin, Koren, Somekh 2013). Within a turn the order is drawn anew, so that no point always
follows the same one.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable, Sequence

import numpy as np

from clgrid.tradeoff.choose import Candidate, Choice, choose
from clgrid.tradeoff.turns import Turns

Clock = Callable[[], float]
Progress = Callable[[str, float | None], None]

HOPELESS = 2.5
"""A grid that takes so many times as long as the fastest, on every rung, has one turn."""
TURNS = 3
"""Of each stage between the first and the last, where time allows."""
FEW = 8
"""Points that the halving leaves."""
OF_RUNG = 2
"""The fastest of each rung that stay beside them, to choose the rung by and to be named for comparison."""
MOST_TURNS, FEWEST_LAST_TURNS = 60, 15
"""Of the last stage."""
ENOUGH = 0.99
"""Support at which a choice stands."""

METHOD = (
    f"a turn of all points; of those whose grid takes less than {HOPELESS:g} times the fastest on some rung"
    f" {TURNS} turns, {TURNS} of their better half, and so on; the last {FEW}, and the {OF_RUNG} fastest of"
    f" each rung, have {FEWEST_LAST_TURNS} to {MOST_TURNS}, until {ENOUGH:.0%} of the draws agree"
)
# How much slower than the limit a point may be and still be worth a turn.
_NEAR = 1.25
_LOOK_EVERY = 5


class Contest:
    """Measures points and chooses one.

    Parameters
    ----------
    candidates : sequence of Candidate
    measure : callable
        Measures a point once and returns its cost, in seconds.
    most : float, optional
    least_error : bool
        As of ``choose``.
    seed : int
        Of orders and draws.
    clock : callable
        What time it is, in seconds.
    """

    def __init__(
        self,
        candidates: Sequence[Candidate],
        measure: Callable[[int], float],
        most: float | None = None,
        *,
        least_error: bool = False,
        seed: int = 0,
        clock: Clock = time.perf_counter,
        progress: Progress = lambda step, share: None,
    ) -> None:
        self.candidates = candidates
        self.turns = Turns(len(candidates))
        self._measure = measure
        self._most = most
        self._least_error = least_error
        self._seed = seed
        self._clock = clock
        self._progress = progress

    def run(self, seconds: float) -> Choice:
        """Take turns for about so long, at least one of each stage, and choose."""
        start = self._clock()
        self._turn(range(len(self.candidates)), 0)
        contenders, stage = self._hopeful(), 1
        most = FEW + OF_RUNG * len({each.strictness for each in self.candidates})
        while len(contenders) > most:
            # Each stage of half the points may take half of the time that is left.
            now = self._clock()
            self._stage(contenders, stage, now + (start + seconds - now) / 2)
            contenders, stage = self._better_half(contenders), stage + 1
        self._last_stage(contenders, stage, start + seconds)
        return self._choice(contenders)

    def _hopeful(self) -> list[int]:
        """Points of grids that are not slow on all rungs; of one that was tried once nothing is known yet."""
        fastest: dict[int, float] = {}
        for one, seconds in zip(self.candidates, self.turns.costs[0], strict=True):
            fastest[one.strictness] = min(fastest.get(one.strictness, np.inf), float(seconds))
        ratios: dict[Hashable, list[float]] = {}
        for one, seconds in zip(self.candidates, self.turns.costs[0], strict=True):
            ratios.setdefault(one.grid, []).append(float(seconds) / fastest[one.strictness])
        slow = {grid for grid, found in ratios.items() if len(found) > 1 and min(found) > HOPELESS}
        return [row for row, one in enumerate(self.candidates) if one.grid not in slow]

    def _choice(self, among: Sequence[int]) -> Choice:
        return choose(
            self.turns,
            self.candidates,
            self._most,
            least_error=self._least_error,
            seed=self._seed,
            among=among,
        )

    def _turn(self, contenders: Sequence[int], stage: int) -> None:
        number = len(self.turns.costs)
        costs = np.full(len(self.candidates), np.nan)
        for row in np.random.default_rng([self._seed, 3, number]).permutation(contenders).tolist():
            self._progress(f"turn {number + 1}, {len(contenders)} points", None)
            costs[row] = self._measure(row)
        self.turns.add(costs, stage)

    def _stage(self, contenders: Sequence[int], stage: int, until: float) -> None:
        taken = 0.0
        for turn in range(TURNS):
            began = self._clock()
            # Another one like the last must fit.
            if turn and began + taken > until:
                return
            self._turn(contenders, stage)
            taken = self._clock() - began

    def _last_stage(self, contenders: Sequence[int], stage: int, until: float) -> None:
        for turn in range(MOST_TURNS):
            looked_at = turn >= FEWEST_LAST_TURNS and turn % _LOOK_EVERY == 0
            if (turn and self._clock() > until) or (looked_at and self._choice(contenders).support >= ENOUGH):
                return
            self._turn(contenders, stage)

    def _better_half(self, contenders: list[int]) -> list[int]:
        """The half that is nearer to being recommended, and the fastest of each rung."""
        # By the best turn of each: of three, two may have met something that is no fault of the point.
        costs, wins = np.nanmin(self.turns.evened(), axis=0), self._choice(contenders).wins

        def rank(row: int) -> tuple[float, ...]:
            one = self.candidates[row]
            if self._least_error and self._most is not None:
                near = costs[row] <= self._most * _NEAR
                return (-wins[row], not one.fits, not near, one.error, -one.strictness, *one.order, row)
            return (-wins[row], not one.fits, costs[row], row)

        kept = sorted(contenders, key=rank)[: max(FEW, len(contenders) // 2)]
        for rung in {each.strictness for each in self.candidates}:
            of_rung = [row for row in contenders if self.candidates[row].strictness == rung]
            kept += [row for row in sorted(of_rung, key=lambda row: costs[row])[:OF_RUNG] if row not in kept]
        return sorted(kept)
