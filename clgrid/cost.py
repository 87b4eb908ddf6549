"""What a grid would cost before it is built, and which of several grids to build.

``time = build(triangles, references, cells) + tiles * cast(cells, references)``, a straight line in each: the
amounts from ``estimate``, a device's seconds from ``calibrate``. Rays are taken for those of a picture, cast
in blocks of four tiles (cl/slices.h): the more there are, the narrower is a block, and the fewer cells it
passes that one ray would not. Nothing here decides a hit: every grid gives the same answers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

from clgrid.errors import GridTooLargeError
from clgrid.estimate import Sample, Work, estimate_nbytes, estimate_nested, estimates, leaping
from clgrid.layouts import nested
from clgrid.layouts.lists import NESTED
from clgrid.outlook import Pictured
from clgrid.resolution import by_density

LADDER = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
"""Densities among which "auto" chooses, in cells per triangle."""

LAYOUTS = ("compact", "hashed")
"""Layouts among which "auto" chooses: the historical ones are there for comparison."""

DEFAULT_RAYS = 2**20

TILE = 8
"""Rays along a side of a tile, as in cl/render.cl."""

_NESTED_OF = {flat: layout for layout, flat in NESTED.items()}

# Of grids this near to the fastest, the smallest is built.
_AS_FAST = 1.01
# Cells that a tile may be wide: its rays go alone through finer ones, as if it were no wider. The root of
# WIDEST_SLICE in cl/way.h, less one.
_WIDEST = 10.3

# What a reference that four tiles pass together costs, as a multiple of one that a tile passes: measured
# (docs/performance.md, "Coherent rays").
_HELD_BY_FOUR = 3.0

# Triangles that share a cell with one, by mean, from which on a mesh is crowded: scans have up to 60.
_CROWDED = 200.0
# Blocks of four tiles that look at what is crowded pass whole lists of it: seconds for each triangle, on a
# device on which a reference costs a tile what it typically does; a quarter of a picture's blocks do.
_CROWD_S = 6e-10
_TYPICAL_REFERENCE_S = 2.4e-9
# Seconds that a nested grid takes to build, by those of a uniform one of a cell a triangle; measured 2.6
# to 6.
_NESTED_BUILD = 4.0

Made = TypeVar("Made")


@dataclass(frozen=True)
class Constants:
    """Seconds of a device for one layout, with or without skipping.

    Attributes
    ----------
    build : tuple of 4 float
        In any case, a triangle, a reference, a cell.
    cast : tuple of 3 float
        A ray; a cell, a reference that a tile passes.
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
        """Seconds of a picture of so many rays."""
        if rays <= 0:
            return 0.0
        width = TILE * work.across / math.sqrt(rays)
        amounts = passed_by_blocks(rays, work.steps, work.tests, width, work.pictured)
        return sum(seconds * amount for seconds, amount in zip(self.cast, amounts, strict=True))

    def crowd_s(self, crowd: float, rays: float) -> float:
        """Seconds that a picture of so many rays takes longer where so many triangles share a cell."""
        speed = self.cast[2] / _TYPICAL_REFERENCE_S
        return rays / (4 * TILE**2) * crowd * _CROWD_S * speed


def passed_by_tiles(rays: float, steps: float, tests: float, width: float) -> tuple[float, float, float]:
    """What rays take in tiles, from what each takes alone: rays, cells and references that the tiles pass.

    A slice of a tile is wider by ``width`` than the way of a ray through it, along both of its sides: by so
    many rows of cells, and by the references of so many cells each way.

    Parameters
    ----------
    rays : float
    steps, tests : float
        Of a ray alone, by mean.
    width : float
        Of a tile, in cells.
    """
    wider, tiles = 1 + min(width, _WIDEST), rays / TILE**2
    return rays, tiles * steps * wider, tiles * tests * wider**2


def passed_by_blocks(
    rays: float, steps: float, tests: float, width: float, pictured: Pictured | None = None
) -> tuple[float, float, float]:
    """The same of a picture, where four tiles go together unless they are too wide.

    A block passes its cells once. A reference is brought in once, and held against the rays of each tile.
    """
    blocks, held = rays / TILE**2, 1.0
    _, cells, references = passed_by_tiles(rays, steps, tests, width)
    if 2 * width <= _WIDEST:
        blocks, held = blocks / 4, _HELD_BY_FOUR
        _, cells, references = passed_by_tiles(rays / 4, steps, tests, 2 * width)
    return rays, cells, held * (references if pictured is None else pictured.passed(blocks))


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
    nested : bool
        Whether a nested grid is in question too.
    """

    kinds: tuple[tuple[str, bool], ...]
    densities: tuple[float, ...]
    resolution: tuple[int, int, int] | None
    rays: int
    max_memory: int | None
    device_memory: int
    nested: bool = False


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
    resolutions = _resolutions(seen, asked)
    works = estimates(seen, [cells for _, cells in resolutions])
    grids = [(density, cells, work) for (density, cells), work in zip(resolutions, works, strict=True)]
    crowded = _is_crowded(seen)
    # The outlook counts what a picture passes, crowds and all.
    weighed = crowded and seen.outlook is None
    crowds = [seen.crowd(cells) if weighed else 0.0 for _, cells in resolutions]
    uniform = [
        _candidate(
            asked,
            constants[layout, skip],
            layout,
            density,
            skip,
            cells,
            leaping(work) if skip else work,
            crowd,
        )
        for layout, skip in asked.kinds
        for (density, cells, work), crowd in zip(grids, crowds, strict=True)
    ]
    return [*uniform, *_nested(seen, asked, constants)] if asked.nested and crowded else uniform


def _is_crowded(seen: Sample) -> bool:
    """Whether so many triangles share a cell with one that a nested grid comes into question."""
    return seen.crowd(by_density(seen.bounds[1] - seen.bounds[0], seen.triangles, 1.0)) > _CROWDED


def _nested(
    seen: Sample, asked: Question, constants: dict[tuple[str, bool], Constants]
) -> Iterator[Candidate]:
    """A nested grid."""
    extents = seen.bounds[1] - seen.bounds[0]
    top, even = nested.top_resolution(extents, seen.triangles), by_density(extents, seen.triangles, 1.0)
    work = estimate_nested(seen, top, even)
    for layout, skip in asked.kinds:
        if skip:
            continue
        one = _candidate(
            asked, constants[layout, skip], _NESTED_OF[layout], nested.DEFAULT_DENSITY, skip, top, work
        )
        yield replace(one, build_s=_NESTED_BUILD * one.build_s)


def _candidate(
    asked: Question,
    spent: Constants,
    layout: str,
    density: float,
    skip: bool,
    resolution: tuple[int, int, int],
    work: Work,
    crowd: float = 0.0,
) -> Candidate:
    nbytes = estimate_nbytes(work, layout, resolution, skip)
    # What the build holds beside the finished grid: binned references, and a range for each triangle.
    held = nbytes + 4 * work.references + 8 * work.triangles
    allowed = asked.max_memory is None or nbytes <= asked.max_memory
    return Candidate(
        layout=layout,
        density=density,
        skipping=skip,
        resolution=resolution,
        work=work,
        nbytes=nbytes,
        build_s=spent.build_s(work),
        cast_s=spent.cast_s(work, asked.rays) + spent.crowd_s(crowd, asked.rays),
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
