"""Where frames come from: the one place that knows what moves a mesh.

``poses_of`` gives what a painter needs: how many frames there are and the vertices of each. A scene that
brings ``frames`` of its own is taken as it is; a ``.npy`` file beside a mesh is read here.
"""

from __future__ import annotations

import gzip
from functools import cached_property
from pathlib import Path
from typing import Protocol

import numpy as np

from clgrid.animation.vertices import read_frames
from clgrid.errors import InputError
from clgrid.frames import bounds_of_all
from clgrid.mesh import FloatArray, Mesh
from clgrid.scene import Scene


class Poses(Protocol):
    """The frames of a moving mesh."""

    @property
    def count(self) -> int:
        """How many there are."""
        ...

    def vertices(self, k: int) -> FloatArray:
        """(V, 3): the vertices of frame ``k``, in the order of the mesh."""
        ...


class FilePoses:
    """The frames in a ``.npy`` file, gzipped or not."""

    def __init__(self, path: Path, mesh: Mesh) -> None:
        self._frames = read_frames(path, mesh)
        self._mesh = mesh

    @property
    def count(self) -> int:
        """How many there are."""
        return len(self._frames)

    def vertices(self, k: int) -> FloatArray:
        """(V, 3) float32: a copy of frame ``k``."""
        return np.array(self._frames[k], order="C")

    @cached_property
    def bounds(self) -> FloatArray:
        """(2, 3): of all frames."""
        return bounds_of_all(self._frames, self._mesh)


def poses_of(scene: Scene, vertices: str | None) -> Poses | None:
    """What moves a scene, if anything does.

    Raises
    ------
    InputError
        If the file of vertices cannot be used with the mesh.
    """
    if vertices is not None:
        return FilePoses(Path(vertices), scene.mesh)
    own: Poses | None = getattr(scene, "frames", None)
    return own


def bounds_of(poses: Poses, mesh: Mesh) -> FloatArray:
    """(2, 3): what the mesh reaches in any frame."""
    if isinstance(poses, FilePoses):
        return poses.bounds
    from clgrid.mesh import extent, used_vertices

    used = used_vertices(mesh)
    low, high = zip(*[extent(poses.vertices(k)[used]) for k in range(poses.count)], strict=True)
    return np.stack([np.min(low, axis=0), np.max(high, axis=0)]).astype(np.float64)


def count_in_file(path: Path) -> int | None:
    """Frames that the header of a ``.npy`` file tells, without reading them; None if it is none.

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    try:
        with gzip.open(path) if path.suffix.lower() == ".gz" else open(path, "rb") as file:
            version = np.lib.format.read_magic(file)
            read = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
            shape, _, _ = read[version](file)
            return int(shape[0]) if shape else None
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(
            f"vertices {path}: cannot be read ({reason}); give a .npy or .npy.gz file"
        ) from error
    except (ValueError, EOFError, KeyError):
        return None
