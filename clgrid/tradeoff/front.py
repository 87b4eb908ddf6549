"""The Pareto front of time, error and bytes, where a time is better only by more than a margin."""

from __future__ import annotations

from collections.abc import Sequence

from clgrid.tradeoff.choose import MARGIN

METHOD = (
    f"in order of error, bytes and seconds, a point is on the front unless one that is there has no more"
    f" error and bytes, takes no more than {MARGIN:.0%} longer, and is better in one of them, in time by"
    f" more than {MARGIN:.0%}"
)


def front(costs: Sequence[float], errors: Sequence[float], nbytes: Sequence[int]) -> list[int]:
    """Numbers of the points on the front, by cost.

    A point is compared with what is on the front, not with what is off it: else a chain of points, each a
    little slower than the next, could push the fastest off.

    Parameters
    ----------
    costs : sequence of float
        Seconds.
    errors : sequence of float
    nbytes : sequence of int
    """
    kept: list[int] = []

    def beats(a: int, b: int) -> bool:
        slower, faster = costs[a] > costs[b] * (1.0 + MARGIN), costs[a] * (1.0 + MARGIN) < costs[b]
        if slower or errors[a] > errors[b] or nbytes[a] > nbytes[b]:
            return False
        return faster or errors[a] < errors[b] or nbytes[a] < nbytes[b]

    for row in sorted(range(len(costs)), key=lambda row: (errors[row], nbytes[row], costs[row], row)):
        if not any(beats(other, row) for other in kept):
            kept.append(row)
    return sorted(kept, key=lambda row: (costs[row], row))
