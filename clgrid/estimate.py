"""What a grid would hold and what rays through it would do, from a sample of the triangles.

By integral geometry: of what lies in a box of surface S, a random line meets a cell of surface s with
probability s / S, and a convex body at a random place touches as many unit cells as its Minkowski sum with
one has volume. How much of a line is before its first hit, ``sightlines`` tells.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from clgrid.camera import Camera
from clgrid.frame import LocalFrame
from clgrid.layouts.binning import MOST_REFERENCES
from clgrid.layouts.lists import NESTED, bricks_of
from clgrid.layouts.planes import ROW_CELLS, padded_box
from clgrid.mesh import Mesh
from clgrid.outlook import Outlook, Pictured
from clgrid.resolution import BOX_PAD
from clgrid.scatter import Scatter
from clgrid.sightlines import Sightlines

_SAMPLE = 1 << 10
# Of CLIP_CELLS in cl/config.h: larger boxes are entered only where the triangle is.
_CLIP_CELLS = 32
# Neighbouring boxes overlap less than they spill over: cells that a surface of small triangles fills, beyond
# those that it touches, by mean width of a box in cells. Measured on scans: 0.5 to 0.6.
_SPILL = 0.55
# Share of the slots in use: measured 0.9 and more (docs/performance.md).
_LOAD = 0.93
# Capacity of arrays that grow by doubling, by what they hold.
_CAPACITY = 1.4
# Bytes a triangle of nested layouts at their own density: measured on rooms 17 to 23, and 13 to 18.
_NESTED_BYTES = {"nested": 22.0, "nested-hashed": 18.0}
# Of rays from anywhere, so many meet the mesh's box: pictures 0.3 to 0.7, rays from surfaces all.
_ENTER = 0.7
# What their picture shows, where they end, by mean, as a share of the mesh's longest side.
_SHOWN = 0.75
# A line ends within a coarse cell of ``sightlines``, and part of the lists there lies behind: on scans, 0.7
# to 0.8 of the tests are left.
_IN_FRONT = 0.75
# Of nested grids, measured on rooms and scans: references a triangle; width of cells, in widths of triangles;
# steps, of those through the top grid, and below it. Steps and tests where triangles crowd, of those in a
# uniform grid of a cell a triangle.
_NESTED_REFERENCES, _NESTED_WIDTH = 4.0, 3.0
_STEPS_PER_TOP, _STEPS_BELOW = 1.5, 5.0
_NESTED_STEPS, _NESTED_TESTS = 0.5, 0.25
# Looks at cells of rays that leap over empty space, by mean, however fine the grid: measured 10 to 11 on
# scans of those that meet the box.
_LEAPING_STEPS = 7.35


@dataclass(frozen=True)
class Sample:
    """Some triangles of a mesh, in its local frame, and how many each stands for.

    Attributes
    ----------
    low, high : (3, n) float64
        Corners of the padded boxes, by axis.
    shadows : (3, n) float64
        Areas of the projections along each axis.
    lines : Sightlines, optional
        From anywhere, where there is no outlook.
    outlook : Outlook, optional
        Of the camera, where it is known.
    bounds : (2, 3) float64
        Of the whole mesh.
    triangles : int
        Of the whole mesh.
    """

    low: npt.NDArray[np.float64]
    high: npt.NDArray[np.float64]
    shadows: npt.NDArray[np.float64]
    lines: Sightlines | None
    outlook: Outlook | None
    bounds: npt.NDArray[np.float64]
    triangles: int

    @property
    def weight(self) -> float:
        """Triangles that each of the sample stands for."""
        return self.triangles / len(self.low[0])

    def crowd(self, resolution: tuple[int, int, int]) -> float:
        """How many triangles share a cell with a triangle, by mean: tens on scans, thousands where crowded.

        Of the sample's pairs, those in one cell are the share that they are of all pairs.
        """
        lower, size = padded_box(self.bounds)
        x, y, _ = resolution
        middles = 0.5 * (self.low + self.high) - lower[:, None]
        at = np.clip((middles * (np.array(resolution) / size)[:, None]).astype(np.int64), 0, None)
        cells = np.sort((at[2] * y + at[1]) * x + at[0])
        ends = np.flatnonzero(np.diff(cells, append=-1)) + 1
        lengths = np.diff(ends, prepend=0)
        return float((lengths * (lengths - 1)).sum()) / len(cells) * self.weight


def sample(mesh: Mesh, size: int = _SAMPLE, view: Camera | None = None) -> Sample:
    """All triangles of a small mesh; of a large one, one at random out of each of ``size`` equal runs.

    The same for the same mesh. Nothing but the faces taken and their vertices is read.

    Parameters
    ----------
    mesh : Mesh
        With at least one triangle.
    size : int
        Triangles to take at most.
    view : Camera, optional
        Whose picture the rays are; without, rays come from anywhere outside.
    """
    count = mesh.triangle_count
    taken = (_draws(size) * (count / size)).astype(np.int64) if count > size else np.arange(count)
    frame = LocalFrame.of_bounds(mesh.bounds)
    # numpy takes rows in two thirds of the time in which it indexes them.
    corners = mesh.vertices.take(mesh.faces.take(taken, axis=0).reshape(-1), axis=0)
    local = frame.to_local(corners).astype(np.float64)
    a, b, c = np.ascontiguousarray(local.reshape(-1, 3, 3).transpose(1, 2, 0))
    e, f = b - a, c - a
    twice = np.stack([e[1] * f[2] - e[2] * f[1], e[2] * f[0] - e[0] * f[2], e[0] * f[1] - e[1] * f[0]])
    areas = 0.5 * np.sqrt((twice * twice).sum(axis=0))
    bounds = frame.to_local(mesh.bounds).astype(np.float64)
    scatter = Scatter.over((a, b, c), areas, float(areas.mean()) * count)
    return Sample(
        low=np.minimum(np.minimum(a, b), c) - BOX_PAD,
        high=np.maximum(np.maximum(a, b), c) + BOX_PAD,
        shadows=0.5 * np.abs(twice),
        lines=Sightlines(scatter, bounds) if view is None else None,
        outlook=None if view is None else Outlook(view, frame, scatter, bounds),
        bounds=bounds,
        triangles=count,
    )


@functools.cache
def _draws(size: int) -> npt.NDArray[np.float64]:
    """A number at random out of each of so many runs of length 1, one after the other."""
    return np.arange(size) + np.random.default_rng(0).random(size)


@dataclass(frozen=True)
class Work:
    """What a grid takes to build and to cast rays through, counted or estimated.

    Attributes
    ----------
    triangles, cells, references, full_cells : float
        Full cells are those with a list.
    steps, tests, batches : float
        Of a ray alone, by mean: cells looked at, triangles tested, and batches of eight that these come in.
    across : float
        Cells along a side of what a picture shows.
    pictured : Pictured, optional
        The references that blocks of pixels pass, where the picture is known.
    """

    triangles: float
    cells: float
    references: float
    full_cells: float
    steps: float
    tests: float
    batches: float
    across: float
    pictured: Pictured | None = None


def estimate(seen: Sample, resolution: tuple[int, int, int]) -> Work:
    """The work of a grid of so many cells without skipping, from a sample of its triangles.

    Parameters
    ----------
    seen : Sample
    resolution : (int, int, int)
        Cells along x, y and z.
    """
    return estimates(seen, [resolution])[0]


def estimates(seen: Sample, resolutions: Sequence[tuple[int, int, int]]) -> list[Work]:
    """The same for each of several grids, in a third of the time."""
    lower, size = padded_box(seen.bounds)
    along = np.array(resolutions, np.float64)
    cell = size / along
    low, high = ((side - lower[:, None]) / cell[..., None] for side in (seen.low, seen.high))
    widths = (high - low).sum(axis=1)
    # np.clip would take twice as long.
    last = along[..., None] - 1
    first, end = (np.maximum(np.minimum(np.floor(side), last), 0) for side in (low, high))
    box = (end - first + 1).prod(axis=1)
    shadows = (cell / cell.prod(axis=1)[:, None]) @ seen.shadows
    # A convex body at a random place touches as many unit cells as its Minkowski sum with one has volume.
    touched = np.minimum(box, shadows + widths + 1)
    clipped = box > _CLIP_CELLS
    listed = np.where(clipped, touched, box)
    filled = np.where(clipped, shadows, shadows * (1 + _SPILL * widths / 3)).sum(axis=1) * seen.weight
    return [_work(seen, *each) for each in zip(resolutions, cell, listed, filled.tolist(), strict=True)]


def _work(
    seen: Sample,
    resolution: tuple[int, int, int],
    cell: npt.NDArray[np.float64],
    listed: npt.NDArray[np.float64],
    filled: float,
) -> Work:
    """Of a grid whose cells are so large, in so many of which each triangle is listed; so many are filled."""
    cells = float(math.prod(resolution))
    references = float(listed.sum()) * seen.weight
    full = min(max(cells * -math.expm1(-filled / cells), 1.0), references, cells)
    batch = _batches_per_test(references / full)
    if seen.outlook is not None:
        outlook, surface = seen.outlook, _box_surface(cell)
        # No ray looks at fewer cells than the one that it enters by.
        steps = max(1.0, outlook.length * surface / (4 * float(cell.prod())))
        pictured = outlook.pictured(_IN_FRONT * seen.weight * listed, math.sqrt(surface / 4))
        tests = pictured.tests()
        across = outlook.side * outlook.end / float(cell.max())
        return Work(seen.triangles, cells, references, full, steps, tests, batch * tests, across, pictured)
    assert seen.lines is not None
    # Of the cells, and of whatever they hold, a line meets the share that their surface is of the box's.
    met = _box_surface(cell) / _box_surface(seen.bounds[1] - seen.bounds[0] + 4 * BOX_PAD)
    steps = _ENTER * max(1.0, cells * met * seen.lines.open)
    tests = _ENTER * _IN_FRONT * references * met * seen.lines.passed(listed)
    across = _SHOWN * max(resolution)
    return Work(seen.triangles, cells, references, full, steps, tests, batch * tests, across)


def estimate_nested(seen: Sample, top: tuple[int, int, int], even: tuple[int, int, int]) -> Work:
    """The work of a nested grid, by those of its top grid and of a uniform one with a cell a triangle.

    Its cells are as large as the triangles in them, not as the mesh is on average.
    """
    coarse, work = estimates(seen, [top, even])
    if seen.outlook is None:
        return replace(work, steps=_NESTED_STEPS * work.steps, tests=_NESTED_TESTS * work.tests)
    largest = 0.5 * float(((seen.bounds[1] - seen.bounds[0]) / np.array(top)).max())
    widths = np.minimum(_NESTED_WIDTH * np.sqrt(np.sqrt((seen.shadows**2).sum(axis=0))), largest)
    listed = np.full(len(widths), _IN_FRONT * _NESTED_REFERENCES * seen.weight)
    pictured = seen.outlook.pictured(listed, widths)
    steps = _STEPS_PER_TOP * coarse.steps + _STEPS_BELOW
    return replace(work, steps=steps, tests=pictured.tests(), pictured=pictured)


def _batches_per_test(length: float) -> float:
    """Batches of eight for each triangle, in lists of this mean length: none is shared by two lists.

    Lengths as if each list had a constant chance to go on: geometric, like most with such a mean.
    """
    chance = 1 - 1 / length
    return 1 / (length * (1 - chance**8))


def leaping(work: Work) -> Work:
    """The work of the same grid with skipping: hardly more steps, however many cells there are."""
    steps = (work.steps**-3 + _LEAPING_STEPS**-3) ** (-1 / 3)
    return replace(work, steps=steps)


def _box_surface(size: npt.NDArray[np.float64]) -> float:
    x, y, z = (float(edge) for edge in size)
    return 2 * (x * y + y * z + z * x)


def estimate_nbytes(work: Work, layout: str, resolution: tuple[int, int, int], skipping: bool) -> int:
    """Bytes of the finished grid; ``clgrid.predict`` counts them exactly."""
    if layout in NESTED:
        return int(_NESTED_BYTES[layout] * work.triangles)
    index = 4 if work.references <= MOST_REFERENCES else 8
    by_layout = {
        "compact": index * (work.cells + 1) + 4 * work.references,
        "hashed": 10 * math.ceil(work.cells / ROW_CELLS)
        + index * work.full_cells / _LOAD
        + 4 * work.references,
        "linked-list": index * work.cells + (4 + index) * work.references,
        "dynamic-array": (8 + index) * work.cells + 4 * _CAPACITY * work.references,
    }
    return int(by_layout[layout]) + (math.prod(bricks_of(resolution)) if skipping else 0)
