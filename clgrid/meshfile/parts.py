"""What a reader of one format hands back, before it is checked as a `Mesh`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgrid.mesh import FloatArray


@dataclass(frozen=True)
class Parts:
    """The arrays of a mesh as a reader found them; fields as in `clgrid.mesh.Mesh`.

    ``faces`` may be of any integer type that holds the indices of the file: `clgrid.meshfile.read` checks the
    range and narrows them. ``untyped`` says that the vertices are doubles only because the file does not say
    what they are: they become float32 where that costs no shape.
    """

    vertices: FloatArray
    faces: npt.NDArray[np.integer]
    vertex_normals: npt.NDArray[np.float32] | None = None
    geometry_starts: npt.NDArray[np.int64] | None = None
    geometry_names: tuple[str, ...] = ("",)
    warnings: tuple[str, ...] = ()
    untyped: bool = False


def empty(*warnings: str) -> Parts:
    """Hand back no triangle, and why: for well-formed files that hold none."""
    return Parts(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint32), warnings=warnings)
