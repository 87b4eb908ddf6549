"""What the paper's Figure 1 says of its eleven scenes, as far as it can be derived from its rounded digits.

A. Lagae, P. Dutré, Compact, Fast and Robust Grids for Ray Tracing, Computer Graphics Forum 27(4), 2008.
Measured on a 2007 Xeon, by all appearances on one core. The table holds rates and ratios that were computed
from the printed figures, two or three digits each; everything in seconds or bytes is derived back from them,
except the render times of Lucy and David, which are the paper's own. Nothing else of the paper is known here:
where a number cannot be derived, there is none.
"""

from __future__ import annotations

from dataclasses import dataclass

LABEL = "2007 Xeon, one core"
DENSITY = 4.0
# Its triangles are far from evenly spread.
UNEVEN = "Nature"
RAYS = 1024 * 1024


@dataclass(frozen=True)
class Paper:
    """One column of Figure 1.

    Attributes
    ----------
    triangles : float
        As printed, rounded.
    references : float
        Per triangle, derived from the bytes of the compact grid.
    filled : float
        Share of cells that hold a triangle, derived from the bytes of both grids.
    hashed_bytes : float
        Bytes of the hashed grid over bytes of the compact grid.
    build : dict
        Layout to millions of triangles a second.
    rays : float
        Millions of primary rays a second, compact grid, 1024 x 1024.
    render : dict
        Layout to seconds, where the paper's own number or its ratio to the compact grid is known.
    hashed_time_to_image : float or None
        Over the compact grid's, where only that ratio is known.
    """

    triangles: float
    references: float
    filled: float
    hashed_bytes: float
    build: dict[str, float]
    rays: float
    render: dict[str, float]
    hashed_time_to_image: float | None = None

    def bytes_per_triangle(self, layout: str) -> float | None:
        """Bytes of the grid per triangle: 4 (density + r) for the compact one."""
        compact = 4.0 * (DENSITY + self.references)
        return {"compact": compact, "hashed": compact * self.hashed_bytes}.get(layout)

    def build_s(self, layout: str) -> float | None:
        """Seconds: triangles over the rate."""
        return self.triangles / (self.build[layout] * 1e6) if layout in self.build else None

    def render_s(self, layout: str) -> float | None:
        """Seconds of the 1024 x 1024 picture."""
        if layout in self.render:
            return self.render[layout]
        return RAYS / (self.rays * 1e6) if layout == "compact" else None

    def time_to_image_s(self, layout: str) -> float | None:
        """Seconds of build and render."""
        build, render = self.build_s(layout), self.render_s(layout)
        if build is not None and render is not None:
            return build + render
        compact = None if layout == "compact" else self.time_to_image_s("compact")
        if layout == "hashed" and self.hashed_time_to_image is not None and compact is not None:
            return compact * self.hashed_time_to_image
        return None

    def empty_share(self) -> float:
        """Share of cells without a triangle."""
        return 1.0 - self.filled


def _paper(
    triangles: float,
    references: float,
    filled: float,
    hashed_bytes: float,
    compact_build: float,
    hashed_build: float,
    rays: float,
    render: dict[str, float] | None = None,
    hashed_time_to_image: float | None = None,
) -> Paper:
    build = {"compact": compact_build, "hashed": hashed_build}
    return Paper(triangles, references, filled, hashed_bytes, build, rays, render or {}, hashed_time_to_image)


PAPER: dict[str, Paper] = {
    "Armadillo": _paper(345e3, 2.32, 0.042, 0.42, 6.9, 4.9, 1.17),
    "Atrium": _paper(560e3, 3.07, 0.149, 0.54, 7.0, 5.6, 0.54),
    "Dragon": _paper(871e3, 2.59, 0.067, 0.46, 7.9, 4.6, 1.31),
    "Conference": _paper(988e3, 2.93, 0.113, 0.51, 8.2, 5.2, 0.46),
    "Buddha": _paper(1.09e6, 2.61, 0.085, 0.47, 7.8, 5.0, 1.81),
    # Rendering the hashed grid took 1 % longer than the compact one.
    "Cruiser": _paper(3.64e6, 2.07, 0.077, 0.42, 9.3, 5.1, 0.42, {"hashed": 1.01 * RAYS / 0.42e6}),
    "Asian Dragon": _paper(7.22e6, 1.64, 0.017, 0.33, 9.0, 5.9, 0.73),
    "Thai Statue": _paper(10.0e6, 1.83, 0.024, 0.35, 8.6, 5.7, 0.68),
    "Lucy": _paper(28.1e6, 1.65, 0.017, 0.33, 8.9, 5.9, 0.55, {"compact": 1.90, "hashed": 1.53}),
    # The largest loss in time to image of the hashed grid: 58 %.
    "Nature": _paper(41.4e6, 9.03, 0.173, 0.76, 4.5, 2.0, 0.10, None, 1.58),
    "David": _paper(56.2e6, 1.59, 0.012, 0.32, 9.7, 6.3, 0.60, {"compact": 1.74, "hashed": 1.29}),
}
