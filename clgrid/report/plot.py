"""The plots of a page as a picture file, by matplotlib: the extra ``plot``."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Any

import numpy as np

from clgrid.errors import UnsupportedError
from clgrid.report.heat import palette
from clgrid.report.model import BAD, CHOSEN, GOOD, HeatMap, Page, Ranges, Scatter
from clgrid.report.scales import Scale
from clgrid.report.svg import colour_of, front_of, names, seen, strong

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#b0578d", "#8a7400", "#5b6472")
_SHAPES = "os^DvP"
_INCHES, _DOTS = 9.0, 120
# Heat maps beside one another; more than so many are left to the page.
_ACROSS, _MOST = 3, 6


def load() -> Any:
    """Import matplotlib.

    Raises
    ------
    UnsupportedError
        If it is not installed.
    """
    try:
        import matplotlib
    except ImportError as error:
        raise UnsupportedError("--plot needs matplotlib; pip install 'clgrid[plot]'") from error
    matplotlib.use("Agg")
    return matplotlib


def draw(page: Page, path: Path) -> None:
    """Draw all plots of the page, below one another, to a PNG or SVG; ``path`` says which.

    Raises
    ------
    UnsupportedError
        If matplotlib is not installed.
    """
    matplotlib = load()
    from matplotlib import pyplot

    blocks = [block for section in page.sections for block in section.blocks]
    plots = [block for block in blocks if isinstance(block, (Scatter, Ranges)) and _size(block)]
    maps = [block for block in blocks if isinstance(block, HeatMap)][:_MOST]
    heights = [4.6 if isinstance(plot, Scatter) else 1.4 + 0.28 * len(plot.rows) for plot in plots]
    heights += [2.9] * -(-len(maps) // _ACROSS)
    # Text stays text, and nothing depends on the day.
    options = {"svg.fonttype": "none", "svg.hashsalt": "clgrid", "font.size": 9.0}
    with matplotlib.rc_context(options):
        figure = pyplot.figure(figsize=(_INCHES, sum(heights) + 0.5), layout="constrained")
        grid = figure.add_gridspec(max(1, len(heights)), _ACROSS, height_ratios=heights or [1])
        for k, plot in enumerate(plots):
            axes = figure.add_subplot(grid[k, :])
            if isinstance(plot, Scatter):
                _scatter(axes, plot)
            else:
                _ranges(axes, plot)
        for k, heat in enumerate(maps):
            _heat(figure, figure.add_subplot(grid[len(plots) + k // _ACROSS, k % _ACROSS]), heat)
        figure.suptitle(_plain(page.title), fontsize=12)
        metadata = {"Date": None} if path.suffix.lower() == ".svg" else {}
        try:
            figure.savefig(path, dpi=_DOTS, metadata=metadata)
        finally:
            pyplot.close(figure)


def _size(plot: Scatter | Ranges) -> int:
    return len(plot.points) if isinstance(plot, Scatter) else len(plot.rows)


def _plain(text: str) -> str:
    """Text that matplotlib takes for no formula."""
    return text.replace("$", r"\$")


def _scatter(axes: Any, scatter: Scatter) -> None:
    points = scatter.points
    x, y = (
        Scale(axis, [*seen(points, along)], 0.0, 1.0, 0.07)
        for axis, along in ((scatter.x, "x"), (scatter.y, "y"))
    )
    series, kinds = names(point.series for point in points), names(point.kind for point in points)
    outstanding = strong(points)
    for point in points:
        colour = COLOURS[series.index(point.series) % len(COLOURS)]
        shape = _SHAPES[kinds.index(point.kind) % len(_SHAPES)]
        place = x(point.x), y(point.y)
        whiskers: dict[str, Any] = {"color": "#888888", "linewidth": 0.8, "zorder": 1}
        bold = point in outstanding
        if bold and point.x_range is not None:
            axes.plot([x(value) for value in point.x_range], [place[1]] * 2, **whiskers)
        if bold and point.y_range is not None:
            axes.plot([place[0]] * 2, [y(value) for value in point.y_range], **whiskers)
        axes.plot(*place, shape, color=colour, markersize=6, alpha=1.0 if bold else 0.4, zorder=3)
        if point.mark == CHOSEN:
            axes.plot(*place, "o", markersize=14, markerfacecolor="none", markeredgecolor="black", zorder=4)
            axes.annotate(
                _plain(point.label), place, (0, 12), textcoords="offset points", ha="center", weight="bold"
            )
    front = front_of((x(point.x), y(point.y)) for point in points if point.mark in (GOOD, CHOSEN))
    if len(front) > 1:
        across, up = [at for at, _ in front], [at for _, at in front]
        axes.step([*across, 1.0], [*up, up[-1]], "--", where="post", color="#666666", linewidth=1.0, zorder=2)
    _ticks(axes.xaxis, x)
    _ticks(axes.yaxis, y)
    axes.set(xlim=(0, 1), ylim=(0, 1), xlabel=scatter.x.name, ylabel=scatter.y.name)
    _dress(axes, scatter.title)
    _keys(axes, [(name, k) for k, name in enumerate(series)], kinds)


def _ranges(axes: Any, ranges: Ranges) -> None:
    rows = ranges.rows
    values = [value for row in rows for value in (row.low, row.value, row.high)]
    values += [] if ranges.zero is None else [ranges.zero]
    values += [] if ranges.band is None else [*ranges.band]
    x = Scale(ranges.axis, values, 0.0, 1.0, 0.07)
    if ranges.band is not None:
        axes.axvspan(*map(x, ranges.band), color="#eceff2", zorder=0)
    if ranges.zero is not None:
        axes.axvline(x(ranges.zero), color="black", linewidth=1.0, zorder=1)
    series = names(row.series for row in rows)
    for k, row in enumerate(rows):
        colour = COLOURS[colour_of(row, series) % len(COLOURS)]
        axes.plot([x(row.low), x(row.high)], [k, k], color=colour, linewidth=1.6, zorder=2)
        axes.plot(x(row.value), k, "o", color=colour, markersize=5, zorder=3)
    axes.set_yticks(range(len(rows)), [_plain(row.label) for row in rows])
    for label, row in zip(axes.get_yticklabels(), rows, strict=True):
        label.set_color("#b3261e" if row.mark == BAD else "black")
    _ticks(axes.xaxis, x)
    axes.set(xlim=(0, 1), ylim=(len(rows) - 0.5, -0.5), xlabel=ranges.axis.name)
    _dress(axes, ranges.title)
    colours = {row.series: colour_of(row, series) for row in rows}
    _keys(axes, [*colours.items()], [""])


def _heat(figure: Any, axes: Any, heat: HeatMap) -> None:
    from matplotlib.colors import ListedColormap, PowerNorm

    colours = ListedColormap(palette() / 255.0).with_extremes(bad="#84848c")
    largest = float(np.nanmax(heat.values, initial=0.0)) or 1.0
    shown = axes.imshow(heat.values, cmap=colours, norm=PowerNorm(0.5, 0.0, largest), interpolation="nearest")
    axes.set_xticks([])
    axes.set_yticks([])
    axes.set_title(_plain("\n".join(textwrap.wrap(heat.title, 40))), fontsize=7.5)
    figure.colorbar(shown, ax=axes, location="bottom", shrink=0.8, aspect=30)


def _ticks(axis: Any, scale: Scale) -> None:
    values = scale.ticks(8)
    places, texts = [scale(value) for value in values], [scale.axis.quantity.text(value) for value in values]
    if scale.zero:
        places, texts = [scale.lane, *places], ["0", *texts]
    axis.set_ticks(places, texts)


def _dress(axes: Any, title: str) -> None:
    axes.set_title(_plain(title), loc="left", fontsize=10)
    axes.grid(True, color="#e2e5e9", linewidth=0.7)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def _keys(axes: Any, series: list[tuple[str, int]], kinds: list[str]) -> None:
    from matplotlib.lines import Line2D

    plain: dict[str, Any] = {"linestyle": "none", "markersize": 6}
    keys = [
        Line2D([], [], marker="o", color=COLOURS[k % len(COLOURS)], label=_plain(name), **plain)
        for name, k in series
        if len(series) > 1
    ]
    keys += [
        Line2D([], [], marker=_SHAPES[k % len(_SHAPES)], color="#777777", label=_plain(name), **plain)
        for k, name in enumerate(kinds)
        if len(kinds) > 1
    ]
    if keys:
        axes.legend(handles=keys, loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize=8)
