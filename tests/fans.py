"""Small fans of triangles, each with a ray that meets an edge, a vertex, a plane: for exact arithmetic."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from clgrid.mesh import Mesh

F64 = npt.NDArray[np.float64]

TRIANGLES = 6
"""Of each fan."""
REACH = 8.0
"""Fans lie within [-REACH, REACH] of their site, on each axis."""
SPACING = 128.0
KINDS = (
    "apex", "rim vertex", "spoke", "rim edge", "face", "along spoke", "along rim", "in plane", "axis at apex",
    "start on apex", "start on spoke", "anywhere",
)  # fmt: skip
STYLES = {"integer": 1.0, "float32": 2.0**-20, "float64": 2.0**-48, "scaled": 2.0**-2, "far": 2.0**-8}
"""Of cases, and the grid that their coordinates lie on before they are scaled or moved."""


def nudged(values: F64, rng: np.random.Generator, share: float = 0.05) -> F64:
    """Some values moved to the next double, up or down."""
    way = rng.choice((-np.inf, np.inf), size=values.shape)
    return np.where(rng.random(values.shape) < share, np.nextafter(values, way), values)


@dataclass(frozen=True)
class Fans:
    """Fans about the origin of space, one ray each."""

    corners: F64
    """(N, TRIANGLES, 3, 3)."""
    origins: F64
    """(N, 3)."""
    reaches: F64
    """(N, 3) directions: none of origin + s * reach leaves [-32, 32] for s up to 1.5."""
    kinds: npt.NDArray[np.int64]
    """(N,) index into KINDS."""


def _on_grid(rng: np.random.Generator, limit: int, grid: float, shape: tuple[int, ...]) -> F64:
    steps = round(1 / grid)
    return rng.integers(-limit * steps, limit * steps + 1, shape) / steps


def draw(count: int, rng: np.random.Generator, grid: float) -> Fans:
    """Fans with coordinates that are multiples of ``grid``, a power of two of at most 1.

    A quarter are flat, some have two equal corners or triangles; windings and first corners differ.
    """
    apex = _on_grid(rng, 2, grid, (count, 3))
    spokes = _on_grid(rng, 6, grid, (count, TRIANGLES, 3))
    # Flat: integer combinations of two vectors that are short enough for their sums to stay within reach.
    frame = _on_grid(rng, 1, max(grid, 2.0**-8), (count, 2, 3))
    flat = rng.integers(-3, 4, (count, TRIANGLES, 2)).astype(np.float64) @ frame
    spokes = np.where((rng.random(count) < 0.25)[:, None, None], flat, spokes)
    # A fan of neighbours only goes round the apex once if it is sorted by angle; every second one is.
    angle = np.argsort(np.arctan2(spokes[..., 1], spokes[..., 0]), axis=1)
    round_it = (rng.random(count) < 0.5)[:, None, None]
    spokes = np.where(round_it, np.take_along_axis(spokes, angle[..., None], 1), spokes)
    rim = apex[:, None] + spokes
    equal = rng.random(count) < 0.1
    rim[equal, 1] = rim[equal, 0]
    after = np.roll(rim, -1, axis=1)
    corners = np.stack([np.broadcast_to(apex[:, None], rim.shape), rim, after], axis=2)
    # A copy of a triangle that the ray is aimed at: an equal t, and the lower id wins.
    twin = rng.random(count) < 0.15
    corners[twin, TRIANGLES - 1] = corners[twin, 0]
    order = np.array([[0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1], [2, 1, 0], [1, 0, 2]])
    order = order[rng.integers(6, size=(count, TRIANGLES))]
    corners = np.take_along_axis(corners, order[..., None], axis=2)
    kinds = rng.integers(len(KINDS), size=count)
    origins, reaches = _aimed(kinds, apex, rim[:, 0], after[:, 0], rng, grid)
    return Fans(corners, origins, reaches, kinds)


def _aimed(
    kinds: npt.NDArray[np.int64], a: F64, b: F64, c: F64, rng: np.random.Generator, grid: float
) -> tuple[F64, F64]:
    """Origin and reach of each ray, at something of the triangle (a, b, c)."""
    count = len(kinds)
    anyhow = _on_grid(rng, 16, max(grid, 2.0**-10), (count, 3))
    small = rng.integers(-2, 3, (count, 2)).astype(np.float64)
    within = (small[:, :1] * (b - a) + small[:, 1:] * (c - a)) / 4
    axis = np.eye(3)[rng.integers(3, size=count)] * rng.choice((-4.0, 4.0), size=(count, 1))
    targets = [a, b, (a + b) / 2, (b + c) / 2, (2 * a + b + c) / 4, a, b, (a + b) / 2, a, a, (a + b) / 2, c]
    ways = [anyhow] * 5 + [
        b - a,
        c - b,
        within,
        axis,
        anyhow,
        anyhow,
        _on_grid(rng, 16, 2.0**-10, (count, 3)),
    ]
    target, way = (np.choose(kinds[:, None], choices) for choices in (targets, ways))
    way[(way == 0).all(axis=1)] = (0.0, -1.0, 0.0)
    starts_on = np.isin(kinds, [KINDS.index(kind) for kind in KINDS if kind.startswith("start")])
    return target - np.where(starts_on, 0.0, 1.0)[:, None] * way, way


def _directions(reaches: F64, rng: np.random.Generator) -> tuple[F64, npt.NDArray[np.int64]]:
    """The reaches times powers of two, and these powers; zeros of both signs, a few as good as zero."""
    powers = np.where(rng.random(len(reaches)) < 0.5, 0, rng.integers(-100, 101, len(reaches)))
    dust = np.where(
        rng.random(reaches.shape) < 0.1,
        rng.choice((5e-324, -5e-324, 1e-310, 1e-46, -1e-16), size=reaches.shape),
        rng.choice((0.0, -0.0), size=reaches.shape),
    )
    return np.ldexp(np.where(reaches == 0, dust, reaches), powers[:, None]), powers


def _narrow(corners: F64) -> npt.NDArray[Any]:
    """As float32 where that holds them."""
    with np.errstate(over="ignore", under="ignore"):
        narrow = corners.astype(np.float32)
    return narrow if (narrow == corners).all() else corners


def fans(count: int, seed: int) -> Iterator[tuple[npt.NDArray[Any], F64, F64]]:
    """Yield ``count`` times corners (TRIANGLES, 3, 3) float32 or float64, origin and direction (3,) float64.

    Small integers, multiples of 2^-20, doubles, scales of 2^-300 to 2^300, places up to 2^40. One call of
    fewer cases is no prefix of a longer one.
    """
    rng = np.random.default_rng([seed, 1])
    for number, (style, grid) in enumerate(STYLES.items()):
        share = len(range(number, count, len(STYLES)))
        drawn = draw(share, rng, grid)
        corners, origins, reaches = drawn.corners, nudged(drawn.origins, rng), drawn.reaches
        directions, _ = _directions(reaches, rng)
        if style == "scaled":
            limit = np.where(rng.random(share) < 0.5, 100, 300)
            scale = rng.integers(-limit, limit + 1)
            corners = np.ldexp(corners, scale[:, None, None, None])
            origins = np.ldexp(origins, scale[:, None])
        if style == "far":
            site = np.ldexp(rng.integers(-4, 5, (share, 3)), rng.integers(0, 39, (share, 1)))
            corners, origins = corners + site[:, None, None], nudged(drawn.origins + site, rng)
        for k in range(share):
            yield _narrow(corners[k]), origins[k], directions[k]


@dataclass(frozen=True)
class FanScene:
    """One mesh of many fans apart from each other, and rays that stay with their fan up to ``t_max``."""

    mesh: Mesh
    """Triangles of fan n have the ids TRIANGLES * n and following; no vertices are shared."""
    origins: F64
    directions: F64
    """(R, 3) float64 each."""
    t_max: F64
    """(R,): up to here a ray can meet no other fan than its own."""
    fan: npt.NDArray[np.int64]
    """(R,) which fan a ray is aimed at."""

    def corners(self, ray: int) -> npt.NDArray[Any]:
        """(TRIANGLES, 3, 3) corners of the ray's fan, as the mesh has them."""
        first = TRIANGLES * int(self.fan[ray])
        corners: npt.NDArray[Any] = self.mesh.vertices[self.mesh.faces[first : first + TRIANGLES]]
        return corners


