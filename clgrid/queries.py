"""What can be asked of a grid: the queries that ``Grid`` offers, arrays in, arrays out."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from clgrid import cast as casting
from clgrid import on_device
from clgrid.cast import GridPart
from clgrid.cast_all import cast_all
from clgrid.closed import open_edges
from clgrid.device import Device
from clgrid.errors import InputError
from clgrid.hits import ALL_FIELDS, AllHits, Hits, checked_fields
from clgrid.mesh import Mesh
from clgrid.on_device import DeviceHits
from clgrid.rays import as_bounded_rays, invalid_count
from clgrid.rungs import Rung
from clgrid.target import DeviceMesh
from clgrid.under_way import UnderWay

# Along which ``contains`` counts: askew, so that edges of grids and of modelled boxes are seldom met. Any
# direction gives the same answers on the rung ``exact``.
PARITY_DIRECTION = (0.81649658, 0.48112522, 0.31943828)


class Queries(ABC):
    """Queries of whatever has a mesh on a device and grids over its parts."""

    mesh: Mesh
    device: Device
    under_way: UnderWay

    @property
    @abstractmethod
    def rung(self) -> Rung:
        """The rung, as kernels are compiled for it."""

    @property
    @abstractmethod
    def target(self) -> DeviceMesh:
        """The mesh on the device; only for a mesh that has triangles."""

    @property
    @abstractmethod
    def standing(self) -> list[GridPart]:
        """The parts of a grid that is not empty."""

    @property
    def empty(self) -> bool:
        """Whether the mesh has no triangles; every ray then misses."""
        return self.mesh.triangle_count == 0

    def cast(
        self,
        origins: npt.ArrayLike,
        directions: npt.ArrayLike | None = None,
        t_min: npt.ArrayLike = 0.0,
        t_max: npt.ArrayLike = np.inf,
        fields: Sequence[str] | None = None,
    ) -> Hits:
        """Closest hit of each ray: least t, then least triangle.

        Parameters
        ----------
        origins : (..., 3) or (..., 6) float32 or float64
            Scene units; with six components, the last three are the directions.
        directions : (..., 3) float32 or float64
            Of any length but zero; broadcast against the origins. Beyond 2^960 times the mesh's size or its
            inverse a ray is counted as invalid, and misses.
        t_min, t_max : float or (...) float64
            Closed interval of the ray parameter, in lengths of the direction.
        fields : sequence of str, optional
            What to compute beside t_hit and primitive_ids, and nothing else: "primitive_uvs" (all there is by
            default), "t_err"; on the rung ``exact``, "certain"; "steps", "tests", "batches": cells that each
            ray looked at, triangles of their lists, and the batches of eight that these were tested in, list
            by list. Any of these three gives all. Rays that are not counted test several lists at once, and
            a triangle that they meet again not again.

        Returns
        -------
        Hits

        Raises
        ------
        InputError
            If shapes or dtypes do not fit, or a field is unknown or of another rung.
        """
        wanted = checked_fields(fields, self.rung.name)
        rays = as_bounded_rays(origins, directions, t_min, t_max)
        if self.empty:
            return casting.no_hits(self.mesh, rays, wanted, self.rung.real)
        return casting.cast_closest(self.target, self.standing, rays, wanted)

    def cast_on_device(
        self,
        queue: Any,
        origins: Any,
        directions: Any,
        t_min: npt.ArrayLike = 0.0,
        t_max: npt.ArrayLike = np.inf,
        fields: Sequence[str] | None = None,
    ) -> DeviceHits:
        """``cast`` for rays that are on the device; the hits stay there. Does not wait for them.

        For rays that other kernels make, and hits that others take. On CPU devices ``cast`` copies nothing
        either: it works on numpy's own memory, and sorts incoherent rays; here the order is the caller's.
        Rays that run near each other are to be next to each other, or above each other in an image.

        Parameters
        ----------
        queue : pyopencl.CommandQueue
            Of the context of the grid's device (``grid.device.context``).
        origins, directions : pyopencl.array.Array of (..., 3) float32 or float64
            Both of one shape and dtype; scene units, and any length but zero.
        t_min, t_max, fields
            As of ``cast``: numbers, or arrays of the host.

        Returns
        -------
        DeviceHits
            The bits of ``cast``; ``get()`` makes Hits of it.

        Raises
        ------
        InputError
            If an array or the queue is of another context, or shapes, dtypes, strides or fields do not fit.
        """
        wanted = checked_fields(fields, self.rung.name)
        empty = self.empty
        rays = on_device.checked(self.device, queue, origins, directions, t_min, t_max)
        if empty:
            return on_device.misses(self.mesh, queue, rays, wanted, self.rung)
        hits = on_device.cast_closest(self.target, self.standing, queue, rays, wanted)
        self.under_way.add(hits.event)
        return hits

    def occluded_on_device(
        self,
        queue: Any,
        origins: Any,
        directions: Any,
        t_min: npt.ArrayLike = 0.0,
        t_max: npt.ArrayLike = np.inf,
    ) -> Any:
        """``occluded`` for rays that are on the device; the answers stay there. Does not wait for them.

        Parameters, errors
            As of ``cast_on_device``.

        Returns
        -------
        pyopencl.array.Array of (...) uint8
            1 where a ray meets a triangle, else 0; what is done with it on the queue waits for the kernel.
        """
        empty = self.empty
        rays = on_device.checked(self.device, queue, origins, directions, t_min, t_max)
        if empty:
            return on_device.zeros(queue, rays, np.uint8)
        return self._noted(on_device.cast_any(self.target, self.standing, queue, rays))

    def count_on_device(
        self,
        queue: Any,
        origins: Any,
        directions: Any,
        t_min: npt.ArrayLike = 0.0,
        t_max: npt.ArrayLike = np.inf,
    ) -> Any:
        """``count`` for rays that are on the device; the answers stay there. Does not wait for them.

        Parameters, errors
            As of ``cast_on_device``.

        Returns
        -------
        pyopencl.array.Array of (...) uint32
            How many triangles each ray meets; what is done with it on the queue waits for the kernel.
        """
        empty = self.empty
        rays = on_device.checked(self.device, queue, origins, directions, t_min, t_max)
        if empty:
            return on_device.zeros(queue, rays, np.uint32)
        return self._noted(on_device.count_hits(self.target, self.standing, queue, rays))

    def _noted(self, answers: Any) -> Any:
        """The array, with the kernels that it waits for noted as readers of the grid."""
        for event in answers.events:
            self.under_way.add(event)
        return answers

    def occluded(
        self,
        origins: npt.ArrayLike,
        directions: npt.ArrayLike | None = None,
        t_min: npt.ArrayLike = 0.0,
        t_max: npt.ArrayLike = np.inf,
    ) -> npt.NDArray[np.bool_]:
        """(...) bool: whether each ray meets a triangle; it stops at the first that it comes upon.

        Parameters, errors
            As of ``cast``.
        """
        rays = as_bounded_rays(origins, directions, t_min, t_max)
        if self.empty:
            return np.zeros(rays.origins.shape[:-1], bool)
        return casting.cast_any(self.target, self.standing, rays)

    def count(
        self,
        origins: npt.ArrayLike,
        directions: npt.ArrayLike | None = None,
        t_min: npt.ArrayLike = 0.0,
        t_max: npt.ArrayLike = np.inf,
    ) -> npt.NDArray[np.uint32]:
        """(...) uint32: how many triangles each ray meets.

        On the rung ``exact``, each crossing of a closed surface counts once, at edges and vertices too. On
        the others, a ray through an edge may meet both of its triangles.

        Parameters, errors
            As of ``cast``.
        """
        rays = as_bounded_rays(origins, directions, t_min, t_max)
        if self.empty:
            return np.zeros(rays.origins.shape[:-1], np.uint32)
        return casting.count_hits(self.target, self.standing, rays)

    def cast_all(
        self,
        origins: npt.ArrayLike,
        directions: npt.ArrayLike | None = None,
        t_min: npt.ArrayLike = 0.0,
        t_max: npt.ArrayLike = np.inf,
        fields: Sequence[str] | None = None,
    ) -> AllHits:
        """Every triangle that each ray meets, by t, then by triangle.

        Parameters
        ----------
        origins, directions, t_min, t_max
            As of ``cast``.
        fields : sequence of {"primitive_uvs", "t_err"}, optional
            What to compute beside t_hit and primitive_ids; by default "primitive_uvs".

        Raises
        ------
        InputError
            As ``cast``, or if there are more hits than a buffer of the device holds.
        """
        wanted = checked_fields(fields, self.rung.name, ALL_FIELDS)
        rays = as_bounded_rays(origins, directions, t_min, t_max)
        if self.empty:
            none = casting.blank(0, wanted, self.rung.real)
            splits = np.zeros(len(rays.origins.reshape(-1, 3)) + 1, np.int64)
            ids = none.pop("primitive_ids").astype(np.int64)
            t, invalid = none.pop("t_hit"), invalid_count(rays)
            return AllHits(splits, t, ids, invalid, self.mesh, rays.origins, rays.directions, none)
        return cast_all(self.target, self.standing, rays, wanted)

    @cached_property
    def open_edges(self) -> int:
        """Edges, by position, that an odd number of triangles have; 0 if the mesh is closed."""
        return open_edges(self.mesh)

    def contains(self, points: npt.ArrayLike, require_closed: bool = True) -> npt.NDArray[np.bool_]:
        """(...) bool: whether each point is inside: rays from it then leave an odd number of times.

        Right for every point on the rung ``exact``, where a point of the surface itself counts as the point
        beside it, an infinitesimal farther along x (then y, then z). On other rungs a ray that passes an edge
        may be counted twice.

        Parameters
        ----------
        points : (..., 3) float32 or float64
            Scene units. One that is not finite is not inside.
        require_closed : bool
            Whether to refuse a mesh that has no inside, since it is not closed.

        Raises
        ------
        InputError
            If the shape or dtype does not fit, or the mesh is not closed.
        """
        if require_closed and self.open_edges:
            raise InputError(
                f"contains: {self.mesh.source} is not closed, {self.open_edges:,} edges have an odd number of"
                " triangles; close it, or pass require_closed=False and mind what inside then means"
            )
        rays = as_bounded_rays(points, np.array(PARITY_DIRECTION), 0.0, np.inf)
        if self.empty:
            return np.zeros(rays.origins.shape[:-1], bool)
        counts = casting.count_hits(self.target, self.standing, rays, open_start=True)
        return np.not_equal(counts % 2, 0)
