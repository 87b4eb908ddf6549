"""Rays that go on behind what they met: masked texels, and backs of single-sided surfaces.

Such rays are cast again for all that they meet, by t, then by triangle, and take the first that they do not
pass. So none is lost, whatever lies in one place with what was passed: the triangles are those of
``Grid.cast_all``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from clgrid.cast import NO_HIT, GridPart
from clgrid.cast_all import cast_all
from clgrid.memory import Allocator
from clgrid.program import kernel
from clgrid.rays import Rays
from clgrid.shading.surfaces import Surfaces
from clgrid.target import DeviceMesh

_HITS_PER_ITEM = 64  # as in cl/pass_surfaces.cl
# Rays whose hits are all held at once.
_RAYS_AT_ONCE = 1 << 16


class Passing:
    """What rays pass of a mesh.

    Parameters
    ----------
    target, parts
        The mesh and its grids.
    surfaces : Surfaces
        Its look.
    arguments : sequence of list
        Of the look, a part of the mesh each.
    """

    def __init__(
        self,
        target: DeviceMesh,
        parts: Sequence[GridPart],
        surfaces: Surfaces,
        arguments: Sequence[list[Any]],
    ) -> None:
        self._target = target
        self._parts = parts
        self._surfaces = surfaces
        self._arguments = arguments
        self._allocator = Allocator(target.device)

    def passed(
        self,
        ids: npt.NDArray[np.uint32],
        weights: npt.NDArray[Any],
        rays: npt.NDArray[np.uint32],
        directions: npt.NDArray[np.float64],
        *,
        sided: bool,
    ) -> npt.NDArray[np.bool_]:
        """(H,) bool: whether each of H hits is passed.

        Parameters
        ----------
        ids, weights : (H,), (H, 2)
            Triangles, and weights of their second and third corners.
        rays : (H,)
            Rows of ``directions``.
        sided : bool
            Whether backs of single-sided surfaces are.
        """
        passes = np.zeros(len(ids), np.uint8)
        if not len(ids):
            return passes.astype(bool)
        allocator, device, rung = self._allocator, self._target.device, self._target.rung
        shared = [allocator.share(np.ascontiguousarray(array)) for array in (ids, weights, rays, directions)]
        output = allocator.results(passes)
        items = -(-len(ids) // _HITS_PER_ITEM)
        for part, look in zip(self._parts, self._arguments, strict=True):
            options = {"REAL": "float" if rung.real is np.float32 else "double", **self._surfaces.defines}
            kernel(device, "pass_surfaces.cl", "pass_surfaces", **options, **part.mesh.defines)(
                device.queue, (items,), (1,), *part.mesh.arguments, *look,
                np.uint32(len(ids)), np.uint32(sided), *shared, output,
            )  # fmt: skip
        allocator.bring_home(passes, output)
        return passes.astype(bool)

    def see_through(
        self,
        t: npt.NDArray[np.float64],
        ids: npt.NDArray[np.uint32],
        weights: npt.NDArray[Any],
        origins: npt.NDArray[np.float64],
        directions: npt.NDArray[np.float64],
    ) -> bool:
        """Replace hits that rays of the eye pass by what is behind, or by misses; whether there were any."""
        rows = np.arange(len(ids), dtype=np.uint32)
        going_on = np.flatnonzero(self.passed(ids, weights, rows, directions, sided=True))
        for rays, first, hits in self._stops(going_on, origins, directions, np.inf, sided=True):
            t[rays], ids[rays], weights[rays] = np.inf, NO_HIT, 0
            stopped = first >= 0
            stops = first[stopped]
            t[rays[stopped]] = hits.t_hit[stops]
            ids[rays[stopped]] = hits.primitive_ids[stops].astype(np.uint32)
            weights[rays[stopped]] = hits.primitive_uvs[stops]
        return bool(len(going_on))

    def let_through(
        self,
        occluded: npt.NDArray[np.uint8],
        origins: npt.NDArray[np.float64],
        directions: npt.NDArray[np.float64],
        t_max: float,
    ) -> None:
        """Clear what stands before no light: rays that meet nothing up to ``t_max`` but masked texels."""
        for rays, first, _ in self._stops(np.flatnonzero(occluded), origins, directions, t_max, sided=False):
            occluded[rays] = first >= 0

    def _stops(
        self, among: npt.NDArray[np.int64], origins: Any, directions: Any, t_max: float, *, sided: bool
    ) -> Any:
        """Runs of the rays named, the number of the first hit that each does not pass or -1, and all hits."""
        for start in range(0, len(among), _RAYS_AT_ONCE):
            rays = among[start : start + _RAYS_AT_ONCE]
            some = Rays(origins[rays], directions[rays], np.array([[0.0, t_max]]))
            hits = cast_all(self._target, self._parts, some, ("primitive_uvs",))
            numbers = np.repeat(np.arange(len(rays), dtype=np.uint32), np.diff(hits.ray_splits))
            ids = hits.primitive_ids.astype(np.uint32)
            passed = self.passed(ids, hits.primitive_uvs, numbers, some.directions, sided=sided)
            first = np.full(len(rays), -1, np.int64)
            stops = np.flatnonzero(~passed)
            # Backwards, so that the first of each ray is what stays.
            first[numbers[stops[::-1]]] = stops[::-1]
            yield rays, first, hits
