"""Plots as SVG within a page: colours come from its style sheet, what is hovered over from its script."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

from clgrid.report.model import BAD, CHOSEN, GOOD, QUIET, Axis, Point, Range, Ranges, Scatter
from clgrid.report.scales import Scale

# Wide for desks, narrow for phones: text keeps its size, so that each has a drawing of its own.
WIDE, NARROW = (1000, 460), (352, 380)
SHAPES = 6
COLOURS = 6
_LINE = 30


def scatter_svg(scatter: Scatter, size: tuple[int, int], name: str) -> str:
    """Draw points, their whiskers and their front; ``name`` is unique on the page."""
    width, height = size
    narrow = size == NARROW
    points = scatter.points
    series, kinds = names(point.series for point in points), names(point.kind for point in points)
    right, top, bottom = width - 16, 40, height - 50
    # Zeros of several series would hide one another.
    still = names(point.series for point in points if not point.y) if scatter.y.log else []
    y = Scale(scatter.y, [*seen(points, "y")], bottom, top, 16 + 14 * len(still))
    left = 18 + round(6.8 * max((len(scatter.y.quantity.text(value)) for value in y.ticks(7)), default=1))
    x = Scale(scatter.x, [*seen(points, "x")], left, right)
    parts = [*_grid_x(x, top, bottom, 5 if narrow else 9), *_grid_y(y, left, right, 7)]
    parts += [_title(scatter.x, (left + right) / 2, height - 10, "middle"), _title(scatter.y, 4, 22, "start")]
    places = [
        (x(p.x), y(p.y) - 14 * (still.index(p.series) - (len(still) - 1) / 2 if y.zero and not p.y else 0))
        for p in points
    ]
    front = front_of([(x(p.x), -y(p.y)) for p in points if p.mark in (GOOD, CHOSEN)])
    parts += [_front([(across, -up) for across, up in front], top, right)]
    outstanding = strong(points)
    ordered = sorted(
        zip(points, places, strict=True), key=lambda each: (each[0].mark == CHOSEN, each[0].mark == GOOD)
    )
    parts += [
        _point(
            point,
            place,
            x,
            y,
            _mark(kinds.index(point.kind), series.index(point.series), *place),
            point not in outstanding,
        )
        for point, place in ordered
    ]
    parts += [
        _chosen_name(point, place, places, left, right) for point, place in ordered if point.mark == CHOSEN
    ]
    return _svg(parts, size, scatter.title, name)


def ranges_svg(ranges: Ranges, size: tuple[int, int], name: str) -> str:
    """Draw a line a row, as high as the rows need."""
    width, narrow = size[0], size == NARROW
    lines = 2 if narrow else 1
    step = _LINE * (1.45 if narrow else 1)
    top = 8.0
    height = top + step * len(ranges.rows) + 52
    left = 16.0 if narrow else min(400.0, 24 + 7.6 * max(len(row.label) for row in ranges.rows))
    values = [value for row in ranges.rows for value in (row.low, row.value, row.high)]
    values += [] if ranges.zero is None else [ranges.zero]
    values += [] if ranges.band is None else list(ranges.band)
    x = Scale(ranges.axis, values, left, width - 22)
    bottom = height - 50
    parts = []
    if ranges.band is not None:
        low, high = map(x, ranges.band)
        parts.append(f'<path class="band" d="M{low:.1f} {top}H{high:.1f}V{bottom:.1f}H{low:.1f}Z"/>')
    parts += [*_grid_x(x, top, bottom, 5 if narrow else 8)]
    if ranges.zero is not None:
        parts.append(f'<path class="zero" d="M{x(ranges.zero):.1f} {top}V{bottom:.1f}"/>')
    parts.append(_title(ranges.axis, (left + width - 22) / 2, height - 10, "middle"))
    series = names(row.series for row in ranges.rows)
    for k, row in enumerate(ranges.rows):
        middle = top + step * (k + 0.5) + (9 if lines == 2 else 0)
        parts.append(_range(row, x, middle, left, narrow, colour_of(row, series)))
    return _svg(parts, (width, round(height)), ranges.title, name, ' data-down="1"')


def colour_of(row: Range, series: Sequence[str]) -> int:
    """Return the number of a line's colour: that of its mark, or of its series."""
    return {GOOD: 0, BAD: 1, QUIET: 5}.get(row.mark, series.index(row.series))


