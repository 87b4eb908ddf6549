"""Fits the constants of the cost model on a device: once, by building and casting small scenes.

What will be compared is measured in turns, so that a busy moment of the machine is shared by all of it.
Kept beside clgrid's other caches, one file for each layout, with and without skipping, of a device, its
driver and these kernels.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from clgrid import cache, layouts, registration
from clgrid.cast import GridPart, cast_closest
from clgrid.cost import TILE, Constants, passed_by_tiles
from clgrid.device import Device
from clgrid.errors import ClgridError
from clgrid.hits import COUNTERS
from clgrid.layouts.planes import plane_params
from clgrid.memory import Allocator
from clgrid.mesh import Mesh
from clgrid.procedural import cube, icosphere, terrain
from clgrid.program import source_digest
from clgrid.rays import Rays
from clgrid.resolution import by_density
from clgrid.target import DeviceMesh

# Seconds by PoCL and Intel's runtime on two cores of an EPYC: what every fit starts from, and stays near
# where it says little. Hashed lists take more steps to find; with skipping, tiles look at few cells but
# those with lists. Here for a build, a triangle, a reference, a cell.
_TYPICAL_BUILD = {
    ("compact", False): (6.0e-4, 4e-9, 3.8e-9, 2e-10),
    ("compact", True): (6.5e-4, 4e-9, 3.9e-9, 3e-10),
    ("hashed", False): (7.0e-4, 4e-9, 4.2e-9, 2e-10),
    ("hashed", True): (7.5e-4, 4e-9, 4.3e-9, 5e-10),
}
# For a ray; a cell, a reference that a tile passes.
_TYPICAL_CAST = {
    ("compact", False): (2e-8, 2.2e-9, 2.4e-9),
    ("compact", True): (2e-8, 7.2e-9, 2.0e-9),
    ("hashed", False): (2e-8, 3.0e-9, 2.8e-9),
    ("hashed", True): (2e-8, 8.5e-9, 2.4e-9),
}

_ROUNDS = 4
# Rays: tiles here and there in a large picture, since neighbours share what they read.
_PIXELS, _TILES_DOWN, _TILES_ACROSS = 1024, 16, 64
# Width of the picture, in diagonals of the mesh's box.
_WIDE = 1.0
# A constant may differ from the typical one, once that is scaled to the device, by so much either way.
_MOST = 10.0
# Weight of the typical constants beside a measurement: decides what those leave open. Then the same of how
# kinds differ, which is by their kernels more than by the device.
_PULL, _PULL_TOGETHER = 1.0, 10.0
_FORMAT = 3

_lock = threading.Lock()
_known: dict[tuple[Device, str, bool], Constants] = {}

Kind = tuple[str, bool]
"""A layout, and whether with skipping."""


@dataclass(frozen=True)
class Measured:
    """What was done, and the seconds that it took.

    Attributes
    ----------
    amounts : (k, n) float64
        Of each thing that has a constant, in each measurement.
    seconds : (k,) float64
    """

    amounts: npt.NDArray[np.float64]
    seconds: npt.NDArray[np.float64]


def constants(device: Device, kinds: Sequence[Kind]) -> dict[Kind, Constants]:
    """The device's constants, fitted at first use, from then on read from the cache.

    Those that are asked for together were measured together, or are all fitted anew. Where a fit fails they
    are typical ones, and their ``source`` says why.
    """
    with _lock:
        found = {kind: _known.get((device, *kind)) or _kept(device, *kind) for kind in kinds}
        known = {kind: kept for kind, kept in found.items() if kept is not None}
        if len(known) < len(kinds):
            known = _fitted(device, kinds)
        _known.update({(device, *kind): kept for kind, kept in known.items()})
        return known


def typical(kind: Kind, source: str = "typical") -> Constants:
    """Constants of no device in particular; those of the compact layout for the historical ones."""
    like = kind if kind in _TYPICAL_CAST else ("compact", kind[1])
    return Constants(_TYPICAL_BUILD[like], _TYPICAL_CAST[like], source)


def cache_name(device: Device, layout: str, skipping: bool) -> str:
    """Name of the file in ``cache.folder()``, without its suffix."""
    seen = device.description
    files = (*layouts.programs(layout, skip=skipping), "cast_closest.cl")
    return "cost-" + cache.key(
        *(_FORMAT, layout, skipping),
        *(seen.platform_version, seen.name, seen.driver_version, seen.compute_units),
        *((seen.note,) if seen.note else ()),
        *(source_digest(file) for file in files),
    )


def _kept(device: Device, layout: str, skipping: bool) -> Constants | None:
    """What an earlier fit found; None if there was none, or its file makes no sense."""
    record = cache.load(cache_name(device, layout, skipping))
    if record is None:
        return None
    build, cast = (_numbers(record.get(name), count) for name, count in (("build", 4), ("cast", 3)))
    if build is None or cast is None:
        return None
    return Constants(_four(build), _three(cast), _source(device))


def _numbers(values: Any, count: int) -> list[float] | None:
    """So many seconds above zero, or None."""
    sound = isinstance(values, list) and len(values) == count
    if not sound or not all(isinstance(v, float) and 0 < v < math.inf for v in values):
        return None
    return list(values)


def _source(device: Device) -> str:
    return f"fitted on {device.label}, driver {device.description.driver_version}, kept in {cache.folder()}"


def _fitted(device: Device, kinds: Sequence[Kind]) -> dict[Kind, Constants]:
    try:
        found = fit_all(measure(device, kinds), _source(device))
    except (ClgridError, registration.opencl().Error, MemoryError, ArithmeticError) as error:
        why = f"typical, since the fit on {device.label} failed: {error}"
        return {kind: typical(kind, why) for kind in kinds}
    for kind, fitted in found.items():
        record = {"build": list(fitted.build), "cast": list(fitted.cast)}
        cache.store(cache_name(device, *kind), record)
    return found


def _four(values: Sequence[float]) -> tuple[float, float, float, float]:
    a, b, c, d = values
    return a, b, c, d


def _three(values: Sequence[float]) -> tuple[float, float, float]:
    a, b, c = values
    return a, b, c


def fit(
    parts: Sequence[Measured], starts: Sequence[Sequence[float]], shared: Sequence[int] = ()
) -> list[list[float]]:
    """Constants that explain the seconds, near ``starts`` scaled to the device where these leave it open.

    Parameters
    ----------
    parts : sequence of Measured
        Of each kind; all have the same n things in their columns.
    starts : sequence of n float
        Typical constants of each kind, seconds.
    shared : sequence of int
        Columns in which no kind differs from others but by ``starts``; in the rest it may, a little.

    Returns
    -------
    list of n float, of each kind

    Raises
    ------
    ArithmeticError
        If the seconds are not all above zero and finite.
    """
    seconds = np.concatenate([part.seconds for part in parts])
    if not (np.isfinite(seconds).all() and (seconds > 0).all()):
        raise ArithmeticError(f"the clock gave {seconds.tolist()} seconds")
    # Relative errors count, so that small scenes weigh as much as large ones.
    shares = [
        part.amounts * np.array(start) / part.seconds[:, None]
        for part, start in zip(parts, starts, strict=True)
    ]
    scale = 1 / float(np.median(np.concatenate(shares).sum(axis=1)))
    kinds, count = len(parts), len(starts[0])
    own = np.array([column not in shared for column in range(count)], np.float64)
    rows = [
        np.concatenate([share, *((share * own if other == kind else 0 * share) for other in range(kinds))], 1)
        for kind, share in enumerate(shares)
    ]
    # Factors of all kinds are near 1, and what each kind has beside them is near 0.
    pulls = np.sqrt([_PULL] * count + [_PULL_TOGETHER] * (kinds * count))
    wanted = np.concatenate([np.ones(len(seconds)), pulls * (np.arange(len(pulls)) < count)])
    system = np.concatenate([scale * np.concatenate(rows), np.diag(pulls)])
    common, *beside = np.linalg.lstsq(system, wanted, rcond=None)[0].reshape(-1, count)
    return [
        (scale * np.clip(common + own * each, 1 / _MOST, _MOST) * np.array(start)).tolist()
        for each, start in zip(beside, starts, strict=True)
    ]


def fit_all(measured: dict[Kind, tuple[Measured, Measured]], source: str) -> dict[Kind, Constants]:
    """Constants of kinds that were measured together.

    Those of triangles and of rays are one for all kinds, and others differ little from what is typical of a
    kind, so that a disturbance of one measurement does not pass for a difference of kinds.

    Parameters
    ----------
    measured : dict of kind to (Measured, Measured)
        As ``measure`` gives them.

    Raises
    ------
    ArithmeticError
        As ``fit``.
    """
    builds, casts = ([pair[i] for pair in measured.values()] for i in (0, 1))
    meshes = casts[0].amounts.shape[1] - 2
    starts = [typical(kind) for kind in measured]
    of_builds = fit(builds, [start.build for start in starts], (1,))
    of_casts = fit(
        casts, [[start.cast[0]] * meshes + list(start.cast[1:]) for start in starts], range(meshes)
    )
    return {
        kind: Constants(_four(built), _three([float(np.mean(cast[:meshes])), *cast[meshes:]]), source)
        for kind, built, cast in zip(measured, of_builds, of_casts, strict=True)
    }


def measure(device: Device, kinds: Sequence[Kind]) -> dict[Kind, tuple[Measured, Measured]]:
    """Build and cast, in turns.

    Returns
    -------
    dict of kind to (Measured, Measured)
        Of builds: in any case, triangles, references, cells. Of casts: rays at each mesh, then cells and
        references that tiles pass. What else than the grid makes rays of a mesh slow thus stays out of the
        constants of cells and references.
    """
    meshes = [(cube(), (4.0,)), (mountains(), (0.25, 1.0, 4.0, 16.0)), (icosphere(6), (0.5, 4.0, 16.0))]
    experiments = [
        _Experiment(mesh, device, kind, density, np.arange(len(meshes)) == number)
        for kind in kinds
        for number, (mesh, densities) in enumerate(meshes)
        for density in densities
    ]
    for _ in range(_ROUNDS):
        for experiment in experiments:
            experiment.run()
    of = {kind: [one for one in experiments if one.kind == kind] for kind in kinds}
    return {
        kind: (
            Measured(np.array([one.built for one in ours]), np.array([one.build_s for one in ours])),
            Measured(np.array([one.counted for one in ours]), np.array([one.cast_s for one in ours])),
        )
        for kind, ours in of.items()
    }


class _Experiment:
    """One scene at one density in one layout: the least seconds of its builds and of its casts."""

    def __init__(
        self, mesh: Mesh, device: Device, kind: Kind, density: float, is_mesh: npt.NDArray[np.bool_]
    ) -> None:
        self.mesh = mesh
        self.device = device
        self.kind = kind
        self.density = density
        self.rays = view(mesh)
        # The first turn compiles, and counts.
        self._build()
        hits = cast_closest(self.target, [self.part], self.rays, COUNTERS)
        self._cast()
        lists = self.part.lists
        self.built = (1.0, mesh.triangle_count, lists.reference_count, lists.cell_count)
        # Cells are near to cubes, so that the longest side tells their size.
        low, high = mesh.bounds
        cells_per_unit = max(lists.resolution) / float((high - low).max())
        width = TILE * _pixel(mesh) * cells_per_unit
        rays, *passed = passed_by_tiles(
            hits.t_hit.size, float(hits.steps.mean()), float(hits.tests.mean()), width
        )
        self.counted = (*(rays * is_mesh), *passed)
        self.build_s = self.cast_s = math.inf

    def run(self) -> None:
        """Build and cast once more; what disturbs only ever adds, so the least counts."""
        start = time.perf_counter()
        self._build()
        built = time.perf_counter()
        self._cast()
        self.build_s = min(self.build_s, built - start)
        self.cast_s = min(self.cast_s, time.perf_counter() - built)

    def _build(self) -> None:
        allocator = Allocator(self.device)
        self.target = DeviceMesh(self.mesh, self.device, allocator)
        whole = self.target.whole
        resolution = by_density(whole.local_bounds[1] - whole.local_bounds[0], whole.count, self.density)
        params = plane_params(whole.local_bounds, resolution, whole.count)
        vertices, faces = whole.vertices, whole.faces
        lists = layouts.build(self.device, allocator, vertices, faces, params, *self.kind)
        self.part = GridPart(whole, lists)

    def _cast(self) -> None:
        cast_closest(self.target, [self.part], self.rays, ())


def mountains() -> Mesh:
    """A surface with room above and below: rays take steps."""
    hills = terrain(256)
    return Mesh(hills.vertices * np.array([1, 1, 4], np.float32), hills.faces, source="mountains")


def _pixel(mesh: Mesh) -> float:
    """Width of a pixel of ``view`` at the middle of the mesh."""
    low, high = mesh.bounds
    return _WIDE / _PIXELS * float(np.linalg.norm(high - low))


def view(mesh: Mesh) -> Rays:
    """Tiles all over a picture of the mesh, each as small as in the whole of it."""
    low, high = mesh.bounds
    middle, size = (low + high) / 2, float(np.linalg.norm(high - low))
    back = np.array([0.48, 0.6, 0.64])
    across = np.array([0.8, 0.0, -0.6])
    rows, columns = (_pixel(mesh) * _scattered(tiles) for tiles in (_TILES_DOWN, _TILES_ACROSS))
    targets = middle + rows[:, None, None] * np.cross(back, across) + columns[:, None] * across
    origin = middle + 1.5 * size * back
    directions = targets - origin
    return Rays(np.broadcast_to(origin, directions.shape).copy(), directions, np.array([[0.0, np.inf]]))


def _scattered(tiles: int) -> npt.NDArray[np.float64]:
    """Pixels of so many tiles spread over the picture's width, from its middle."""
    starts = (np.arange(tiles) + 0.5) * (_PIXELS / tiles) - TILE / 2
    pixels = starts[:, None] + np.arange(TILE) + 0.5 - _PIXELS / 2
    return np.asarray(pixels.reshape(-1), np.float64)
