"""The plot of scripts/peers: time to image over that of Embree's best, scene by scene."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from figure1_files import beside
from figure1_plot import NoPlotError
from peers_results import CLGRID, EMBREE, GRID, PYTHON, Result, SceneResult

_COLOURS = ("#d55e00", "#e69f00", "#882255")
_OTHERS = {
    "Embree, default builder, a ray a call": (EMBREE, "med/none/1", "#0072b2", "s"),
    "C++ grid, a ray at a time": (GRID, "compact/rho", "#009e73", "^"),
    "C++ grid, packets": (GRID, "pkt", "#009e73", "v"),
    "Open3D, rays as arrays": (PYTHON, "open3d", "#8d6fb5", "D"),
    "embreex, rays as arrays": (PYTHON, "embreex", "#777777", "x"),
}


def _seconds(result: Result) -> float | None:
    """To the image, or to the nearest hits of its rays."""
    return result.seconds("build", "camera_cast") if result.kind == PYTHON else result.time_to_image


def plot(scenes: Sequence[SceneResult], path: Path, title: str) -> bool:
    """Draw, beside and renamed; False where there is nothing to be relative to.

    Raises
    ------
    NoPlotError
        If matplotlib cannot be imported.
    """
    drawn = sorted((scene for scene in scenes if scene.embrees_best), key=lambda scene: scene.triangles)
    if not drawn:
        return False
    try:
        import matplotlib
    except ImportError as error:
        raise NoPlotError("matplotlib is missing; pip install 'clgrid[plot]'") from error
    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(12, 6.5), layout="constrained")
    names = list(dict.fromkeys(result.name for scene in drawn for result in scene.of(CLGRID)))
    series = [(name, CLGRID, name, colour, "o") for name, colour in zip(names, _COLOURS, strict=False)]
    series += [(label, *of) for label, of in _OTHERS.items()]
    for label, kind, part, colour, marker in series:
        points = []
        for x, scene in enumerate(drawn):
            found = next((each for each in scene.of(kind, part) if _exact(each, kind, part)), None)
            seconds = _seconds(found) if found else None
            if seconds is not None and scene.embrees_best:
                points.append((x, seconds / scene.embrees_best))
        if points:
            size = 9 if kind == CLGRID else 6
            axes.plot(*zip(*points, strict=True), marker, color=colour, markersize=size, label=label)
    axes.axhline(1.0, color="black", linewidth=1.0)
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter("{x:g}")
    axes.set_ylabel("time to image / Embree's best (below 1: sooner)")
    labels = [f"{scene.name}\n{_plain(scene.triangles)}" for scene in drawn]
    axes.set_xticks(range(len(drawn)), labels, rotation=40, ha="right")
    axes.grid(True, axis="y", which="both", color="#dddddd", linewidth=0.6)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    axes.set_title(title, fontsize=10, loc="left")
    figure.legend(loc="outside lower center", ncols=4, frameon=False)
    try:
        with beside(path) as fresh:
            figure.savefig(fresh, dpi=120, format="png")
    finally:
        pyplot.close(figure)
    return True


def _exact(result: Result, kind: str, part: str) -> bool:
    """Names that contain one another are told apart by their end."""
    return result.name == part if kind == PYTHON else kind != EMBREE or result.name.endswith(part)


def _plain(triangles: int) -> str:
    return f"{triangles / 1e6:.1f} M" if triangles >= 1e6 else f"{triangles / 1e3:.0f} K"
