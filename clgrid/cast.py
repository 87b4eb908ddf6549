"""Casts rays through the grids of a mesh: nearest hits, any hit, counts, all hits."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from clgrid.hits import COUNTERS, Hits
from clgrid.layouts.lists import CellLists
from clgrid.memory import Allocator, largest_buffer
from clgrid.mesh import Mesh
from clgrid.program import kernel
from clgrid.rays import Rays, invalid_count
from clgrid.target import DeviceMesh, MeshPart
from clgrid.tiles import RAYS_PER_ITEM, Division, division_of
from clgrid.tuning import tuning_of

Arrays = dict[str, npt.NDArray[Any]]
Defines = dict[str, int | str]

NO_HIT = 0xFFFFFFFF
_LARGEST_OF_A_RAY = 24  # bytes of an origin in float64
# Rays in flight at once: bounds the memory of a batch of any size.
_RAYS_PER_LAUNCH = 1 << 22
# Rays that are sorted together at least, where several processors sort.
_SHORTEST_RUN = 1 << 17
# Kernels whose rays each go alone.
_ALONE = ("count_hits", "cast_all")
_MACROS = {"primitive_uvs": "WITH_UVS", "t_err": "WITH_T_ERR", "certain": "WITH_CERTAIN"}


@dataclass(frozen=True)
class GridPart:
    """A part of the mesh with the grid over it; most grids have one."""

    mesh: MeshPart
    lists: CellLists

    @property
    def arguments(self) -> list[Any]:
        """The kernel arguments that every traversal takes, in the order of cl/lists.h and cl/mesh.h."""
        return [*self.lists.arguments, *self.mesh.arguments]

    @property
    def defines(self) -> Defines:
        """The options with which kernels that traverse it are compiled."""
        return {**self.lists.defines, **self.mesh.defines}


def part_defines(parts: Sequence[GridPart]) -> Defines:
    """The option with which kernels take the parts of a mesh one after another."""
    return {"PARTS": 1} if len(parts) > 1 else {}


def field_defines(fields: Sequence[str]) -> Defines:
    """The options with which kernels compute what is asked for."""
    options: Defines = {_MACROS[name]: 1 for name in fields if name in _MACROS}
    return {**options, "COUNT_STEPS": 1} if set(COUNTERS) & set(fields) else options


# Enqueues a kernel over (inputs, number of rays, outputs, options), which every casting kernel has.
Launch = Callable[[list[Any], int, list[Any], Defines], None]
# Inputs that follow from a launch's origins, directions and bounds.
Further = Callable[[list[npt.NDArray[Any]]], list[npt.NDArray[Any]]]


def run(
    target: DeviceMesh,
    launch: Launch,
    division: Division,
    rays: Rays,
    results: Sequence[Any],
    further: Further = lambda inputs: [],
) -> int:
    """Cast rays of any leading shape by launches of a bounded number of them.

    Parameters
    ----------
    launch
        Its outputs are the number of invalid rays by work-item, then the results.
    results : sequence of (N, ...) arrays
        Filled here; what they hold, the kernel finds.
    further
        Inputs that follow from a launch's origins, directions and bounds.

    Returns
    -------
    invalid : int
        Rays that are not finite or have no direction.
    """
    flat_o, flat_d = rays.origins.reshape(-1, 3), rays.directions.reshape(-1, 3)
    bounds, count = rays.bounds, len(flat_o)
    invalid = 0
    most = division.launch_of(min(_RAYS_PER_LAUNCH, largest_buffer(target.device) // _LARGEST_OF_A_RAY))
    for start in range(0, count, most):
        part = slice(start, min(start + most, count))
        inputs = [flat_o[part], flat_d[part], bounds if len(bounds) == 1 else bounds[part]]
        rejected = np.zeros(division.items(len(inputs[0])), np.uint32)
        filled = [rejected, *(array[part] for array in results)]
        launch_on_host(target, launch, [*inputs, *further(inputs)], filled)
        invalid += int(rejected.sum())
    return invalid


def launch_on_host(
    target: DeviceMesh, launch: Launch, rays: list[npt.NDArray[Any]], results: Sequence[npt.NDArray[Any]]
) -> None:
    """One launch, straight on the host arrays where the device can; fills the results.

    ``rays`` are origins, directions, bounds and whatever else the kernel reads.
    """
    allocator = Allocator(target.device)
    inputs = [allocator.share(array) for array in rays]
    outputs = [allocator.results(array) for array in results]
    defines: Defines = {"RAY_REAL": "float" if rays[0].dtype == np.float32 else "double"}
    if len(rays[2]) > 1:
        defines["PER_RAY_T"] = 1
    launch(inputs, len(rays[0]), outputs, defines)
    for array, buffer in zip(results, outputs, strict=True):
        allocator.bring_home(array, buffer)


def cast_in_tiles(
    name: str,
    target: DeviceMesh,
    parts: Sequence[GridPart],
    options: Defines,
    rays: Rays,
    results: Sequence[npt.NDArray[Any]],
) -> int:
    """Cast with a kernel that takes tiles of rays, chosen so that they have much in common; as ``run``."""
    division = division_of(rays)
    launch, further = tile_launch(name, target, parts, options, division)
    return run(target, launch, division, rays, results, further)


def tile_launch(
    name: str, target: DeviceMesh, parts: Sequence[GridPart], options: Defines, division: Division
) -> tuple[Launch, Further]:
    """Casts tiles of rays through the grids of all parts; and what it takes beside them: their order."""
    options = tile_options(name, target, parts, options, division)
    if division.row:
        return _launch(name, target, parts, options, division, [np.uint32(division.row)]), lambda inputs: []
    launch = _launch(name, target, parts, {**options, "ORDERED": 1}, division, [])
    return launch, lambda inputs: [_order(target, parts[0], inputs)]


def tile_options(
    name: str, target: DeviceMesh, parts: Sequence[GridPart], options: Defines, division: Division
) -> Defines:
    """The options of a kernel that takes tiles of rays, with what is tuned for the device."""
    tuning = tuning_of(target.device)
    options = {**options, **tuning.defines}
    # Rays that go alone one after another find in caches what their neighbours read.
    followed = division.in_rows and name in _ALONE
    if followed or parts[0].lists.subgrids is not None:
        return options
    return {**options, **tuning.turns(target.mesh.triangle_count)}


def _launch(
    name: str,
    target: DeviceMesh,
    parts: Sequence[GridPart],
    options: Defines,
    division: Division,
    tiling: list[Any],
) -> Launch:
    def launch(inputs: list[Any], count: int, outputs: list[Any], defines: Defines) -> None:
        for part in parts:
            every = {**defines, **options, **part.defines, **target.rung.defines}
            kernel(target.device, f"{name}.cl", name, **every)(
                target.device.queue, (division.items(count),), (1,), target.frame_params, *part.arguments,
                *inputs[:3], np.uint32(count), *inputs[3:], *tiling, *outputs,
            )  # fmt: skip

    return launch


def _order(target: DeviceMesh, part: GridPart, rays: list[npt.NDArray[Any]]) -> npt.NDArray[np.uint64]:
    """A key of each ray, with its number in it, sorted: rays that run near each other come together."""
    keys = np.arange(len(rays[0]), dtype=np.uint64)

    def launch(inputs: list[Any], count: int, outputs: list[Any], defines: Defines) -> None:
        kernel(target.device, "ray_keys.cl", "ray_keys", **defines)(
            target.device.queue, (Division().items(count),), (1,), target.frame_params, part.lists.params,
            *inputs, np.uint32(count), *outputs,
        )  # fmt: skip

    if len(keys) > RAYS_PER_ITEM:
        launch_on_host(target, launch, rays, [keys])
        _sort_runs(keys)
    return keys


def _sort_runs(keys: npt.NDArray[np.uint64]) -> None:
    """Sort runs of keys, one for each processor: tiles of a long run are hardly wider than those of all."""
    pieces = max(1, min(os.cpu_count() or 1, len(keys) // _SHORTEST_RUN))
    # Of keys, 3 times as fast as to sort numbers by keys.
    runs = np.array_split(keys, pieces)
    if pieces == 1:
        keys.sort()
        return
    with ThreadPoolExecutor(pieces) as pool:
        list(pool.map(np.ndarray.sort, runs))


def blank(count: int, fields: Sequence[str], real: type[np.floating[Any]], *, filled: bool = True) -> Arrays:
    """The results of so many rays that miss, in the order of cl/rays_in_out.h.

    Not ``filled``, what kernels write for every ray holds anything: pages are then touched once.
    """

    def array(value: float, dtype: npt.DTypeLike, *last: int) -> npt.NDArray[Any]:
        shape = (count, *last)
        return np.full(shape, value, dtype) if filled else np.empty(shape, dtype)

    of_fields: dict[str, Callable[[], npt.NDArray[Any]]] = {
        "primitive_uvs": lambda: array(0, real, 2),
        "t_err": lambda: array(0, np.float64),
        "certain": lambda: array(1, np.uint8),
        # Kernels count on from 0.
        **dict.fromkeys(COUNTERS, lambda: np.zeros(count, np.uint32)),
    }
    always = {"t_hit": array(np.inf, np.float64), "primitive_ids": array(NO_HIT, np.uint32)}
    return {**always, **{name: of_fields[name]() for name in fields}}


def hits_of(mesh: Mesh, rays: Rays, results: Arrays, invalid: int) -> Hits:
    """The results as ``Hits`` of the rays' shape."""
    shape = rays.origins.shape[:-1]
    shaped = {name: array.reshape((*shape, *array.shape[1:])) for name, array in results.items()}
    if "certain" in shaped:
        shaped["certain"] = shaped["certain"].astype(bool)
    t_hit, ids = shaped.pop("t_hit"), shaped.pop("primitive_ids")
    return Hits(t_hit, _signed(ids), invalid, mesh, rays.origins, rays.directions, shaped)


