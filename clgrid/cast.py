"""Casts rays given as arrays: against a grid, or against every triangle."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from clgrid.device import Device, choose
from clgrid.errors import InputError
from clgrid.frame import LocalFrame
from clgrid.layouts.lists import CellLists
from clgrid.memory import Allocator, largest_buffer
from clgrid.mesh import Mesh
from clgrid.program import kernel
from clgrid.target import DeviceMesh, MeshPart

_NO_HIT = 0xFFFFFFFF
_RAYS_PER_ITEM = 64
_BRUTE_FORCE_RAYS = 16  # RAYS of cl/brute_force.cl
_LARGEST_OF_A_RAY = 24  # bytes of an origin in float64
# Rays in flight at once: bounds the memory of a batch of any size.
_RAYS_PER_LAUNCH = 1 << 22


@dataclass(frozen=True)
class Hits:
    """What rays hit. Arrays have the rays' leading shape; ``hits["t_hit"]`` works too.

    Attributes
    ----------
    t_hit : (...) float64
        Ray parameter of the nearest hit, in lengths of the direction vector; inf on a miss.
    primitive_ids : (...) int64
        Triangle, -1 on a miss.
    primitive_uvs : (..., 2) float32
        Barycentric weights of the triangle's second and third vertex; 0 on a miss.
    invalid_rays : int
        Rays that are misses because they are not finite or have no direction.
    steps : (...) uint32, optional
        Cells that the ray looked at, and with skipping empty bricks that it left without a look at their
        cells.
    tests : (...) uint32, optional
        Triangles of the cells' lists, each tested.
    batches : (...) uint32, optional
        Of up to eight triangles each, in which they were tested. Where one of these three is asked for, all
        are counted.
    """

    t_hit: npt.NDArray[np.float64]
    primitive_ids: npt.NDArray[np.int64]
    primitive_uvs: npt.NDArray[np.float32]
    invalid_rays: int
    _mesh: Mesh
    _origins: npt.NDArray[Any]
    _directions: npt.NDArray[Any]
    steps: npt.NDArray[np.uint32] | None = None
    tests: npt.NDArray[np.uint32] | None = None
    batches: npt.NDArray[np.uint32] | None = None

    def __getitem__(self, field: str) -> Any:
        if field.startswith("_") or not hasattr(self, field):
            raise KeyError(field)
        return getattr(self, field)

    @property
    def mask(self) -> npt.NDArray[np.bool_]:
        """(...) bool: where a ray hit."""
        return self.primitive_ids >= 0

    @property
    def geometry_ids(self) -> npt.NDArray[np.int64]:
        """(...) int64: geometry of the triangle, -1 on a miss."""
        return self._mesh.geometry_ids(self.primitive_ids)

    @property
    def primitive_normals(self) -> npt.NDArray[np.float64]:
        """(..., 3) float64: unit normal of the triangle by its winding; 0 on a miss."""
        mask = self.mask
        corners = self._mesh.vertices[self._mesh.faces[self.primitive_ids[mask]]].astype(np.float64)
        # To unit size first, so that no product over- or underflows.
        edges = corners[:, 1:] - corners[:, :1]
        size = np.max(np.abs(edges), axis=(1, 2), keepdims=True, initial=0.0)
        edges /= np.where(size > 0, size, 1.0)
        normal = np.cross(edges[:, 0], edges[:, 1])
        length = np.linalg.norm(normal, axis=-1, keepdims=True)
        normals = np.zeros((*mask.shape, 3))
        normals[mask] = normal / np.where(length > 0, length, 1.0)
        return normals

    @property
    def points(self) -> npt.NDArray[np.float64]:
        """(..., 3) float64: origin + t_hit * direction, in scene units; NaN on a miss."""
        t = np.where(self.mask, self.t_hit, np.nan)[..., None]
        points: npt.NDArray[np.float64] = self._origins + t * self._directions.astype(np.float64)
        return points


FIELDS = ("steps", "tests", "batches")
"""Of ``Hits``, beyond those that every cast computes."""


@dataclass(frozen=True)
class Rays:
    """Rays as kernels take them.

    Attributes
    ----------
    origins, directions : (..., 3) C-contiguous, both float32 or both float64
    bounds : (1, 2) or (N, 2) float64
        t_min and t_max, for all or by ray.
    """

    origins: npt.NDArray[Any]
    directions: npt.NDArray[Any]
    bounds: npt.NDArray[np.float64]


def as_bounded_rays(
    origins: npt.ArrayLike, directions: npt.ArrayLike | None, t_min: npt.ArrayLike, t_max: npt.ArrayLike
) -> Rays:
    """Rays with their interval; raises InputError as ``as_rays``."""
    o, d = as_rays(origins, directions)
    return Rays(o, d, _as_bounds(t_min, t_max, o.shape[:-1]))


def as_rays(
    origins: npt.ArrayLike, directions: npt.ArrayLike | None
) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Broadcast, C-contiguous (..., 3) arrays of one dtype: float32 if both are, else float64.

    Raises
    ------
    InputError
        If the arrays are not numbers, or not of shape (..., 3), or (..., 6) alone.
    """
    try:
        o = np.asarray(origins)
        d = o[..., 3:] if directions is None else np.asarray(directions)
    except (ValueError, IndexError) as error:
        raise InputError(f"rays are not arrays of numbers: {error}") from None
    if directions is None:
        if o.ndim == 0 or o.shape[-1] != 6:
            raise InputError(f"rays have shape {o.shape}; give (..., 6), or origins and directions")
        o = o[..., :3]
    for name, array in (("origins", o), ("directions", d)):
        if array.ndim == 0 or array.shape[-1] != 3:
            raise InputError(f"{name} have shape {array.shape}; give (..., 3)")
        if array.dtype.kind not in "fiu":
            raise InputError(f"{name} have dtype {array.dtype}; give real numbers")
    real = np.float32 if o.dtype == np.float32 and d.dtype == np.float32 else np.float64
    try:
        o, d = np.broadcast_arrays(o, d)
    except ValueError:
        raise InputError(f"origins {o.shape} and directions {d.shape} do not broadcast") from None
    return np.ascontiguousarray(o, real), np.ascontiguousarray(d, real)


