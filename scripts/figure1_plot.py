"""The figure: time to image, build time and bytes per triangle over triangles, beside the paper's points."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from figure1_files import beside
from figure1_paper import LABEL, PAPER, UNEVEN, Paper

COLOURS = {"compact": "#0072b2", "hashed": "#d55e00", "linked-list": "#009e73", "dynamic-array": "#8d6fb5"}
_MARKERS = {"compact": "o", "hashed": "s", "linked-list": "^", "dynamic-array": "D"}


class NoPlotError(Exception):
    """matplotlib is not installed."""


def plot(rows: Sequence[dict[str, Any]], path: Path, title: str) -> None:
    """Draw the rows of one thread count to ``path``, beside and renamed.

    Raises
    ------
    NoPlotError
        If matplotlib cannot be imported.
    """
    try:
        import matplotlib
    except ImportError as error:
        raise NoPlotError("matplotlib is missing; pip install 'clgrid[plot]'") from error
    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, 3, figsize=(16, 7.2), layout="constrained")
    panels: list[tuple[str, str, float, Callable[[Paper, str], float | None]]] = [
        ("time to image [s]", "time_to_image_s", 1.0, Paper.time_to_image_s),
        ("build time per triangle [ns]", "build_s", 1e9, _build_per_triangle),
        ("grid bytes per triangle", "bytes_per_triangle", 1.0, Paper.bytes_per_triangle),
    ]
    layouts = [name for name in COLOURS if any(row["layout"] == name for row in rows)]
    for ax, (label, key, scale, of_paper) in zip(axes, panels, strict=True):
        for layout in layouts:
            _draw_paper(ax, layout, of_paper, scale if key == "build_s" else 1.0)
            _draw_measured(ax, rows, layout, key, scale)
        _dress(ax, label)
        _name_rows(ax, rows)
    figure.legend(
        handles=_legend(layouts),
        loc="outside lower center",
        ncols=len(layouts) + 2,
        frameon=False,
        fontsize=11,
    )
    figure.suptitle(title, fontsize=13)
    try:
        with beside(path) as fresh:
            figure.savefig(fresh, dpi=120, format="png")
    finally:
        pyplot.close(figure)


def _build_per_triangle(paper: Paper, layout: str) -> float | None:
    seconds = paper.build_s(layout)
    return None if seconds is None else seconds / paper.triangles


def _draw_measured(ax: Any, rows: Sequence[dict[str, Any]], layout: str, key: str, scale: float) -> None:
    points = []
    for row in rows:
        if row["layout"] == layout and row[key] is not None:
            value = row[key] / row["triangles"] if key == "build_s" else row[key]
            points.append((row["triangles"], value * scale, row["row"]))
    points.sort()
    even = [(x, y) for x, y, name in points if name != UNEVEN]
    style: dict[str, Any] = {"color": COLOURS[layout], "marker": _MARKERS[layout], "zorder": 3}
    # Scenes differ, so that the line only guides the eye; the uneven scene is no point of it.
    ax.plot([x for x, _ in even], [y for _, y in even], color=COLOURS[layout], linewidth=1.0, alpha=0.4)
    ax.plot([x for x, _ in even], [y for _, y in even], linestyle="none", markersize=6.5, **style)
    uneven = [(x, y) for x, y, name in points if name == UNEVEN]
    style |= {"markersize": 10, "markeredgecolor": "black"}
    ax.plot([x for x, _ in uneven], [y for _, y in uneven], linestyle="none", **style)


def _draw_paper(ax: Any, layout: str, of_paper: Callable[[Paper, str], float | None], scale: float) -> None:
    for name, paper in PAPER.items():
        value = of_paper(paper, layout)
        if value is not None:
            ax.plot(
                paper.triangles,
                value * scale,
                marker=_MARKERS[layout],
                markersize=9.5 if name == UNEVEN else 6,
                markerfacecolor="none",
                markeredgecolor=COLOURS[layout],
                alpha=0.65,
                zorder=2,
            )


def _dress(ax: Any, label: str) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_xlim(2.4e5, 9e7)
    ax.set_xlabel("triangles", fontsize=11)
    ax.set_title(label, fontsize=12, loc="left", pad=82)
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_locator(LogLocator(10, subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter(FuncFormatter(_plain))
        axis.set_minor_formatter(NullFormatter())
    ax.grid(True, which="major", color="#dddddd", linewidth=0.7)
    ax.set_axisbelow(True)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)


def _plain(value: float, _position: int) -> str:
    for limit, unit in ((1e6, " M"), (1e3, " K")):
        if value >= limit:
            return f"{value / limit:g}{unit}"
    return f"{value:g}"


def _name_rows(ax: Any, rows: Sequence[dict[str, Any]]) -> None:
    """Write each row's name above the panel, a line down at its number of triangles; none over another."""
    named = sorted({row["triangles"]: row["row"] for row in rows}.items())
    low, high = (math.log10(limit) for limit in ax.get_xlim())
    wanted = [(math.log10(triangles) - low) / (high - low) for triangles, _ in named]
    for (triangles, name), place, x in zip(named, wanted, _apart(wanted, 0.032), strict=True):
        ax.axvline(triangles, color="#eeeeee", linewidth=0.8, zorder=0)
        line = {"arrowstyle": "-", "color": "#bbbbbb", "linewidth": 0.6, "shrinkA": 0, "shrinkB": 0}
        ax.annotate(
            name,
            (place, 1.0),
            (x, 1.035),
            xycoords="axes fraction",
            textcoords="axes fraction",
            arrowprops=line,
            rotation=90,
            ha="center",
            va="bottom",
            fontsize=8.5,
            color="#555555",
        )


def _apart(wanted: Sequence[float], gap: float) -> list[float]:
    """Ascending places moved as little as needed so that neighbours are ``gap`` apart."""
    # Runs that touch are centred on the mean of what their members want.
    runs: list[list[float]] = []
    for place in wanted:
        runs.append([place])
        while len(runs) > 1 and _first(runs[-1], gap) < _first(runs[-2], gap) + gap * len(runs[-2]):
            runs[-2:] = [runs[-2] + runs[-1]]
    return [_first(run, gap) + gap * k for run in runs for k in range(len(run))]


def _first(run: Sequence[float], gap: float) -> float:
    return sum(run) / len(run) - gap * (len(run) - 1) / 2


def _legend(layouts: Sequence[str]) -> list[Any]:
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color=COLOURS[name], marker=_MARKERS[name], label=f"{name}, measured")
        for name in layouts
    ]
    grey: dict[str, Any] = {"linestyle": "none", "marker": "o", "color": "#999999"}
    return [
        *handles,
        Line2D([], [], label=f"{UNEVEN}: the uneven scene", markersize=9, markeredgecolor="black", **grey),
        Line2D([], [], label=f"hollow: the paper's, {LABEL}", markerfacecolor="none", **grey),
    ]