def _signed(ids: npt.NDArray[np.uint32]) -> npt.NDArray[np.int64]:
    """Triangles as int64, NO_HIT as -1."""
    narrow = ids.view(np.int32)
    if not ids.size or narrow.min() >= -1:
        return narrow.astype(np.int64)
    signed = ids.astype(np.int64)
    signed[ids == NO_HIT] = -1
    return signed


def cast_closest(target: DeviceMesh, parts: Sequence[GridPart], rays: Rays, fields: Sequence[str]) -> Hits:
    """Closest hits through the grids of all parts."""
    count, rung = len(rays.origins.reshape(-1, 3)), target.rung
    # Several parts each leave the rays of the parts before, where those are nearer.
    results = blank(count, fields, rung.real, filled=len(parts) > 1)
    nearest = []
    if len(parts) > 1:
        nearest = [np.zeros((count, rung.nearest_reals), rung.real)]
        nearest[0][:, 0] = np.inf
    options = {**part_defines(parts), **field_defines(fields)}
    invalid = cast_in_tiles("cast_closest", target, parts, options, rays, [*results.values(), *nearest])
    return hits_of(target.mesh, rays, results, invalid)


def cast_any(target: DeviceMesh, parts: Sequence[GridPart], rays: Rays) -> npt.NDArray[np.bool_]:
    """(...) bool: whether each ray meets a triangle."""
    occluded = np.zeros(len(rays.origins.reshape(-1, 3)), np.uint8)
    cast_in_tiles("cast_any", target, parts, {}, rays, [occluded])
    return occluded.astype(bool).reshape(rays.origins.shape[:-1])


def count_hits(
    target: DeviceMesh, parts: Sequence[GridPart], rays: Rays, *, open_start: bool = False
) -> npt.NDArray[np.uint32]:
    """(...) uint32: how many triangles each ray meets.

    Parameters
    ----------
    open_start : bool
        On the rung ``exact``: a triangle that holds the origin is met just if it lies ahead of the origin
        moved by an infinitesimal; the interval must be [0, inf].
    """
    counts = np.zeros(len(rays.origins.reshape(-1, 3)), np.uint32)
    options: Defines = {"OPEN_START": 1} if open_start and target.rung.name == "exact" else {}
    cast_in_tiles("count_hits", target, parts, options, rays, [counts])
    return counts.reshape(rays.origins.shape[:-1])


def no_hits(mesh: Mesh, rays: Rays, fields: Sequence[str], real: type[np.floating[Any]]) -> Hits:
    """The answer for a mesh without triangles."""
    results = blank(len(rays.origins.reshape(-1, 3)), fields, real)
    return hits_of(mesh, rays, results, invalid_count(rays))
