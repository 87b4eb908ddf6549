"""Casts rays given as arrays: against a grid, or against every triangle."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from clgrid.compact import CompactGrid
from clgrid.device import Device, choose
from clgrid.errors import InputError
from clgrid.frame import LocalFrame
from clgrid.memory import Allocator
from clgrid.mesh import Mesh
from clgrid.program import kernel

_NO_HIT = 0xFFFFFFFF
_RAYS_PER_ITEM = 64
_BRUTE_FORCE_RAYS = 16  # RAYS of cl/brute_force.cl
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
    """

    t_hit: npt.NDArray[np.float64]
    primitive_ids: npt.NDArray[np.int64]
    primitive_uvs: npt.NDArray[np.float32]
    invalid_rays: int
    _mesh: Mesh
    _origins: npt.NDArray[Any]
    _directions: npt.NDArray[Any]

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


class DeviceMesh:
    """A mesh in its local frame on a device.

    Parameters
    ----------
    mesh : Mesh
        With at least one triangle.
    device : Device
    """

    def __init__(self, mesh: Mesh, device: Device, allocator: Allocator) -> None:
        self.mesh = mesh
        self.device = device
        bounds = mesh.bounds
        self.frame = LocalFrame.of_bounds(bounds)
        self.local_bounds = self.frame.to_local(bounds).astype(np.float64)
        # One float to spare: the build reads vertices four floats at a time.
        padded = np.zeros(mesh.vertices.size + 1, np.float32)
        padded[:-1] = self.frame.to_local(mesh.vertices).reshape(-1)
        self.vertices = allocator.share(padded)
        self.faces = allocator.share(np.ascontiguousarray(mesh.faces))
        self.frame_params = allocator.upload(self.frame.params())


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
    origins: npt.ArrayLike,
    directions: npt.ArrayLike | None,
    t_min: npt.ArrayLike,
    t_max: npt.ArrayLike,
) -> Hits:
    """Cast rays of any leading shape by launches of a bounded number of them."""
    o, d = as_rays(origins, directions)
    shape = o.shape[:-1]
    bounds = _as_bounds(t_min, t_max, shape)
    flat_o, flat_d = o.reshape(-1, 3), d.reshape(-1, 3)
    count = len(flat_o)
    t_hit = np.full(count, np.inf)
    ids = np.full(count, _NO_HIT, np.uint32)
    uvs = np.zeros((count, 2), np.float32)
    invalid = 0
    for start in range(0, count, _RAYS_PER_LAUNCH):
        part = slice(start, min(start + _RAYS_PER_LAUNCH, count))
        rays = [flat_o[part], flat_d[part], bounds if len(bounds) == 1 else bounds[part]]
        rejected = np.zeros(-(-len(rays[0]) // rays_per_item), np.uint32)
        _launch(target.device, launch, rays, [t_hit[part], ids[part], uvs[part], rejected])
        invalid += int(rejected.sum())
    primitive_ids = np.where(ids == _NO_HIT, -1, ids.astype(np.int64))
    return Hits(
        t_hit.reshape(shape), primitive_ids.reshape(shape), uvs.reshape(*shape, 2), invalid, target.mesh, o, d
    )


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


def cast_closest(target: DeviceMesh, grid: CompactGrid, *rays: Any) -> Hits:
    """Closest hits through the grid; ``rays`` are the last four arguments of ``run``."""
    device = target.device

    def launch(inputs: list[Any], count: int, outputs: list[Any], defines: dict[str, int | str]) -> None:
        kernel(device, "cast_closest.cl", "cast_closest", **defines, **grid.defines)(
            device.queue, (-(-count // _RAYS_PER_ITEM),), (1,), target.frame_params,
            *grid.arguments, target.vertices, target.faces,
            *inputs, np.uint32(count), np.uint32(_RAYS_PER_ITEM), *outputs,
        )  # fmt: skip

    return run(target, launch, _RAYS_PER_ITEM, *rays)


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
    if mesh.triangle_count == 0:
        return no_hits(mesh, origins, directions, t_min, t_max)
    allocator = Allocator(chosen)
    target = DeviceMesh(mesh, chosen, allocator)
    soup = _soup(mesh, target.frame)
    soup_buffer = allocator.share(soup)

    def launch(inputs: list[Any], count: int, outputs: list[Any], defines: dict[str, int | str]) -> None:
        kernel(chosen, "brute_force.cl", "brute_force", **defines)(
            chosen.queue, (-(-count // _BRUTE_FORCE_RAYS),), (1,), target.frame_params,
            np.uint32(mesh.triangle_count), np.uint32(soup.shape[1]), soup_buffer,
            target.vertices, target.faces, *inputs, np.uint32(count), *outputs,
        )  # fmt: skip

    return run(target, launch, _BRUTE_FORCE_RAYS, origins, directions, t_min, t_max)


def no_hits(
    mesh: Mesh,
    origins: npt.ArrayLike,
    directions: npt.ArrayLike | None,
    t_min: npt.ArrayLike,
    t_max: npt.ArrayLike,
) -> Hits:
    """The answer for a mesh without triangles."""
    o, d = as_rays(origins, directions)
    shape = o.shape[:-1]
    bounds = _as_bounds(t_min, t_max, shape)
    sound = np.isfinite(o).all(-1) & np.isfinite(d).all(-1) & (d != 0).any(-1)
    invalid = int(np.sum(~sound.reshape(-1) | np.isnan(bounds).any(-1)))
    ids = np.full(shape, -1, np.int64)
    return Hits(np.full(shape, np.inf), ids, np.zeros((*shape, 2), np.float32), invalid, mesh, o, d)
