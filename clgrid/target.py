"""A mesh in its local frame on a device, whole or in parts that its buffers can hold."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from clgrid.device import Device
from clgrid.frame import LocalFrame
from clgrid.memory import Allocator, largest_buffer
from clgrid.mesh import Mesh

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
    """

    first: int
    count: int
    vertices: Any
    faces: Any
    local_bounds: npt.NDArray[np.float64]


class DeviceMesh:
    """A mesh in its local frame on a device.

    Parameters
    ----------
    mesh : Mesh
        With at least one triangle.
    device : Device
    allocator : Allocator
    """

    def __init__(self, mesh: Mesh, device: Device, allocator: Allocator) -> None:
        self.mesh = mesh
        self.device = device
        self._allocator = allocator
        self._local = np.zeros(mesh.vertices.size + 1, np.float32)
        self._enter_frame(mesh)
        self._whole: MeshPart | None = None

    def _enter_frame(self, mesh: Mesh) -> None:
        self.mesh = mesh
        self.frame = LocalFrame.of_bounds(mesh.bounds)
        self.frame_params = self._allocator.upload(self.frame.params())

    def _write_local(self, out: npt.NDArray[np.float32]) -> None:
        self.frame.to_local(self.mesh.vertices, out[:-1].reshape(-1, 3))
        out[-1] = 0

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
            )
        return self._whole

    def parts(self, count: int) -> list[MeshPart]:
        """The mesh in so many runs of triangles of about equal length; in one, if the count is 1."""
        if count == 1:
            return [self.whole]
        self._write_local(self._local)
        ends = np.linspace(0, self.mesh.triangle_count, count + 1).astype(np.int64)
        pairs = zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True)
        return [self._part(first, last) for first, last in pairs if last > first]

    def _part(self, first: int, last: int) -> MeshPart:
        faces = self.mesh.faces[first:last]
        local = self._local
        if local.nbytes > largest_buffer(self.device):
            # Only the vertices that this part uses.
            used, inverse = np.unique(faces, return_inverse=True)
            faces = inverse.reshape(-1, 3).astype(np.uint32)
            local = np.zeros(3 * len(used) + 1, np.float32)
            local[:-1] = self._local[:-1].reshape(-1, 3)[used].reshape(-1)
        bounds = _bounds(local[:-1].reshape(-1, 3), faces)
        share = self._allocator.share
        return MeshPart(first, last - first, share(local), share(np.ascontiguousarray(faces)), bounds)

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
        self._whole = MeshPart(0, mesh.triangle_count, vertices, self._whole.faces, bounds)


def _bounds(local: npt.NDArray[np.float32], faces: npt.NDArray[np.uint32]) -> npt.NDArray[np.float64]:
    """(2, 3) of the vertices that the faces use."""
    bounds = np.array([[np.inf] * 3, [-np.inf] * 3])
    for start in range(0, len(faces), _CHUNK):
        corners = local[faces[start : start + _CHUNK].reshape(-1)]
        bounds[0] = np.minimum(bounds[0], corners.min(axis=0))
        bounds[1] = np.maximum(bounds[1], corners.max(axis=0))
    return bounds
