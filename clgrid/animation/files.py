"""A file a frame: folders and globs of meshes."""

from __future__ import annotations

import glob
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from clgrid.animation import Frames, even_times
from clgrid.errors import InputError
from clgrid.mesh import FloatArray, Mesh, load
from clgrid.meshfile import READERS

if TYPE_CHECKING:
    from clgrid.camera import Camera
    from clgrid.look import Look
    from clgrid.scene import Scene

_WILD = re.compile(r"[*?\[]")


def is_files(name: str | Path) -> bool:
    """Whether a name is a folder or, where no file has it, a pattern such as ``cow_*.ply``."""
    return Path(name).is_dir() or (not Path(name).is_file() and bool(_WILD.search(str(name))))


def frame_files(name: str | Path) -> tuple[Path, ...]:
    """Mesh files of a folder or a pattern, in the order of the numbers in their names.

    Raises
    ------
    InputError
        If there is none.
    """
    folder = Path(name)
    found = list(folder.iterdir()) if folder.is_dir() else [Path(text) for text in glob.glob(str(name))]
    meshes = [path for path in found if path.is_file() and _suffix(path) in READERS]
    if not meshes:
        raise InputError(f"frames {name}: no mesh file there; give a folder or a pattern such as 'cow_*.ply'")
    return tuple(sorted(meshes, key=_by_numbers))


def shared_name(name: str | Path) -> str:
    """Name for a folder, or for a pattern what its files have in common."""
    path = Path(name)
    if path.is_dir():
        return path.resolve().name
    common = _WILD.split(path.name)[0].rstrip("_-. ")
    return common or path.resolve().parent.name


def _suffix(path: Path) -> str:
    return (path.with_suffix("") if path.suffix.lower() == ".gz" else path).suffix.lower()


def _by_numbers(path: Path) -> tuple[tuple[int, int, str], ...]:
    """``a_2`` before ``a_10``."""
    parts = re.split(r"([0-9]+)", path.name)
    return tuple((1, int(part), part) if part.isdecimal() else (0, 0, part) for part in parts)


class FileFrames(Frames):
    """Frames that are files each; triangles may be others in each, so that each is a scene of its own."""

    topology_changes = True

    def __init__(self, base: Scene, files: Sequence[Path], fps: float) -> None:
        super().__init__(base, str(base.frames_from), even_times(len(files), fps))
        self.files = tuple(files)
        self.cameras_move = any(_suffix(path) in (".glb", ".gltf") for path in files)

    def mesh(self, k: int) -> Mesh:
        """The mesh of file ``k``."""
        path = self.files[self.checked(k)]
        return self.base.mesh if path == self.base.path else load(path)

    def vertices(self, k: int) -> FloatArray:
        """(V, 3) positions of frame ``k``.

        Raises
        ------
        InputError
            If the frame has other triangles than the scene's mesh.
        """
        mesh = self.mesh(k)
        same = len(mesh.vertices) == len(self.base.mesh.vertices)
        if not same or not np.array_equal(mesh.faces, self.base.mesh.faces):
            raise InputError(
                f"frame {k}: {self.files[k]} has other triangles than {self.base.mesh.source}; "
                "build its scene anew"
            )
        return mesh.vertices

    def _box(self, k: int) -> FloatArray | None:
        mesh = self.mesh(k)
        return mesh.bounds if mesh.triangle_count else None

    def look(self, k: int) -> Look | None:
        """The look of file ``k``."""
        return self.scene(k).look

    def cameras(self, k: int) -> tuple[Camera, ...]:
        """The cameras of file ``k``."""
        return self.scene(k).cameras

    def scene(self, k: int) -> Scene:
        """File ``k`` as a scene."""
        return replace(self.base, mesh=self.mesh(k), path=self.files[k], frames_from=None)
