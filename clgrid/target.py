"""A mesh in its local frame on a device, whole or in parts that its buffers can hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from clgrid.device import Device
from clgrid.errors import MeshError
from clgrid.frame import LocalFrame
from clgrid.memory import Allocator, largest_buffer
from clgrid.mesh import Mesh
from clgrid.rungs import RUNGS, Rung

_CHUNK = 1 << 20


@dataclass(frozen=True)
class MeshPart:
    """Consecutive triangles on the device.

    Attributes
    ----------
    first, count : int
        Triangles first .. first + count - 1 of the mesh.
    vertices : buffer of float32
        Local coordinates, and one float to spare: the build reads vertices four floats at a time.
    faces : buffer of 3 count uint32
    local_bounds : (2, 3) float64
    wide_vertices : buffer of float64, optional
        The same coordinates, where float32 does not hold them and the rung keeps them.
    used : (V,) uint32, optional
        The mesh's numbers of the vertices, where the part has only those that it uses.
    """

    first: int
    count: int
    vertices: Any
    faces: Any
    local_bounds: npt.NDArray[np.float64]
    wide_vertices: Any = None
    used: npt.NDArray[np.uint32] | None = None

    @property
    def arguments(self) -> list[Any]:
        """The kernel arguments of MESH_PARAMETERS in cl/mesh.h."""
        wide = [] if self.wide_vertices is None else [self.wide_vertices]
        return [self.vertices, self.faces, *wide]

    @property
    def defines(self) -> dict[str, int | str]:
        """The options with which kernels that test its triangles are compiled."""
        return {} if self.wide_vertices is None else {"WIDE_VERTICES": 1}


class DeviceMesh:
    """A mesh in its local frame on a device.

    Parameters
    ----------
    mesh : Mesh
        With at least one triangle.
    device : Device
    allocator : Allocator
    rung : Rung
        What is to be cast through it.
    """

    def __init__(
        self, mesh: Mesh, device: Device, allocator: Allocator, rung: Rung = RUNGS["robust"]
    ) -> None:
        self.mesh = mesh
        self.device = device
        self.rung = rung
        self._allocator = allocator
        self._local = np.zeros(mesh.vertices.size + 1, np.float32)
        self._wide: npt.NDArray[np.float64] | None = None
        self._enter_frame(mesh)
        self._whole: MeshPart | None = None

    def _enter_frame(self, mesh: Mesh) -> None:
        self.mesh = mesh
        self.frame = LocalFrame.of_bounds(mesh.bounds)
        self.frame_params = self._allocator.upload(self.frame.params())

    def _write_local(self, out: npt.NDArray[np.float32]) -> None:
        local = out[:-1].reshape(-1, 3)
        self.frame.to_local(self.mesh.vertices, local)
        out[-1] = 0
        if self.rung.wide and not self.frame.holds(self.mesh.vertices, local):
            self._wide = self.frame.to_local_wide(self.mesh.vertices)
            if self.rung.name == "exact" and self._loses_used(self._wide):
                raise MeshError(
                    f"{self.mesh.source}: coordinates below 2^-1022 of the mesh's size, which exact cannot"
                    " hold; make them 0, or choose precise"
                )
        else:
            self._wide = None

    def _loses_used(self, wide: npt.NDArray[np.float64]) -> bool:
        """Whether a vertex of a triangle is not where the mesh has it: the others lie where they like."""
        if not self.frame.loses(self.mesh.vertices, wide):
            return False
        used = np.unique(self.mesh.faces)
        return self.frame.loses(self.mesh.vertices[used], wide[used])

    def _share_wide(self, wide: npt.NDArray[np.float64] | None) -> Any:
        return None if wide is None else self._allocator.share(wide)

    @property
    def whole(self) -> MeshPart:
        """The mesh as one part.

        Raises
        ------
        BufferTooLargeError
            If one buffer cannot hold the vertices or the faces.
        """
        if self._whole is None:
            self._write_local(self._local)
            self._whole = MeshPart(
                0,
                self.mesh.triangle_count,
                self._allocator.share(self._local),
                self._allocator.share(np.ascontiguousarray(self.mesh.faces)),
                self.frame.to_local(self.mesh.bounds).astype(np.float64),
                self._share_wide(self._wide),
            )
        return self._whole

    def parts(self, count: int) -> list[MeshPart]:
        """The mesh in so many runs of triangles of about equal length; in one, if the count is 1."""
        ends = np.linspace(0, self.mesh.triangle_count, count + 1).astype(np.int64)
        return self.runs(np.unique(ends).tolist())

    def runs(self, ends: Sequence[int]) -> list[MeshPart]:
        """The mesh in runs of triangles, each from one of the ascending numbers to the next."""
        if len(ends) == 2:
            return [self.whole]
        self._write_local(self._local)
        return [self._part(first, last) for first, last in pairwise(ends)]

    def _part(self, first: int, last: int) -> MeshPart:
        faces = self.mesh.faces[first:last]
        local, wide, used = self._local, self._wide, None
        if max(local.nbytes, 0 if wide is None else wide.nbytes) > largest_buffer(self.device):
            # Only the vertices that this part uses.
            used, inverse = np.unique(faces, return_inverse=True)
            faces = inverse.reshape(-1, 3).astype(np.uint32)
            local = np.zeros(3 * len(used) + 1, np.float32)
            local[:-1] = self._local[:-1].reshape(-1, 3)[used].reshape(-1)
            wide = None if wide is None else wide[used]
        bounds = _bounds(local[:-1].reshape(-1, 3), faces)
        share = self._allocator.share
        buffers = share(local), share(np.ascontiguousarray(faces))
        return MeshPart(first, last - first, *buffers, bounds, self._share_wide(wide), used)

    def move(self, mesh: Mesh) -> None:
        """Take the vertices of a mesh with the same faces; in place where the mesh is one part."""
        import pyopencl as cl

        self._enter_frame(mesh)
        if self._whole is None:
            return
        queue, vertices = self.device.queue, self._whole.vertices
        flags = cl.map_flags.WRITE_INVALIDATE_REGION
        mapped, _ = cl.enqueue_map_buffer(queue, vertices, flags, 0, self._local.shape, np.float32)
        self._write_local(mapped)
        mapped.base.release(queue)
        bounds = self.frame.to_local(mesh.bounds).astype(np.float64)
        wide = self._share_wide(self._wide)
        self._whole = MeshPart(0, mesh.triangle_count, vertices, self._whole.faces, bounds, wide)


def _bounds(local: npt.NDArray[np.float32], faces: npt.NDArray[np.uint32]) -> npt.NDArray[np.float64]:
    """(2, 3) of the vertices that the faces use."""
    bounds = np.array([[np.inf] * 3, [-np.inf] * 3])
    for start in range(0, len(faces), _CHUNK):
        corners = local[faces[start : start + _CHUNK].reshape(-1)]
        bounds[0] = np.minimum(bounds[0], corners.min(axis=0))
        bounds[1] = np.maximum(bounds[1], corners.max(axis=0))
    return bounds