def _as_bounds(t_min: npt.ArrayLike, t_max: npt.ArrayLike, shape: tuple[int, ...]) -> npt.NDArray[np.float64]:
    """(1, 2) float64 if both are scalars, else (N, 2).

    Raises
    ------
    InputError
        If they are not numbers, or do not broadcast to the rays.
    """
    try:
        low, high = np.asarray(t_min, np.float64), np.asarray(t_max, np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"t_min and t_max are not arrays of numbers: {error}") from None
    if low.ndim == 0 and high.ndim == 0:
        return np.array([[low, high]])
    try:
        both = [np.broadcast_to(side, shape).reshape(-1) for side in (low, high)]
    except ValueError:
        raise InputError(
            f"t_min {low.shape} and t_max {high.shape} do not broadcast to rays {shape}"
        ) from None
    return np.ascontiguousarray(np.stack(both, axis=-1))


# Enqueues a kernel over (inputs, number of rays, outputs), the parts of the argument list that
# every casting kernel shares.
Launch = Callable[[list[Any], int, list[Any], dict[str, int | str]], None]


def run(
    target: DeviceMesh,
    launch: Launch,
    rays_per_item: int,
    rays: Rays,
    extras: dict[str, npt.NDArray[Any]],
) -> Hits:
    """Cast rays of any leading shape by launches of a bounded number of them.

    Parameters
    ----------
    extras : dict of str to (N,) array
        Further results of the kernel, filled here; those of FIELDS become fields of the hits.
    """
    shape = rays.origins.shape[:-1]
    flat_o, flat_d = rays.origins.reshape(-1, 3), rays.directions.reshape(-1, 3)
    bounds, count = rays.bounds, len(flat_o)
    t_hit = np.full(count, np.inf)
    ids = np.full(count, _NO_HIT, np.uint32)
    uvs = np.zeros((count, 2), np.float32)
    invalid = 0
    most = min(_RAYS_PER_LAUNCH, largest_buffer(target.device) // _LARGEST_OF_A_RAY)
    for start in range(0, count, most):
        part = slice(start, min(start + most, count))
        inputs = [flat_o[part], flat_d[part], bounds if len(bounds) == 1 else bounds[part]]
        rejected = np.zeros(-(-len(inputs[0]) // rays_per_item), np.uint32)
        outputs = [t_hit[part], ids[part], uvs[part], rejected, *(array[part] for array in extras.values())]
        _launch(target.device, launch, inputs, outputs)
        invalid += int(rejected.sum())
    primitive_ids = np.where(ids == _NO_HIT, -1, ids.astype(np.int64))
    counted = [extras[field].reshape(shape) if field in extras else None for field in FIELDS]
    return Hits(
        t_hit.reshape(shape), primitive_ids.reshape(shape), uvs.reshape(*shape, 2), invalid, target.mesh,
        rays.origins, rays.directions, *counted,
    )  # fmt: skip


def _launch(
    device: Device, launch: Launch, rays: list[npt.NDArray[Any]], results: list[npt.NDArray[Any]]
) -> None:
    """One launch, straight on the host arrays where the device can; fills the results."""
    allocator = Allocator(device)
    inputs = [allocator.share(array) for array in rays]
    outputs = [allocator.results(array) for array in results]
    defines: dict[str, int | str] = {"RAY_REAL": "float" if rays[0].dtype == np.float32 else "double"}
    if len(rays[2]) > 1:
        defines["PER_RAY_T"] = 1
    launch(inputs, len(rays[0]), outputs, defines)
    for array, buffer in zip(results, outputs, strict=True):
        allocator.bring_home(array, buffer)


@dataclass(frozen=True)
class GridPart:
    """A part of the mesh with the grid over it; most grids have one."""

    mesh: MeshPart
    lists: CellLists

    @property
    def arguments(self) -> list[Any]:
        """The kernel arguments that every traversal takes, in the order of cl/grid.h."""
        return [*self.lists.arguments, self.mesh.vertices, self.mesh.faces]


def part_defines(parts: Sequence[GridPart]) -> dict[str, int | str]:
    """The option with which kernels take the parts of a mesh one after another."""
    return {"PARTS": 1} if len(parts) > 1 else {}


def cast_closest(target: DeviceMesh, parts: Sequence[GridPart], rays: Rays, fields: Sequence[str]) -> Hits:
    """Closest hits through the grids of all parts."""
    device, count = target.device, len(rays.origins.reshape(-1, 3))
    extras: dict[str, npt.NDArray[Any]] = {}
    options = part_defines(parts)
    if fields:
        extras |= {field: np.zeros(count, np.uint32) for field in FIELDS}
        options["COUNT_STEPS"] = 1
    if len(parts) > 1:
        extras["nearest"] = np.full(count, np.inf, np.float32)

    def launch(inputs: list[Any], count: int, outputs: list[Any], defines: dict[str, int | str]) -> None:
        for part in parts:
            kernel(
                device, "cast_closest.cl", "cast_closest", **defines, **options, **part.lists.defines
            )(
                device.queue, (-(-count // _RAYS_PER_ITEM),), (1,), target.frame_params,
                *part.arguments, *inputs, np.uint32(count), np.uint32(_RAYS_PER_ITEM), *outputs,
            )  # fmt: skip

    return run(target, launch, _RAYS_PER_ITEM, rays, extras)


def _soup(mesh: Mesh, frame: LocalFrame) -> npt.NDArray[np.float32]:
    """(9, N) float32 local coordinates, 3 * corner + axis; N is rounded up to a multiple of 8."""
    padded = np.zeros((9, -(-mesh.triangle_count // 8) * 8), np.float32)
    corners = frame.to_local(mesh.vertices)[mesh.faces]
    padded[:, : mesh.triangle_count] = corners.reshape(-1, 9).T
    return padded


def brute_force(
    mesh: Mesh,
    origins: npt.ArrayLike,
    directions: npt.ArrayLike | None = None,
    t_min: npt.ArrayLike = 0.0,
    t_max: npt.ArrayLike = np.inf,
    device: Device | str | None = None,
) -> Hits:
    """Closest hits by testing every triangle: the oracle that ``Grid.cast`` equals bit for bit.

    Parameters
    ----------
    mesh : Mesh
    origins, directions, t_min, t_max
        As for ``Grid.cast``.
    device : Device or str, optional
        As for ``build``.
    """
    chosen = device if isinstance(device, Device) else choose(device)
    rays = as_bounded_rays(origins, directions, t_min, t_max)
    if mesh.triangle_count == 0:
        return no_hits(mesh, rays, ())
    allocator = Allocator(chosen)
    target = DeviceMesh(mesh, chosen, allocator)
    soup = _soup(mesh, target.frame)
    soup_buffer = allocator.share(soup)

    def launch(inputs: list[Any], count: int, outputs: list[Any], defines: dict[str, int | str]) -> None:
        kernel(chosen, "brute_force.cl", "brute_force", **defines)(
            chosen.queue, (-(-count // _BRUTE_FORCE_RAYS),), (1,), target.frame_params,
            np.uint32(mesh.triangle_count), np.uint32(soup.shape[1]), soup_buffer,
            target.whole.vertices, target.whole.faces, *inputs, np.uint32(count), *outputs,
        )  # fmt: skip

    return run(target, launch, _BRUTE_FORCE_RAYS, rays, {})


def no_hits(mesh: Mesh, rays: Rays, fields: Sequence[str]) -> Hits:
    """The answer for a mesh without triangles."""
    o, d = rays.origins, rays.directions
    shape = o.shape[:-1]
    sound = np.isfinite(o).all(-1) & np.isfinite(d).all(-1) & (d != 0).any(-1)
    invalid = int(np.sum(~sound.reshape(-1) | np.isnan(rays.bounds).any(-1)))
    ids = np.full(shape, -1, np.int64)
    counted = [np.zeros(shape, np.uint32) if fields else None for _ in FIELDS]
    return Hits(np.full(shape, np.inf), ids, np.zeros((*shape, 2), np.float32), invalid, mesh, o, d, *counted)
