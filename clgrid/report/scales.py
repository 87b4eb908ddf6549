"""Where values lie along the axes of a plot, and where their ticks are."""

from __future__ import annotations

import math
from collections.abc import Sequence

from clgrid.report.model import Axis

_ROOM = 0.06
# Of ten, in float64.
_POWERS = 307


class Scale:
    """Values along one axis, as pixels.

    On a logarithmic axis values of 0 lie in a lane of their own at its start.

    Parameters
    ----------
    axis : Axis
    values : sequence of float
        All that must be seen.
    start, end : float
        Pixels of the lowest and the highest end.
    lane : float
        Pixels of the lane, if there is one.
    """

    def __init__(
        self, axis: Axis, values: Sequence[float], start: float, end: float, lane: float = 30.0
    ) -> None:
        finite = [value for value in values if math.isfinite(value)]
        seen = [value for value in finite if value > 0] if axis.log else finite
        self.axis = axis
        self.log = axis.log
        self.zero = axis.log and len(seen) < len(finite)
        toward = 1.0 if end > start else -1.0
        self.lane = start + toward * lane / 2
        self.start = start + toward * lane if self.zero else start
        self.end = end
        low, high = (min(seen), max(seen)) if seen else (1.0, 10.0)
        low, high = self._to(low), self._to(high)
        least = 0.25 if self.log else 0.1 * (abs(high) or 1.0)
        room = max(_ROOM * (high - low), (least - (high - low)) / 2)
        # Lengths are compared from 0, where that costs no more than half of the axis.
        self.low = 0.0 if not self.log and 0 <= low <= high / 2 else low - room
        self.high = high + room

    def __call__(self, value: float) -> float:
        """Return where a value lies, in pixels."""
        if self.log and value <= 0:
            return self.lane
        share = (self._to(value) - self.low) / (self.high - self.low)
        return self.start + min(1.0, max(0.0, share)) * (self.end - self.start)

    def ticks(self, most: int) -> list[float]:
        """Return round values within the axis, at most so many, without that of the lane."""
        if not self.log:
            return _even(self.low, self.high, most)
        first, last = max(math.floor(self.low), -_POWERS), min(math.ceil(self.high), _POWERS)
        for digits in ((1.0, 2.0, 5.0), (1.0, 3.0), (1.0,)):
            found = [digit * 10.0**power for power in range(first, last + 1) for digit in digits]
            found = [value for value in found if self.low <= math.log10(value) <= self.high]
            if 3 <= len(found) <= most:
                return found
        if self.high - self.low < 2:
            low, high = 10.0**self.low, 10.0**self.high
            return [value for value in _even(low, high, most) if low <= value <= high]
        step = math.ceil((last - first) / most)
        return [10.0**power for power in range(first, last + 1, step) if self.low <= power <= self.high]

    def _to(self, value: float) -> float:
        return math.log10(value) if self.log else value


def _even(low: float, high: float, most: int) -> list[float]:
    """Multiples of 1, 2 or 5 times a power of ten."""
    rough = (high - low) / max(most, 1)
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(power * digit for digit in (1, 2, 5, 10) if power * digit >= rough)
    return [k * step for k in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)]
