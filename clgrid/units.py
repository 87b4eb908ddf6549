"""Durations and sizes as people read them."""

from __future__ import annotations


def seconds(value: float) -> str:
    """Write a duration with three digits: 1.23 s, 45.6 ms."""
    return f"{value:.3g} s" if value >= 1 else f"{1e3 * value:.3g} ms"


def bytes_text(nbytes: float) -> str:
    """``1.2 MB``: three digits or so, decimal units."""
    for unit in ("B", "kB", "MB", "GB"):
        if nbytes < 999.5:
            return f"{nbytes:.3g} {unit}"
        nbytes /= 1000
    return f"{nbytes:.3g} TB"
