"""Casts rays that are on the device, and leaves their hits there: nothing is copied, nobody waits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from clgrid.cast import Defines, GridPart, blank, field_defines, hits_of, part_defines, tile_options
from clgrid.device import Device
from clgrid.errors import InputError
from clgrid.hits import Hits
from clgrid.memory import Allocator
from clgrid.mesh import Mesh
from clgrid.program import kernel
from clgrid.rays import Rays, as_bounds, invalid_count
from clgrid.rungs import Rung
from clgrid.shown import Facts, Shown, shape_text
from clgrid.target import DeviceMesh
from clgrid.tiles import Division

# A tile is then 64 consecutive rays.
_FLAT_ROW = 8
# As division_of: what is shorter wastes lanes.
_SHORTEST_ROW = 16


@dataclass(frozen=True)
class DeviceRays:
    """Rays on a device, as ``checked`` leaves them.

    Attributes
    ----------
    origins, directions : pyopencl.array.Array of (..., 3)
        C-contiguous from their buffer's start on, both float32 or both float64.
    bounds : (1, 2) or (N, 2) float64
        t_min and t_max, for all or by ray, on the host.
    """

    origins: Any
    directions: Any
    bounds: npt.NDArray[np.float64]

    @property
    def shape(self) -> tuple[int, ...]:
        """Without the three coordinates."""
        shape: tuple[int, ...] = self.origins.shape[:-1]
        return shape

    @property
    def count(self) -> int:
        """N."""
        return int(self.origins.size) // 3

    @property
    def division(self) -> Division:
        """Rows where the rays come in such, else 64 at a time; in the order given."""
        rows = len(self.shape) > 1 and self.shape[-1] >= _SHORTEST_ROW
        return Division(self.shape[-1] if rows else _FLAT_ROW)


@dataclass(frozen=True, repr=False)
class DeviceHits(Shown):
    """What rays hit, on the device: ``pyopencl.array.Array`` of the rays' shape, on the queue given.

    Attributes
    ----------
    t_hit : (...) float64
        Ray parameter of the nearest hit, in lengths of the direction vector; inf on a miss.
    primitive_ids : (...) uint32
        Triangle; 0xFFFFFFFF on a miss.
    primitive_uvs : (..., 2) float32 or float64, or None
        Weights of the triangle's second and third vertex, if they were asked for.
    computed : dict of str to array
        What else was asked for, by name. "certain" is uint8.
    event : pyopencl.Event
        Of the last kernel. The arrays know it too: what is done with them on the queue waits.
    """

    t_hit: Any
    primitive_ids: Any
    primitive_uvs: Any
    computed: dict[str, Any]
    event: Any
    mesh: Mesh
    _rays: DeviceRays
    _invalid: Any

    def _headline(self) -> str:
        return f"{shape_text(self._rays.shape, 'ray')}, hits on the device"

    def _facts(self) -> Facts:
        arrays = {
            "t_hit": self.t_hit,
            "primitive_ids": self.primitive_ids,
            "primitive_uvs": self.primitive_uvs,
        }
        named = {name: array for name, array in (arrays | self.computed).items() if array is not None}
        return {name: f"{array.shape} {array.dtype}" for name, array in named.items()}

    def get(self) -> Hits:
        """Wait, and copy to the host: what ``Grid.cast`` would have returned, bit for bit."""
        self.event.wait()
        named = {
            "t_hit": self.t_hit,
            "primitive_ids": self.primitive_ids,
            "primitive_uvs": self.primitive_uvs,
        }
        arrays = {**named, **self.computed}
        count, axes = self._rays.count, len(self._rays.shape)
        results = {
            name: array.get().reshape(count, *array.shape[axes:])
            for name, array in arrays.items()
            if array is not None
        }
        rays = Rays(self._rays.origins.get(), self._rays.directions.get(), self._rays.bounds)
        invalid = invalid_count(rays) if self._invalid is None else int(self._invalid.get().sum())
        return hits_of(self.mesh, rays, results, invalid)


def checked(
    device: Device,
    queue: Any,
    origins: Any,
    directions: Any,
    t_min: npt.ArrayLike,
    t_max: npt.ArrayLike,
) -> DeviceRays:
    """Rays that kernels can take as they are.

    Raises
    ------
    InputError
        If a queue or an array is not of the device's context, or shapes, dtypes or strides do not fit.
    """
    import pyopencl.array as cl_array

    if queue.context != device.context:
        raise InputError(f"the queue is of another context; make one in that of the grid on {device.label}")
    for name, array in (("origins", origins), ("directions", directions)):
        if not isinstance(array, cl_array.Array):
            raise InputError(f"{name} are a {type(array).__name__}; give a pyopencl array, or call cast")
        if array.context != device.context:
            raise InputError(
                f"{name} are of another context; make them in that of the grid on {device.label}"
            )
        if array.ndim == 0 or array.shape[-1] != 3 or array.dtype not in (np.float32, np.float64):
            raise InputError(
                f"{name} have shape {array.shape} and dtype {array.dtype}; give (..., 3) float32 or float64"
            )
        if not array.flags.c_contiguous or array.offset:
            raise InputError(f"{name} are strided or begin within a buffer; pass a copy")
    if origins.shape != directions.shape or origins.dtype != directions.dtype:
        raise InputError(
            f"origins are {origins.shape} {origins.dtype}, directions {directions.shape} {directions.dtype};"
            " on the device they must be of one shape and dtype"
        )
    return DeviceRays(origins, directions, as_bounds(t_min, t_max, origins.shape[:-1]))


def misses(mesh: Mesh, queue: Any, rays: DeviceRays, fields: Sequence[str], rung: Rung) -> DeviceHits:
    """The hits where there is nothing to hit."""
    import pyopencl as cl

    filled = _results(queue, rays, fields, rung)
    return _hits(mesh, rays, filled, None, cl.enqueue_marker(queue, wait_for=_events(filled.values())))


def cast_closest(
    target: DeviceMesh, parts: Sequence[GridPart], queue: Any, rays: DeviceRays, fields: Sequence[str]
) -> DeviceHits:
    """Closest hits through the grids of all parts."""
    if not rays.count:
        return misses(target.mesh, queue, rays, fields, target.rung)
    rung, state = target.rung, []
    results = _results(queue, rays, fields, rung)
    if len(parts) > 1:
        nearest = np.zeros((rays.count, rung.nearest_reals), rung.real)
        nearest[:, 0] = np.inf
        state.append(Allocator(target.device).upload(nearest))
    options = {**part_defines(parts), **field_defines(fields)}
    invalid, event = _enqueue(
        "cast_closest", target, parts, queue, rays, options, list(results.values()), state
    )
    return _hits(target.mesh, rays, results, invalid, event)


def cast_any(target: DeviceMesh, parts: Sequence[GridPart], queue: Any, rays: DeviceRays) -> Any:
    """(...) uint8 on the device: 1 where a ray meets a triangle."""
    return _answer("cast_any", target, parts, queue, rays, np.uint8)


def count_hits(target: DeviceMesh, parts: Sequence[GridPart], queue: Any, rays: DeviceRays) -> Any:
    """(...) uint32 on the device: how many triangles each ray meets."""
    return _answer("count_hits", target, parts, queue, rays, np.uint32)


def zeros(queue: Any, rays: DeviceRays, real: type[np.unsignedinteger[Any]]) -> Any:
    """(...) on the device: the answer where there is nothing to hit."""
    return _filled(queue, rays, np.zeros(1, real))


def _answer(
    name: str,
    target: DeviceMesh,
    parts: Sequence[GridPart],
    queue: Any,
    rays: DeviceRays,
    real: type[np.unsignedinteger[Any]],
) -> Any:
    """What a kernel with one result adds to zeros."""
    array = zeros(queue, rays, real)
    if rays.count:
        _, event = _enqueue(name, target, parts, queue, rays, {}, [array], [])
        array.add_event(event)
    return array


def _enqueue(
    name: str,
    target: DeviceMesh,
    parts: Sequence[GridPart],
    queue: Any,
    rays: DeviceRays,
    options: Defines,
    results: list[Any],
    state: list[Any],
) -> tuple[Any, Any]:
    """Cast through the grids of all parts: invalid rays by work-item, and the event of the last kernel.

    ``state`` are buffers that the kernel takes after the results.
    """
    import pyopencl.array as cl_array

    allocator, division = Allocator(target.device), rays.division
    invalid = cl_array.empty(queue, (division.items(rays.count),), np.uint32)
    outputs = [*(array.base_data for array in (invalid, *results)), *state]
    options = tile_options(name, target, parts, {**options, **_ray_defines(rays)}, division)
    # A copy: the array would be gone before the kernel is done.
    inputs = [rays.origins.base_data, rays.directions.base_data, allocator.upload(rays.bounds)]
    waits = _events((rays.origins, rays.directions, *results))
    event = None
    for part in parts:
        run = kernel(target.device, f"{name}.cl", name, **options, **part.defines, **target.rung.defines)
        event = run(
            queue, (division.items(rays.count),), (1,), target.frame_params, *part.arguments, *inputs,
            np.uint32(rays.count), np.uint32(division.row), *outputs, wait_for=waits,
        )  # fmt: skip
        waits = [event]
    for array in (invalid, rays.origins, rays.directions):
        array.add_event(event)
    return invalid, event


def _ray_defines(rays: DeviceRays) -> Defines:
    defines: Defines = {"RAY_REAL": "float" if rays.origins.dtype == np.float32 else "double"}
    return {**defines, "PER_RAY_T": 1} if len(rays.bounds) > 1 else defines


def _results(queue: Any, rays: DeviceRays, fields: Sequence[str], rung: Rung) -> dict[str, Any]:
    """Arrays of the results, filled as ``blank`` fills them."""
    return {name: _filled(queue, rays, one) for name, one in blank(1, fields, rung.real).items()}


def _filled(queue: Any, rays: DeviceRays, one: npt.NDArray[Any]) -> Any:
    """An array on the device with a row like ``one``, all of whose numbers are the same, a ray."""
    import pyopencl as cl
    import pyopencl.array as cl_array

    array = cl_array.empty(queue, (*rays.shape, *one.shape[1:]), one.dtype)
    if array.size:
        pattern = one.reshape(-1)[:1]
        array.add_event(cl.enqueue_fill_buffer(queue, array.base_data, pattern, 0, array.nbytes))
    return array


def _events(arrays: Any) -> list[Any]:
    return [event for array in arrays for event in array.events]


def _hits(mesh: Mesh, rays: DeviceRays, results: dict[str, Any], invalid: Any, event: Any) -> DeviceHits:
    for array in results.values():
        array.add_event(event)
    always = results.pop("t_hit"), results.pop("primitive_ids"), results.pop("primitive_uvs", None)
    return DeviceHits(*always, results, event, mesh, rays, invalid)
