"""What a grid would cost before it is built, and which of several grids to build.

``time = build(triangles, references, cells) + rays * cast(steps, batches)``, a straight line in each, with a
device's seconds from ``calibrate``. The counts come from a sample of the triangles by integral geometry:
a random line through a box of surface S meets 2 A / S of the surface A in it, and of cells of surface s
each one with probability s / S. Nothing here decides a hit: every grid gives the same answers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from clgrid.errors import GridTooLargeError
from clgrid.frame import LocalFrame
from clgrid.layouts.binning import MOST_REFERENCES
from clgrid.layouts.lists import bricks_of
from clgrid.layouts.planes import ROW_CELLS, plane_params
from clgrid.mesh import Mesh
from clgrid.resolution import BOX_PAD, by_density

LADDER = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
"""Densities among which "auto" chooses, in cells per triangle."""

LAYOUTS = ("compact", "hashed")
"""Layouts among which "auto" chooses: the historical ones are there for comparison."""

DEFAULT_RAYS = 2**20

_SAMPLE = 1 << 13
# Of CLIP_CELLS in cl/config.h: larger boxes are entered only where the triangle is.
_CLIP_CELLS = 32
# Neighbouring boxes overlap less than they spill over: cells that a surface of small triangles fills, beyond
# those that it touches, by mean width of a box in cells. Measured on scans: 0.5 to 0.6.
_SPILL = 0.55
# Share of the slots in use: measured 0.9 and more (docs/performance.md).
_LOAD = 0.93
# Capacity of arrays that grow by doubling, by what they hold.
_CAPACITY = 1.4
# Of rays that are cast, so many meet the mesh's box: pictures 0.3 to 0.7, rays from surfaces all.
_ENTER = 0.7
# A closed surface is met in pairs, and a ray ends at the first: half of a line's tests.
_FRONT = 0.5
# Looks at cells on a ray that leaps over empty space, however fine the grid: measured 10 to 11 on scans.
_LEAPING_STEPS = 10.5
# Of grids this near to the fastest, the smallest is built.
_AS_FAST = 1.03

Made = TypeVar("Made")


@dataclass(frozen=True)
class Sample:
    """Some triangles of a mesh, in its local frame, and how many each stands for.

    Attributes
    ----------
    low, high : (3, n) float64
        Corners of the padded boxes, by axis.
    shadows : (3, n) float64
        Areas of the projections along each axis.
    area : float
        Of the whole mesh.
    bounds : (2, 3) float64
        Of the whole mesh.
    triangles : int
        Of the whole mesh.
    """

    low: npt.NDArray[np.float64]
    high: npt.NDArray[np.float64]
    shadows: npt.NDArray[np.float64]
    area: float
    bounds: npt.NDArray[np.float64]
    triangles: int

    @property
    def weight(self) -> float:
        """Triangles that each of the sample stands for."""
        return self.triangles / len(self.low[0])


def sample(mesh: Mesh, size: int = _SAMPLE) -> Sample:
    """All triangles of a small mesh; of a large one, one at random out of each of ``size`` equal runs.

    The same for the same mesh. Nothing but the faces taken and their vertices is read.

    Parameters
    ----------
    mesh : Mesh
        With at least one triangle.
    size : int
        Triangles to take at most.
    """
    count = mesh.triangle_count
    taken = np.arange(count)
    if count > size:
        within = np.random.default_rng(0).random(size)
        taken = ((np.arange(size) + within) * (count / size)).astype(np.int64)
    frame = LocalFrame.of_bounds(mesh.bounds)
    local = frame.to_local(mesh.vertices[mesh.faces[taken].reshape(-1)]).astype(np.float64)
    a, b, c = np.ascontiguousarray(local.reshape(-1, 3, 3).transpose(1, 2, 0))
    e, f = b - a, c - a
    twice = np.stack([e[1] * f[2] - e[2] * f[1], e[2] * f[0] - e[0] * f[2], e[0] * f[1] - e[1] * f[0]])
    return Sample(
        np.minimum(np.minimum(a, b), c) - BOX_PAD,
        np.maximum(np.maximum(a, b), c) + BOX_PAD,
        0.5 * np.abs(twice),
        0.5 * float(np.sqrt((twice * twice).sum(axis=0)).mean()) * count,
        frame.to_local(mesh.bounds).astype(np.float64),
        count,
    )


@dataclass(frozen=True)
class Work:
    """What a grid takes to build and to cast rays through, counted or estimated.

    Attributes
    ----------
    triangles, cells, references, full_cells : float
        Full cells are those with a list.
    steps, tests, batches : float
        Of a ray, by mean: cells looked at, triangles tested, and batches of eight that these come in.
    """

    triangles: float
    cells: float
    references: float
    full_cells: float
    steps: float
    tests: float
    batches: float


def estimate(seen: Sample, resolution: tuple[int, int, int]) -> Work:
    """The work of a grid of so many cells without skipping, from a sample of its triangles.

    Parameters
    ----------
    seen : Sample
    resolution : (int, int, int)
        Cells along x, y and z.
    """
    params = plane_params(seen.bounds, resolution, seen.triangles)
    cell = params["cell_size"].astype(np.float64)
    cells = float(np.prod(np.array(resolution, np.float64)))
    box, widths = np.ones(len(seen.low[0])), np.zeros(len(seen.low[0]))
    for axis in range(3):
        size, last = cell[axis], resolution[axis] - 1
        low, high = ((side[axis] - params["lower"][axis]) / size for side in (seen.low, seen.high))
        widths += high - low
        box *= np.clip(np.floor(high), 0, last) - np.clip(np.floor(low), 0, last) + 1
    shadows = (cell / cell.prod()) @ seen.shadows
    # A convex body at a random place touches as many unit cells as its Minkowski sum with one has volume.
    touched = np.minimum(box, shadows + widths + 1)
    clipped = box > _CLIP_CELLS
    references = float(np.where(clipped, touched, box).sum()) * seen.weight
    filled = float(np.where(clipped, shadows, shadows * (1 + _SPILL * widths / 3)).sum()) * seen.weight
    full = cells * -math.expm1(-filled / cells)
    steps, tests = _along_rays(seen, cell, cells, references)
    full = min(max(full, 1.0), references, cells)
    batches = tests * _batches_per_test(references / full)
    return Work(seen.triangles, cells, references, full, _ENTER * steps, _ENTER * tests, _ENTER * batches)


def _batches_per_test(length: float) -> float:
    """Batches of eight for each triangle, in lists of this mean length: none is shared by two lists.

    Lengths as if each list had a constant chance to go on: geometric, like most with such a mean.
    """
    chance = 1 - 1 / length
    return 1 / (length * (1 - chance**8))


def leaping(work: Work) -> Work:
    """The work of the same grid with skipping: hardly more steps, however many cells there are."""
    steps = (work.steps**-3 + (_ENTER * _LEAPING_STEPS) ** -3) ** (-1 / 3)
    return replace(work, steps=steps)


def _along_rays(
    seen: Sample, cell: npt.NDArray[np.float64], cells: float, references: float
) -> tuple[float, float]:
    """Cells and tests on a line through the bounds, up to its first hit."""
    whole = _box_surface(seen.bounds[1] - seen.bounds[0] + 4 * BOX_PAD)
    met = _box_surface(cell) / whole
    hits = 2 * seen.area / whole
    # Hits as far apart as those of a Poisson process: the share of a line before the first.
    before = -math.expm1(-hits) / hits if hits > 0 else 1.0
    # No ray looks at fewer cells than the one that it enters by.
    return max(1.0, cells * met * before), _FRONT * references * met * before


def _box_surface(size: npt.NDArray[np.float64]) -> float:
    x, y, z = (float(edge) for edge in size)
    return 2 * (x * y + y * z + z * x)


@dataclass(frozen=True)
class Constants:
    """Seconds of a device for one layout, with or without skipping.

    Attributes
    ----------
    build : tuple of 4 float
        In any case, a triangle, a reference, a cell.
    cast : tuple of 3 float
        A ray, a step, a batch.
    source : str
        Where they come from.
    """

    build: tuple[float, float, float, float]
    cast: tuple[float, float, float]
    source: str

    def build_s(self, work: Work) -> float:
        """Seconds of the build."""
        amounts = (1.0, work.triangles, work.references, work.cells)
        return sum(seconds * amount for seconds, amount in zip(self.build, amounts, strict=True))

    def cast_s(self, work: Work, rays: float) -> float:
        """Seconds of so many rays."""
        amounts = (1.0, work.steps, work.batches)
        return rays * sum(seconds * amount for seconds, amount in zip(self.cast, amounts, strict=True))


@dataclass(frozen=True)
class Candidate:
    """A grid that could be built, with what it is estimated to cost.

    Attributes
    ----------
    layout : str
    density : float
        Cells per triangle, as asked for.
    skipping : bool
    resolution : (int, int, int)
    work : Work
    nbytes : int
        Of the finished grid.
    build_s, cast_s : float
        Seconds, the latter of all rays.
    fits : bool
        Whether it is estimated to be within the memory allowed.
    """

    layout: str
    density: float
    skipping: bool
    resolution: tuple[int, int, int]
    work: Work
    nbytes: int
    build_s: float
    cast_s: float
    fits: bool

    @property
    def total_s(self) -> float:
        """Seconds of both."""
        return self.build_s + self.cast_s


@dataclass(frozen=True)
class Choice:
    """The candidates for a mesh, and the one that was built.

    Attributes
    ----------
    candidates : tuple of Candidate
        In the order of layouts, skipping and densities.
    chosen : Candidate
    rays : int
        For which it was chosen.
    max_memory : int or None
    constants : dict of (str, bool) to Constants
        By layout and skipping.
    """

    candidates: tuple[Candidate, ...]
    chosen: Candidate
    rays: int
    max_memory: int | None
    constants: dict[tuple[str, bool], Constants]


@dataclass(frozen=True)
class Question:
    """Among which grids to choose, for what.

    Attributes
    ----------
    kinds : tuple of (str, bool)
        Layouts, each with or without skipping.
    densities : tuple of float
    resolution : (int, int, int) or None
        Instead of the densities.
    rays : int
        That will be cast.
    max_memory : int or None
        Bytes that the finished grid may have.
    device_memory : int
        Bytes that the grid may have with what the build holds beside it.
    """

    kinds: tuple[tuple[str, bool], ...]
    densities: tuple[float, ...]
    resolution: tuple[int, int, int] | None
    rays: int
    max_memory: int | None
    device_memory: int


def candidates(
    seen: Sample, asked: Question, constants: dict[tuple[str, bool], Constants]
) -> list[Candidate]:
    """Every grid in question with what it is estimated to cost.

    Raises
    ------
    InputError
        If a density is out of range.
    GridTooLargeError
        If there is none whose cells can be numbered.
    """
    grids = [(density, cells, estimate(seen, cells)) for density, cells in _resolutions(seen, asked)]
    return [
        _candidate(
            asked, constants[layout, skip], layout, density, skip, cells, leaping(work) if skip else work
        )
        for layout, skip in asked.kinds
        for density, cells, work in grids
    ]


def _candidate(
    asked: Question,
    spent: Constants,
    layout: str,
    density: float,
    skip: bool,
    resolution: tuple[int, int, int],
    work: Work,
) -> Candidate:
    nbytes = estimate_nbytes(work, layout, resolution, skip)
    # What the build holds beside the finished grid: sorted references, and a range for each triangle.
    held = nbytes + 6 * work.references + 8 * work.triangles
    allowed = asked.max_memory is None or nbytes <= asked.max_memory
    return Candidate(
        layout=layout,
        density=density,
        skipping=skip,
        resolution=resolution,
        work=work,
        nbytes=nbytes,
        build_s=spent.build_s(work),
        cast_s=spent.cast_s(work, asked.rays),
        fits=allowed and held <= asked.device_memory,
    )


def _resolutions(seen: Sample, asked: Question) -> list[tuple[float, tuple[int, int, int]]]:
    """Densities with the cells they ask for; those of too many cells are left out while others remain."""
    if asked.resolution is not None:
        return [(math.prod(asked.resolution) / seen.triangles, asked.resolution)]
    found, extents = [], seen.bounds[1] - seen.bounds[0]
    refusal: GridTooLargeError | None = None
    for density in asked.densities:
        try:
            found.append((density, by_density(extents, seen.triangles, density)))
        except GridTooLargeError as error:
            refusal = refusal or error
    if refusal is not None and not found:
        raise refusal
    return found


def estimate_nbytes(work: Work, layout: str, resolution: tuple[int, int, int], skipping: bool) -> int:
    """Bytes of the finished grid; ``clgrid.predict`` counts them exactly."""
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


def ranked(found: Sequence[Candidate]) -> list[Candidate]:
    """Those that fit, best first: the smallest of the fastest, then by time.

    If none is estimated to fit, the smallest alone: the estimate may be wrong.
    """
    fitting = sorted((one for one in found if one.fits), key=lambda one: one.total_s)
    if not fitting:
        return [min(found, key=lambda one: one.nbytes)]
    as_fast = [one for one in fitting if one.total_s <= _AS_FAST * fitting[0].total_s]
    best = min(as_fast, key=lambda one: one.nbytes)
    return [best, *(one for one in fitting if one is not best)]


def first_that_fits(
    found: Sequence[Candidate], attempt: Callable[[Candidate], Made]
) -> tuple[Candidate, Made]:
    """The best candidate that ``attempt`` does not refuse, with what it made.

    After a refusal only smaller ones are tried.

    Raises
    ------
    GridTooLargeError
        That of the smallest, if all are refused.
    """
    left: Iterator[Candidate] = iter(ranked(found))
    smallest = min(found, key=lambda one: one.nbytes)
    refused: Candidate | None = None
    while True:
        one = next((c for c in left if refused is None or c.nbytes < refused.nbytes), smallest)
        try:
            return one, attempt(one)
        except GridTooLargeError:
            if one is smallest:
                raise
            refused = one
