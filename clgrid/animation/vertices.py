"""Sequences of vertices: arrays beside a mesh."""

from __future__ import annotations

import gzip
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from clgrid.animation import Frames, even_times
from clgrid.errors import InputError
from clgrid.mesh import FloatArray, Mesh

if TYPE_CHECKING:
    from clgrid.scene import Scene

Positions = npt.NDArray[np.float32]


class VertexFrames(Frames):
    """Frames that are rows of a ``.npy`` file, which is mapped and not read, or of one gzipped."""

    def __init__(self, base: Scene, path: Path, fps: float) -> None:
        self.positions = read_frames(path, base.mesh)
        super().__init__(base, str(path), even_times(len(self.positions), fps))

    def vertices(self, k: int) -> FloatArray:
        """(V, 3) float32 positions of frame ``k``."""
        return np.array(self.positions[self.checked(k)], order="C")


def read_frames(path: Path, mesh: Mesh) -> Positions:
    """Read the vertices of each frame of a moving mesh.

    Parameters
    ----------
    path : Path
        A ``.npy`` file, or one gzipped.
    mesh : Mesh
        Whose vertices move.

    Returns
    -------
    (F, V, 3) float32
        Scene units, finite; at least one frame.

    Raises
    ------
    InputError
        If the file cannot be read, or is not such an array for this mesh.
    """
    frames: Positions = _read_array(path)
    if frames.dtype != np.float32 or frames.ndim != 3 or frames.shape[2] != 3 or not len(frames):
        raise InputError(
            f"frames {path}: dtype {frames.dtype.str} and shape {frames.shape}; "
            f"give {np.dtype(np.float32).str} of shape (frames, vertices, 3)"
        )
    if frames.shape[1] != len(mesh.vertices):
        raise InputError(
            f"frames {path}: {frames.shape[1]} vertices a frame, but {mesh.source} has {len(mesh.vertices)}; "
            "give the mesh that the frames belong to"
        )
    for k, frame in enumerate(frames):
        if not np.isfinite(frame).all():
            vertex = int(np.flatnonzero(~np.isfinite(frame).all(axis=1))[0])
            raise InputError(f"frames {path}: frame {k}, vertex {vertex} is NaN or infinite; repair the file")
    return frames


def count_in_file(path: Path) -> int:
    """Frames that the header of a ``.npy`` file tells, without reading them.

    Raises
    ------
    InputError
        If the file cannot be read, or is none.
    """
    try:
        with gzip.open(path) if path.suffix.lower() == ".gz" else open(path, "rb") as file:
            version = np.lib.format.read_magic(file)
            formats, old = np.lib.format, version == (1, 0)
            shape, _, _ = (formats.read_array_header_1_0 if old else formats.read_array_header_2_0)(file)
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(f"frames {path}: cannot be read ({reason}); give a .npy or .npy.gz file") from error
    except (ValueError, EOFError, zlib.error) as error:
        raise InputError(f"frames {path}: not a .npy or .npy.gz file ({error}); write it again") from error
    return int(shape[0]) if shape else 0


def _read_array(path: Path) -> npt.NDArray[Any]:
    """Read an array of numbers; a file that is not gzipped is mapped, not copied."""
    try:
        if path.suffix.lower() == ".gz":
            with gzip.open(path) as file:
                array = np.lib.format.read_array(file, allow_pickle=False)
        else:
            array = np.lib.format.open_memmap(path, mode="r")
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(f"frames {path}: cannot be read ({reason}); give a .npy or .npy.gz file") from error
    except (ValueError, EOFError, zlib.error, MemoryError, OverflowError) as error:
        reason = str(error) or type(error).__name__
        raise InputError(f"frames {path}: not a .npy or .npy.gz file ({reason}); write it again") from error
    return array
