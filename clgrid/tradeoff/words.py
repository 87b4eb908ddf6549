"""The recommendation in words."""

from __future__ import annotations

from collections.abc import Sequence

from clgrid.tradeoff.choose import MARGIN
from clgrid.tradeoff.intervals import CONFIDENCE
from clgrid.tradeoff.plan import Point, Wish
from clgrid.tradeoff_record import ReferenceCheck, TradeoffRow
from clgrid.units import bytes_text, seconds

_SURE = 0.9


def named(row: TradeoffRow) -> str:
    """``robust, compact, density 1``."""
    return Point(row.accuracy, row.layout, row.density, row.samples).words()


def sentence(
    rows: Sequence[TradeoffRow],
    chosen: int,
    wish: Wish,
    check: ReferenceCheck,
    support: float,
    rival: int | None,
) -> str:
    """What to take, what it takes, how wrong it is, how sure that is, and what the next one would bring."""
    row = rows[chosen]
    parts = [f"{named(row)}: {cost(row.cost_s.median, wish)}, {wrong(row, wish.measure, check)}"]
    beside = _beside(rows, chosen, wish)
    if beside:
        parts.append(beside)
    if support < _SURE and rival is not None:
        parts.append(
            f"a near thing: {100 * support:.0f} % of the draws say so, others {named(rows[rival])}; a quieter"
            " machine or a longer --budget would tell"
        )
    return "; ".join(parts)


def cost(value: float, wish: Wish) -> str:
    """Seconds of a picture, and over how many."""
    if wish.frames == 1:
        return seconds(value)
    return f"{seconds(value)} a picture of {wish.frames:,}" + (", each rebuilt" if wish.rebuild else "")


def wrong(row: TradeoffRow, measure: str, check: ReferenceCheck) -> str:
    """The error of a point by a measure, with its upper bound."""
    if row.accuracy == "exact" and measure in ("pixels", "rays"):
        if not check.rays:
            return "the reference itself, which was not compared with rational arithmetic"
        return (
            f"the reference itself: {check.wrong:,} wrong of {check.rays:,} rays by rational arithmetic"
            f" ({below(check.wrong_most)})"
        )
    if measure == "pixels":
        picture = row.picture
        return _counted(picture.other_triangles, "wrong pixel", picture.pixels, picture.other_share_most)
    if measure == "rays":
        found = next(each for each in row.errors if each.kind == "structured")
        count = found.missed + found.false_hits + found.wrong_triangles
        return _counted(count, "wrong ray", found.rays, row.error_most or 1.0)
    if measure == "rms":
        return f"colours off by {row.picture.rms:.2g} (rms)"
    return f"t off by at most {row.error_most:.2g} scene units where it was compared"


def _counted(count: int, what: str, of: int, most: float) -> str:
    return f"{count or 'no'} {what}{'s' if count > 1 else ''} in {of:,} ({below(most)})"


def below(rate: float) -> str:
    """``below 2.9e-06 at 95 %``."""
    return f"below {rate:.2g} at {100 * CONFIDENCE:.0f} %"


def _beside(rows: Sequence[TradeoffRow], chosen: int, wish: Wish) -> str:
    """What the fastest that is too wrong would save, or else what a stricter rung would cost."""
    row = rows[chosen]
    mine, last = row.cost_s.median, max(each.turns[-1] for each in rows)
    # Others had few turns, and may seem fast by chance.
    rows = [each for each in rows if each.turns[-1] == last]
    faster = [each for each in rows if each.refused == ["error"] and each.cost_s.median * (1 + MARGIN) < mine]
    if faster and not wish.least_error:
        best = min(faster, key=lambda each: each.cost_s.median)
        return (
            f"{_short(best, row)} would save {seconds(mine - best.cost_s.median)} and {_wrongs(best, wish)}"
        )
    stricter = [each for each in rows if each.accuracy == "exact" != row.accuracy]
    if not stricter:
        return ""
    best = min(stricter, key=lambda each: each.cost_s.median)
    return f"exact would take {seconds(best.cost_s.median)} ({_short(best, row)})"


def _short(row: TradeoffRow, beside: TradeoffRow) -> str:
    """The rung, and of layout and density what is another."""
    words = [row.accuracy]
    if row.layout != beside.layout:
        words.append(row.layout)
    if row.density != beside.density:
        words.append(f"density {row.density:g}")
    if row.samples != beside.samples:
        words.append(f"{row.samples} samples")
    return ", ".join(words)


def _wrongs(row: TradeoffRow, wish: Wish) -> str:
    if wish.measure == "pixels":
        count = row.picture.other_triangles
        return f"show another triangle in {count:,} pixel{'s' if count > 1 else ''}"
    name = {"rays": "of the rays", "distance": "of t, scene units", "rms": "of colours, rms"}[wish.measure]
    return f"have an error of {row.error:.2g} {name}"


def nearest(rows: Sequence[TradeoffRow], wish: Wish, check: ReferenceCheck) -> str:
    """What comes nearest where no point meets the need."""
    asked = []
    if wish.allowed_error is not None:
        asked.append(f"{wish.measure} {wish.allowed_error:g}")
    if wish.max_time_s is not None:
        asked.append(seconds(wish.max_time_s))
    if wish.max_memory is not None:
        asked.append(bytes_text(wish.max_memory))
    text = [f"no point keeps to {' and '.join(asked)}"]
    accurate = [row for row in rows if "error" not in row.refused]
    quick = [row for row in rows if "time" not in row.refused]
    if accurate:
        best = min(accurate, key=lambda row: row.cost_s.median)
        text.append(f"within the error the fastest is {named(best)}, {cost(best.cost_s.median, wish)}")
    if quick:
        best = min(quick, key=lambda row: (row.error or 0.0, row.cost_s.median))
        text.append(f"within the time {named(best)} has the least error, {wrong(best, wish.measure, check)}")
    return "; ".join(text)