def fan_scene(
    count: int,
    seed: int,
    rays: int = 1,
    dtype: type = np.float32,
    exponent: int = 0,
    grid: float | None = None,
) -> FanScene:
    """``count`` fans on a cubic lattice of sites, with ``rays`` rays each; all scaled by 2**exponent.

    Half of the fans have small integer coordinates, half multiples of ``grid`` (2^-9, float64: 2^-34), all
    about their site; every coordinate is exact in ``dtype``, or a ValueError is raised.
    """
    rng = np.random.default_rng([seed, 2])
    fine = grid or (2.0**-9 if dtype == np.float32 else 2.0**-34)
    side = int(np.ceil(count ** (1 / 3)))
    places = np.stack(np.unravel_index(np.arange(count), (side, side, side)), -1)
    sites = (places - side // 2) * SPACING
    parts = [draw(count - count // 2, rng, 1.0), draw(count // 2, rng, fine)]
    corners = np.concatenate([p.corners for p in parts]) + sites[:, None, None, :]
    vertices = np.ldexp(corners.reshape(-1, 3), exponent)
    stored = vertices.astype(dtype)
    if (stored != vertices).any():
        raise ValueError(f"{count} fans with coordinates of {fine} do not fit in {np.dtype(dtype).name}")
    mesh = Mesh(stored, np.arange(len(stored), dtype=np.uint32).reshape(-1, 3))
    origins, directions, limits = [], [], []
    for number in range(rays):
        part = parts
        if number:
            part = [_again(p, rng, g) for p, g in zip(parts, (1.0, fine), strict=True)]
        start = np.concatenate([p.origins for p in part]) + sites
        direction, powers = _directions(np.concatenate([p.reaches for p in part]), rng)
        origins.append(np.ldexp(nudged(start, rng, 0.03), exponent))
        directions.append(direction)
        limits.append(np.ldexp(1.5, exponent - powers))
    return FanScene(
        mesh,
        np.concatenate(origins),
        np.concatenate(directions),
        np.concatenate(limits),
        np.tile(np.arange(count), rays),
    )


def _again(fans: Fans, rng: np.random.Generator, grid: float) -> Fans:
    """The same fans with other rays, at any of their triangles."""
    rows, which = np.arange(len(fans.corners)), rng.integers(TRIANGLES, size=len(fans.corners))
    kinds = rng.integers(len(KINDS), size=len(rows))
    a, b, c = np.moveaxis(fans.corners[rows, which], 1, 0)
    origins, reaches = _aimed(kinds, a, b, c, rng, grid)
    return Fans(fans.corners, origins, reaches, kinds)
