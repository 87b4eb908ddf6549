"""Scenes that move: what their frames are, wherever these come from.

A frame is asked for when it is needed: nothing of the others is in memory, but of arrays of vertices.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from clgrid.errors import InputError
from clgrid.mesh import FloatArray, Mesh, used_vertices
from clgrid.outermost import extent

if TYPE_CHECKING:
    from clgrid.camera import Camera
    from clgrid.look import Look
    from clgrid.scene import Scene

DEFAULT_FPS = 24.0
MAX_FRAMES = 1_000_000


class Frames(ABC):
    """The frames of a scene, numbered from 0; what does not move is the scene's own.

    Attributes
    ----------
    source : str
        What the frames come from, for messages and records.
    times : (F,) float64
        Seconds.
    topology_changes : bool
        Whether frames may have other triangles than the scene's mesh; `vertices` then refuses those that do.
    mesh_moves : bool
        Whether the mesh does; else every frame has the scene's own, vertex normals too.
    cameras_move : bool
        Whether `cameras` differ from frame to frame.
    warnings : tuple of str
        What was left out, one line each.
    """

    topology_changes = False
    mesh_moves = True
    cameras_move = False
    warnings: tuple[str, ...] = ()

    def __init__(self, base: Scene, source: str, times: npt.NDArray[np.float64]) -> None:
        self.base = base
        self.source = source
        self.times = times

    @property
    def count(self) -> int:
        """Number of frames, at least 1."""
        return len(self.times)

    def __len__(self) -> int:
        return self.count

    @abstractmethod
    def vertices(self, k: int) -> FloatArray:
        """(V, 3) positions of frame ``k``, in the order of the scene's ``mesh.vertices``.

        Raises
        ------
        InputError
            If there is no such frame, or it has other triangles.
        """

    def mesh(self, k: int) -> Mesh:
        """The mesh of frame ``k``, without vertex normals where it is moved: they are of another shape."""
        self.checked(k)
        return self.base.mesh.moved(self.vertices(k)) if self.mesh_moves else self.base.mesh

    @cached_property
    def bounds(self) -> npt.NDArray[np.float64] | None:
        """(2, 3): what triangles reach in any frame, for a camera that sees all; None without a triangle.

        Computed once, from every frame.
        """
        if not self.mesh_moves:
            return self.base.mesh.bounds if self.base.mesh.triangle_count else None
        boxes = [box for box in map(self._box, range(self.count)) if box is not None]
        if not boxes:
            return None
        low, high = zip(*boxes, strict=True)
        return np.stack([np.min(low, axis=0), np.max(high, axis=0)]).astype(np.float64)

    def _box(self, k: int) -> FloatArray | None:
        """(2, 3): what triangles reach in frame ``k``."""
        return extent(self.vertices(k)[self._used]) if self.base.mesh.triangle_count else None

    @cached_property
    def _used(self) -> npt.NDArray[np.bool_]:
        return used_vertices(self.base.mesh)

    def look(self, k: int) -> Look | None:
        """The look of frame ``k``; lights may move."""
        self.checked(k)
        return self.base.look

    def cameras(self, k: int) -> tuple[Camera, ...]:
        """The cameras of frame ``k``, in the order of ``Scene.cameras``."""
        self.checked(k)
        return self.base.cameras

    def camera(self, k: int, selector: str = "0") -> Camera:
        """The camera of this name or index as it stands in frame ``k``.

        Raises
        ------
        InputError
            If there is no such frame or camera.
        """
        from clgrid.scene_cameras import camera_among

        return camera_among(self.cameras(k), selector, self.base.name)

    def scene(self, k: int) -> Scene:
        """Frame ``k`` as a scene that does not move."""
        return replace(self.base, mesh=self.mesh(k), frames_from=None, frame=(self, k))

    def checked(self, k: int) -> int:
        """Hand back ``k``.

        Raises
        ------
        InputError
            If it is no frame.
        """
        if not 0 <= k < self.count:
            raise InputError(f"frame {k}: {self.source} has frames 0 to {self.count - 1}")
        return k


def even_times(count: int, fps: float) -> npt.NDArray[np.float64]:
    """(count,) seconds of frames at a rate."""
    return np.arange(count, dtype=np.float64) / fps


def checked_fps(fps: float) -> float:
    """Hand back a rate.

    Raises
    ------
    InputError
        If it is none.
    """
    if not (fps > 0 and np.isfinite(fps)):
        raise InputError(f"fps {fps:g}: give frames a second, above 0")
    return float(fps)


def frames_of(scene: Scene) -> Frames | None:
    """The frames of a scene: those it was loaded with, else its file's animation; None where it has none.

    Raises
    ------
    MeshError, InputError
        If they cannot be read, or belong to another mesh.
    """
    fps = checked_fps(scene.fps)
    if scene.frames_from is not None:
        from clgrid.animation.files import FileFrames, frame_files, is_files
        from clgrid.animation.vertices import VertexFrames

        if is_files(scene.frames_from):
            return FileFrames(scene, frame_files(scene.frames_from), fps)
        return VertexFrames(scene, Path(scene.frames_from), fps)
    if scene.path is not None:
        from clgrid.animation.nodes import node_frames

        return node_frames(scene, scene.path, fps, scene.animation)
    return None