def legend(
    series: Sequence[tuple[str, int]], kinds: Sequence[str] = (), front: bool = False, chosen: bool = False
) -> str:
    """Name colours, given by number, and shapes, in HTML; what is alike for all points is not named."""
    keys = []
    if len(series) > 1:
        keys += [
            f'<li><svg viewBox="-8 -8 16 16" aria-hidden="true">{_mark(0, k, 0, 0)}</svg>{escape(one)}</li>'
            for one, k in series
        ]
    if len(kinds) > 1:
        keys += [
            f'<li><svg viewBox="-8 -8 16 16" aria-hidden="true">{_mark(k, -1, 0, 0)}</svg>{escape(one)}</li>'
            for k, one in enumerate(kinds)
        ]
    if front:
        keys.append(
            '<li><svg viewBox="-8 -8 16 16" aria-hidden="true"><path class="front" d="M-8 -5H0V5H8"/></svg>'
            "front: nothing is better in both</li>"
        )
    if chosen:
        keys.append(
            '<li><svg viewBox="-8 -8 16 16" aria-hidden="true"><circle class="ring" r="6.5"/></svg>'
            "recommended</li>"
        )
    return f'<ul class="legend">{"".join(keys)}</ul>' if keys else ""


def front_of(places: Iterable[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return the places that no other is below and left of, from left to right."""
    front: list[tuple[float, float]] = []
    for place in sorted(set(places)):
        if not front or place[1] < front[-1][1]:
            front.append(place)
    return front


def names(values: Iterable[str]) -> list[str]:
    """Return each name once, in order."""
    return list(dict.fromkeys(values))


def strong(points: Sequence[Point]) -> list[Point]:
    """Return the points that stand out: those marked, or all of them."""
    return [point for point in points if point.mark in (GOOD, CHOSEN)] or [*points]


def seen(points: Sequence[Point], along: str) -> Iterable[float]:
    """What axes must reach: all values, and the whiskers of what stands out."""
    outstanding = strong(points)
    for point in points:
        around = getattr(point, f"{along}_range") if point in outstanding else None
        yield from (getattr(point, along), *(around or ()))


def _svg(parts: Iterable[str], size: tuple[int, int], title: str, name: str, more: str = "") -> str:
    width, height = size
    return (
        f'<svg class="plot" id="{name}" viewBox="0 0 {width} {height}" width="{width}" height="{height}"'
        f' role="group" aria-label="{escape(title)}"{more}>{"".join(parts)}</svg>'
    )


def _grid_x(scale: Scale, top: float, bottom: float, most: int) -> Iterable[str]:
    for value in scale.ticks(most):
        x, text = scale(value), escape(scale.axis.quantity.text(value))
        yield f'<path class="grid" d="M{x:.1f} {top}V{bottom:.1f}"/>'
        yield f'<text class="tick" x="{x:.1f}" y="{bottom + 18:.1f}" text-anchor="middle">{text}</text>'
    if scale.zero:
        yield f'<path class="lane" d="M{scale.lane:.1f} {top}V{bottom:.1f}"/>'
        yield f'<text class="tick" x="{scale.lane:.1f}" y="{bottom + 18:.1f}" text-anchor="middle">0</text>'


def _grid_y(scale: Scale, left: float, right: float, most: int) -> Iterable[str]:
    for value in scale.ticks(most):
        y, text = scale(value), escape(scale.axis.quantity.text(value))
        yield f'<path class="grid" d="M{left} {y:.1f}H{right}"/>'
        yield f'<text class="tick" x="{left - 8}" y="{y + 4:.1f}" text-anchor="end">{text}</text>'
    if scale.zero:
        yield f'<path class="lane" d="M{left} {scale.lane:.1f}H{right}"/>'
        yield f'<text class="tick" x="{left - 8}" y="{scale.lane + 4:.1f}" text-anchor="end">0</text>'


def _title(axis: Axis, x: float, y: float, anchor: str) -> str:
    return f'<text class="axis" x="{x}" y="{y}" text-anchor="{anchor}">{escape(axis.name)}</text>'


def _front(front: Sequence[tuple[float, float]], top: float, right: float) -> str:
    """The steps that bound what none of the points reaches."""
    if len(front) < 2:
        return ""
    path = f"M{front[0][0]:.1f} {top}V{front[0][1]:.1f}"
    for across, down in front[1:]:
        path += f"H{across:.1f}V{down:.1f}"
    return f'<path class="front" d="{path}H{right}"/>'


def _point(point: Point, place: tuple[float, float], x: Scale, y: Scale, mark: str, faint: bool) -> str:
    across, down = place
    parts = []
    if point.x_range is not None:
        low, high = map(x, point.x_range)
        parts.append(f'<path class="whisker" d="M{low:.1f} {down:.1f}H{high:.1f}"/>')
    if point.y_range is not None:
        low, high = map(y, point.y_range)
        parts.append(f'<path class="whisker" d="M{across:.1f} {low:.1f}V{high:.1f}"/>')
    if point.mark == CHOSEN:
        parts.append(f'<circle class="ring" cx="{across:.1f}" cy="{down:.1f}" r="10.5"/>')
    parts.append(mark)
    return _target("".join(parts), across, down, point.label, point.facts, faint)


def _chosen_name(
    point: Point, place: tuple[float, float], places: Sequence[tuple[float, float]], left: float, right: float
) -> str:
    """Beside or above the ring, where it covers the fewest points."""
    across, down = place
    long = 7.8 * len(point.label)
    choices: list[tuple[int, int, float, float]] = []
    for up in (-5.0, 18.0, 34.0, 50.0):
        for first in (across + 16, across - 16 - long, across - long / 2):
            start = min(max(first, left + 4), right - long)
            beside = start > across + 12 or start + long < across - 12
            box = (start - 8, start + long + 8, down - up - 18, down - up + 8)
            covered = sum(box[0] < x < box[1] and box[2] < y < box[3] for x, y in places)
            choices.append((covered + (0 if beside or up > 0 else 100), len(choices), start, down - up))
    _, _, start, base = min(choices)
    return f'<text class="named" x="{start:.1f}" y="{base:.1f}">{escape(point.label)}</text>'


def _range(row: Range, x: Scale, y: float, left: float, narrow: bool, colour: int) -> str:
    low, middle, high = x(row.low), x(row.value), x(row.high)
    mark = f" {row.mark}" if row.mark else ""
    place = f'x="{left}" y="{y - 14:.1f}"' if narrow else f'x="{left - 12}" y="{y + 4:.1f}" text-anchor="end"'
    label = f'<text class="label{mark}" {place}>{escape(_short(row.label, 40 if narrow else 48))}</text>'
    path = f"M{low:.1f} {y:.1f}H{high:.1f}M{low:.1f} {y - 4:.1f}v8M{high:.1f} {y - 4:.1f}v8"
    line = f'<path class="span c{colour % COLOURS}" d="{path}"/>'
    return _target(label + line + _mark(0, colour, middle, y), middle, y, row.label, row.facts)


def _target(
    drawn: str, x: float, y: float, label: str, facts: Sequence[tuple[str, str]], faint: bool = False
) -> str:
    """What can be pointed at or walked to: its label is what is read out and what the hint shows."""
    lines = "\n".join([label, *(f"{name}: {text}" for name, text in facts)])
    return (
        f'<g class="pt{" faint" if faint else ""}" role="img" tabindex="-1" data-x="{x:.1f}" data-y="{y:.1f}"'
        f' aria-label="{escape(lines)}">{drawn}</g>'
    )


def _mark(shape: int, colour: int, x: float, y: float) -> str:
    """One of six shapes of about the same area, at (x, y)."""
    kind = "plain" if colour < 0 else f"c{colour % COLOURS}"
    paths = (
        "M5 0A5 5 0 1 1 -5 0A5 5 0 1 1 5 0Z",
        "M-4.5 -4.5H4.5V4.5H-4.5Z",
        "M0 -6L5.5 4H-5.5Z",
        "M0 -6.5L6 0L0 6.5L-6 0Z",
        "M0 6L5.5 -4H-5.5Z",
        "M-6 -2H-2V-6H2V-2H6V2H2V6H-2V2H-6Z",
    )
    place = f"translate({x:.1f} {y:.1f})"
    return f'<path class="mark {kind}" transform="{place}" d="{paths[shape % SHAPES]}"/>'


def _short(text: str, most: int) -> str:
    return text if len(text) <= most else f"{text[: most - 1]}…"
