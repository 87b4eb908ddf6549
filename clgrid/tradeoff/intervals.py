"""How sure a count and a median are, without a model of the noise."""

from __future__ import annotations

import math
from collections.abc import Sequence

CONFIDENCE = 0.95
"""Of every interval and bound that a record holds."""

METHODS = {
    "median": "interval of the median by order statistics (binomial, no model of the noise); so few"
    " repetitions that none reaches the confidence give their least and greatest",
    "rate": "one-sided upper bound of Clopper and Pearson (1934); of a count of zero"
    " 1 - (1 - confidence)^(1/n), about 3/n",
}

_TINY = 1e-300
_MOST_TERMS = 100_000
_HALVINGS = 200


def rate_most(count: int, of: int, confidence: float = CONFIDENCE) -> float:
    """The largest rate at which so few of so many are still seen with a chance of 1 - confidence.

    Parameters
    ----------
    count, of : int
        Seen, of independent trials; nothing tried bounds nothing: 1.
    """
    if count >= of:
        return 1.0
    chance = 1.0 - confidence
    if count == 0:
        return -math.expm1(math.log(chance) / of)
    low, high = count / of, 1.0
    for _ in range(_HALVINGS):
        middle = low / 2 + high / 2
        if middle in (low, high):
            break
        # The chance to see at most so few falls with the rate.
        if 1.0 - incomplete_beta(count + 1, of - count, middle) > chance:
            low = middle
        else:
            high = middle
    return high


def incomplete_beta(a: float, b: float, x: float) -> float:
    """The regularised incomplete beta function I_x(a, b), by its continued fraction (Lentz 1976).

    That of a and b whole is the chance of at least a successes in a + b - 1 trials of rate x.
    """
    if x <= 0.0 or x >= 1.0:
        return float(x >= 1.0)
    # On this side of the mean the fraction converges in about the root of the larger of a and b.
    if x > (a + 1.0) / (a + b + 2.0):
        return 1.0 - incomplete_beta(b, a, 1.0 - x)
    log_front = a * math.log(x) + b * math.log1p(-x) + math.lgamma(a + b) - math.lgamma(a) - math.lgamma(b)
    return math.exp(log_front) / a * _fraction(a, b, x)


def _fraction(a: float, b: float, x: float) -> float:
    value, d = 1.0, 1.0 - (a + b) * x / (a + 1.0)
    c, d = 1.0, 1.0 / (d or _TINY)
    value = d
    for m in range(1, _MOST_TERMS):
        for term in (
            m * (b - m) * x / ((a + 2 * m - 1) * (a + 2 * m)),
            -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1)),
        ):
            d = 1.0 / ((1.0 + term * d) or _TINY)
            c = (1.0 + term / c) or _TINY
            value *= c * d
        if abs(c * d - 1.0) < 1e-15:
            break
    return value


def median_interval(values: Sequence[float], confidence: float = CONFIDENCE) -> tuple[float, float, float]:
    """The median, and the values between which that of all repetitions to come lies.

    Parameters
    ----------
    values : sequence of float
        At least one.

    Returns
    -------
    median, low, high : float
        Order statistics: the narrowest pair, the same number from both ends, that is as sure as asked.
    """
    ranked, n = sorted(values), len(values)
    below, _ = left_out(n, confidence)
    middle = ranked[n // 2] if n % 2 else ranked[n // 2 - 1] / 2 + ranked[n // 2] / 2
    return middle, ranked[below], ranked[n - 1 - below]


def left_out(count: int, confidence: float = CONFIDENCE) -> tuple[int, float]:
    """How many repetitions at each end the interval of their median leaves out, and how sure it then is.

    Of n values, fewer than k lie below the median with the chance of fewer than k heads in n throws (order
    statistics; David and Nagaraja, *Order Statistics*, 7.1).
    """
    outside, below, sure = 0.0, 0, 0.0
    for k in range((count + 1) // 2):
        outside += math.comb(count, k) / 2.0**count
        if k and 2 * outside > 1.0 - confidence:
            break
        below, sure = k, 1.0 - 2 * outside
    return below, sure
