"""Numbers with units, written so that the numbers of a column can be compared."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class Quantity:
    """What a number measures.

    Attributes
    ----------
    scales : tuple of (float, str)
        Units by their size in the base unit, largest first; one for a quantity that is never scaled.
    digits : int
        Significant digits at least.
    whole : bool
        Whether it counts: no digits after the point in the smallest unit.
    """

    scales: tuple[tuple[float, str], ...] = ((1.0, ""),)
    digits: int = 3
    whole: bool = False

    def scale(self, values: Iterable[float]) -> tuple[float, str]:
        """Return the unit, with its size, that suits all values together: that of their middle by size."""
        sizes = sorted(abs(value) for value in values if value and math.isfinite(value))
        return self._unit(sizes[len(sizes) // 2]) if sizes else self.scales[-1]

    def decimals(self, values: Iterable[float], size: float) -> int:
        """Return how many digits after the point a column of values shows in a unit of that size."""
        sizes = sorted(abs(value) / size for value in values if value and math.isfinite(value))
        if not sizes or (self.whole and size == self.scales[-1][0]):
            return 0
        return max(0, min(4, self.digits - 1 - math.floor(math.log10(sizes[len(sizes) // 2]))))

    def write(self, value: float, size: float, decimals: int) -> str:
        """Write a value in a unit of that size, without the unit."""
        shown = value / size
        if not math.isfinite(shown):
            return "∞" if shown > 0 else "-∞" if shown < 0 else "-"
        if not shown:
            return "0"
        if abs(shown) < 0.5 * 10.0**-decimals:
            return _powers(f"{shown:.2g}")
        return f"{shown:,.{decimals}f}"

    def text(self, value: float | None) -> str:
        """Write one value with its unit: ``1.23 ms``; a dash for None."""
        if value is None:
            return "-"
        size, unit = self._unit(abs(value)) if value else self.scales[-1]
        shown = value / size
        whole = (self.whole and size == self.scales[-1][0]) or shown == 0
        number = f"{shown:,.0f}" if whole or 1000 <= abs(shown) < 1e6 else _powers(f"{shown:.{self.digits}g}")
        return f"{number}{'' if unit in ('', '%', '×') else ' '}{unit}"

    def _unit(self, value: float) -> tuple[float, str]:
        # 999.7 ms are 1.00 s.
        fitting = (each for each in self.scales if value >= 0.9995 * each[0])
        return next(fitting, self.scales[-1])


_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def _powers(number: str) -> str:
    """``2.5e-06`` as 2.5×10⁻⁶."""
    front, e, exponent = number.partition("e")
    if not e:
        return number
    power = f"10{str(int(exponent)).translate(_RAISED)}"
    return power if front == "1" else f"{front}×{power}"


SECONDS = Quantity(((1.0, "s"), (1e-3, "ms"), (1e-6, "µs"), (1e-9, "ns")))
BYTES = Quantity(((1e9, "GB"), (1e6, "MB"), (1e3, "kB"), (1.0, "B")), whole=True)
BYTES_EACH = Quantity(((1.0, "B"),))
COUNT = Quantity(whole=True)
NUMBER = Quantity()
PERCENT = Quantity(((1e-2, "%"),))
RATIO = Quantity(((1.0, "×"),))
PER_MILLION = Quantity(((1e-6, "per million"),))
DECIBELS = Quantity(((1.0, "dB"),))
ULPS = Quantity(((1.0, "ulp"),))
MRAYS = Quantity(((1.0, "Mrays/s"),))


def counted(count: int, one: str, many: str = "") -> str:
    """``1 row``, ``2,000 rows``; ``many`` where that is not ``one`` with an s."""
    return f"{count:,} {one if count == 1 else many or one + 's'}"
