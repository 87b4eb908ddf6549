"""Seconds of points that were measured in turns, with slow moments of the machine taken out.

A turn measures its points one after another, within a second or so, and a moment in which the machine does
something else slows all of them alike. So the logarithm of a time is taken for what the point takes plus what
the turn was like, and both are found by turns as medians (median polish, Tukey 1977): one outlier changes
neither.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

F64 = npt.NDArray[np.float64]

METHOD = (
    "log seconds as point + turn by median polish, so that a slow turn slows no point in particular; medians"
    " and intervals are of what is left"
)
_SWEEPS = 20


@dataclass
class Turns:
    """Costs of points, turn by turn.

    Attributes
    ----------
    points : int
    costs : list of (points,) float64
        Seconds, a turn each; NaN where the point was not measured in it.
    stages : list of int
        Of each turn: turns of one stage measured the same points.
    """

    points: int
    costs: list[F64] = field(default_factory=list)
    stages: list[int] = field(default_factory=list)

    @classmethod
    def of_lists(cls, seconds: Sequence[Sequence[float]]) -> Turns:
        """Of the repetitions of each point, in one stage; the k-th of each are a turn."""
        turns = cls(len(seconds))
        for row in np.array(seconds, np.float64).T:
            turns.add(row, 0)
        return turns

    def add(self, costs: F64, stage: int) -> None:
        """Note a turn."""
        self.costs.append(costs)
        self.stages.append(stage)

    def slowness(self) -> F64:
        """(turns,) by which factor each turn was slower than the middle one."""
        logs = np.log(np.array(self.costs))
        turn = np.zeros(len(logs))
        for _ in range(_SWEEPS):
            point = medians(logs - turn[:, None])
            turn = medians((logs - point).T)
            turn -= np.median(turn)
        slowness: F64 = np.exp(turn)
        return slowness

    def evened(self) -> F64:
        """(turns, points) seconds as if every turn had been like the middle one; NaN where not measured."""
        evened: F64 = np.array(self.costs) / self.slowness()[:, None]
        return evened

    def medians(self) -> F64:
        """(points,) medians of the evened seconds; NaN for a point never measured."""
        return medians(self.evened())

    def resampled(self, count: int, seed: int) -> F64:
        """(count, points) medians of turns drawn anew, with replacement, from each stage.

        Parameters
        ----------
        count : int
        seed : int
            The same turns and seed give the same draws.
        """
        evened, stages = self.evened(), np.array(self.stages)
        rng = np.random.default_rng(seed)
        drawn = [
            rng.choice(np.flatnonzero(stages == stage), size=(count, int(np.sum(stages == stage))))
            for stage in dict.fromkeys(self.stages)
        ]
        return medians(evened[np.concatenate(drawn, axis=1)])


def medians(values: F64) -> F64:
    """(..., points) medians of (..., turns, points), of what is no NaN; NaN where all is."""
    # NaN sort last. numpy's own nanmedian takes twenty times as long.
    ranked, known = np.sort(values, axis=-2), np.isfinite(values).sum(axis=-2, keepdims=True)
    low, high = (
        np.take_along_axis(ranked, np.maximum(place, 0), axis=-2) for place in ((known - 1) // 2, known // 2)
    )
    found: F64 = ((low + high) / 2)[..., 0, :]
    return found
