"""Triangles as arrays: what every stage below works on."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from clgrid.errors import MeshError

FloatArray = npt.NDArray[np.float32] | npt.NDArray[np.float64]


@dataclass(frozen=True)
class Mesh:
    """A triangle mesh: the arrays, and nothing that a ray does not need.

    Attributes
    ----------
    vertices : (V, 3) float32 or float64
        Positions in scene units, all finite. Doubles are kept where the source has them.
    faces : (F, 3) uint32
        Vertex indices of each triangle, each below ``V``.
    vertex_normals : (V, 3) float32 or None
        Shading normals, where the file has them; not necessarily of unit length.
    geometry_starts : (G + 1,) int64
        Triangle ``f`` belongs to geometry ``g`` with
        ``geometry_starts[g] <= f < geometry_starts[g + 1]``.
    geometry_names : tuple of str
        One name a geometry, possibly empty.
    source : str
        Where the mesh came from, for messages and records.
    warnings : tuple of str
        What the loader changed or left out, one line each.
    """

    vertices: FloatArray
    faces: npt.NDArray[np.uint32]
    vertex_normals: npt.NDArray[np.float32] | None = None
    geometry_starts: npt.NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    geometry_names: tuple[str, ...] = ()
    source: str = "<arrays>"
    warnings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.geometry_starts.size == 0:
            object.__setattr__(self, "geometry_starts", np.array([0, len(self.faces)], np.int64))
            object.__setattr__(self, "geometry_names", self.geometry_names or ("",))
        validate(self)

    @property
    def triangle_count(self) -> int:
        """Number of triangles, degenerate ones included."""
        return len(self.faces)

    @property
    def nbytes(self) -> int:
        """Bytes of all arrays."""
        normals = 0 if self.vertex_normals is None else self.vertex_normals.nbytes
        return self.vertices.nbytes + self.faces.nbytes + normals

    @property
    def bounds(self) -> npt.NDArray[np.float64]:
        """(2, 3) float64: lowest and highest corner; of the vertices that a triangle uses.

        Raises
        ------
        MeshError
            If the mesh has no triangle.
        """
        raise NotImplementedError

    def geometry_ids(self, primitive_ids: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
        """Geometry of each triangle id; -1 stays -1.

        Parameters
        ----------
        primitive_ids : (...) int64
            Triangle ids, -1 for a miss.
        """
        found = np.searchsorted(self.geometry_starts, primitive_ids, side="right") - 1
        return np.where(primitive_ids < 0, -1, found).astype(np.int64)


def validate(mesh: Mesh) -> None:
    """Raise MeshError unless shapes, dtypes, finiteness and index ranges are as documented."""
    raise MeshError("not written yet")


def load(path: str | Path) -> Mesh:
    """Read a mesh file (PLY, OBJ, STL, OFF, GLB, glTF; each also gzipped) without changing it."""
    from clgrid.meshfile import read

    return read(Path(path))


__all__ = ["Mesh", "load", "validate", "Any"]
