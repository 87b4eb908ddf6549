"""Scenes: a mesh by file or by name, its cameras, and the view it gets where none is asked for."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from clgrid import procedural
from clgrid.animation import DEFAULT_FPS, checked_fps
from clgrid.camera import DEFAULT_FOV, Camera
from clgrid.errors import InputError
from clgrid.mesh import Mesh, load
from clgrid.scene_cameras import camera_among, camera_file, camera_of

if TYPE_CHECKING:
    from clgrid.animation import Frames
    from clgrid.look import Look
    from clgrid.meshfile.gltf_cameras import GltfCamera

# Bounds whose z extent is below this share of both others lie flat: terrain, sheets, plates.
_FLAT = 0.25
_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


@dataclass(frozen=True)
class Scene:
    """A mesh with what a picture of it needs besides; that is read at the first use and kept.

    Attributes
    ----------
    name : str
        Short name for tables and records.
    mesh : Mesh
        The triangles.
    path : Path or None
        The file, None for a built-in scene.
    frames_from : str or Path or None
        Where frames come from, if not from the file's own animation: as for `load_scene`.
    fps : float
        Frames a second, at which animations are sampled.
    animation : str or int or None
        Name or number among the animations of a glTF file; None for the first.
    frame : (Frames, int) or None
        The moving scene and the number of its frame that this is.
    """

    name: str
    mesh: Mesh
    path: Path | None = None
    frames_from: str | Path | None = None
    fps: float = DEFAULT_FPS
    animation: str | int | None = None
    frame: tuple[Frames, int] | None = field(default=None, repr=False, compare=False)

    @cached_property
    def look(self) -> Look | None:
        """Materials, textures, colours and lights; None where the file has none.

        Raises
        ------
        MeshError
            If they are malformed; what can be done without is a warning in ``Look.warnings``.
        """
        from clgrid.lookfile import read_look

        if self.frame is not None:
            return self.frame[0].look(self.frame[1])
        return None if self.path is None else read_look(self.path, self.mesh)

    @cached_property
    def cameras(self) -> tuple[Camera, ...]:
        """All cameras of the file, perspective and orthographic, in its order; none but for glTF.

        Raises
        ------
        MeshError, InputError
            If one is malformed.
        """
        if self.frame is not None:
            return self.frame[0].cameras(self.frame[1])
        return tuple(camera_of(camera) for camera in gltf_cameras(self))

    @cached_property
    def frames(self) -> Frames | None:
        """The frames of a scene that moves; None for one that does not, and for a single frame.

        Raises
        ------
        MeshError, InputError
            If they cannot be read, or belong to another mesh.
        """
        from clgrid.animation import frames_of

        return None if self.frame is not None else frames_of(self)


def load_scene(
    name: str | Path,
    frames: str | Path | None = None,
    *,
    fps: float = DEFAULT_FPS,
    animation: str | int | None = None,
) -> Scene:
    """Load a mesh file, or make a built-in scene where there is no such file.

    Parameters
    ----------
    name : str or Path
        A path, or ``demo``, ``cube``, ``icosphere[:N]``, ``terrain[:N]``; or a folder of mesh files or a
        pattern such as ``cow_*.ply``: the scene is the first of them, all are its frames.
    frames : str or Path, optional
        A ``.npy`` or ``.npy.gz`` file of float32 (frames, vertices, 3), a folder or a pattern of mesh files.
        Without it, a glTF file's own animation makes `Scene.frames`.
    fps : float
        Frames a second, at which animations are sampled.
    animation : str or int, optional
        Name or number of one of several animations in a glTF file; the first if not given.

    Raises
    ------
    MeshError
        If the file cannot be used.
    InputError
        If a built-in name has an argument out of range, no file fits the pattern, or ``fps`` is not positive.
    """
    from clgrid.animation.files import frame_files, is_files, shared_name

    checked_fps(fps)
    path = Path(name)
    if not path.is_file() and procedural.is_name(str(name)):
        return Scene(str(name), procedural.make(str(name)), None, frames, fps, animation)
    if is_files(name):
        if frames is not None:
            raise InputError(f"frames {frames}: {name} is a sequence already; give one of them")
        first = frame_files(name)[0]
        return Scene(shared_name(name), load(first), first, name, fps, animation)
    return Scene(short_name(path), load(path), path, frames, fps, animation)


def count_frames(name: str, frames: str | None, fps: float, animation: str | int | None) -> int:
    """Count the frames that a scene would have; 1 for one that stands still.

    Of arrays the header is read and of files the names; only a glTF file is loaded.

    Parameters
    ----------
    name, frames, fps, animation
        As for `clgrid.load_scene`.

    Raises
    ------
    MeshError, InputError
        If they cannot be read.
    """
    from clgrid.animation.files import frame_files, is_files
    from clgrid.animation.vertices import count_in_file

    checked_fps(fps)
    if frames is not None:
        return len(frame_files(frames)) if is_files(frames) else count_in_file(Path(frames))
    if is_files(name):
        return len(frame_files(name))
    if not _may_move(Path(name)) and animation is None:
        return 1
    own = load_scene(name, fps=fps, animation=animation).frames
    return 1 if own is None else own.count


def _may_move(path: Path) -> bool:
    """Whether files of this name can hold an animation."""
    return path.name.lower().removesuffix(".gz").endswith((".gltf", ".glb"))


def short_name(path: Path) -> str:
    """Return the file's name without ``.gz`` and its format's suffix."""
    stem = path.with_suffix("") if path.suffix.lower() == ".gz" else path
    return stem.stem


def up_axis(scene: Scene | Mesh) -> tuple[float, float, float]:
    """Guess which way is up: +z for STL and for bounds flat in z, +y for glTF and all else.

    glTF is y-up by its specification, even where flat; STL comes from CAD and printing, where z is up.
    """
    mesh = scene.mesh if isinstance(scene, Scene) else scene
    name = mesh.source.lower().removesuffix(".gz")
    if name.endswith(".stl"):
        return _AXES["z"]
    if name.endswith((".glb", ".gltf")) or not mesh.triangle_count:
        return _AXES["y"]
    x, y, z = np.ptp(mesh.bounds, axis=0)
    return _AXES["z"] if z < _FLAT * min(x, y) else _AXES["y"]


def parse_up(text: str, scene: Scene | Mesh) -> tuple[float, float, float]:
    """Read ``auto``, ``x``, ``-z``... or ``X,Y,Z`` as a direction.

    Raises
    ------
    InputError
        If it is none of these.
    """
    if text == "auto":
        return up_axis(scene)
    sign, axis = (-1.0, text[1:]) if text[:1] == "-" else (1.0, text.removeprefix("+"))
    if axis in _AXES:
        x, y, z = _AXES[axis]
        return (sign * x, sign * y, sign * z)
    return parse_vector(text, "up")


def parse_vector(text: str, what: str) -> tuple[float, float, float]:
    """Read ``X,Y,Z``.

    Raises
    ------
    InputError
        If it is not three finite numbers.
    """
    try:
        x, y, z = (float(part) for part in text.replace(",", " ").split())
    except ValueError:
        raise InputError(f"{what} {text!r}: give three numbers as X,Y,Z") from None
    if not np.isfinite([x, y, z]).all():
        raise InputError(f"{what} {text!r}: give three finite numbers")
    return (x, y, z)


def default_camera(
    scene: Scene | Mesh,
    aspect: float = 1.0,
    up: tuple[float, float, float] | None = None,
    fov: float = DEFAULT_FOV,
) -> Camera:
    """Make the three-quarter view of the whole scene, that of ``clgrid.render`` without a camera.

    Parameters
    ----------
    scene : Scene or Mesh
        Without a triangle, the cube from -1 to 1 is viewed.
    aspect : float
        Width of the picture by its height.
    up : (float, float, float), optional
        Upward in the picture; by default z for STL and for what is flat in z, else y.
    fov : float
        Vertical field of view in degrees.
    """
    mesh = scene.mesh if isinstance(scene, Scene) else scene
    bounds = mesh.bounds if mesh.triangle_count else np.array([[-1.0] * 3, [1.0] * 3])
    return Camera.framing(bounds, up or up_axis(scene), fov, aspect)


def named_camera(scene: Scene, selector: str) -> Camera:
    """Find a camera by name or index in the scene's glTF file, or read one from a JSON file.

    Raises
    ------
    InputError
        If there is no such camera; the message lists those there are.
    """
    if selector.lower().endswith(".json"):
        return camera_file(Path(selector))
    # Of a file, one that is malformed does not matter to the others.
    found = gltf_cameras(scene) if scene.frame is None else scene.cameras
    return camera_among(found, selector, scene.name)


def gltf_cameras(scene: Scene) -> tuple[GltfCamera, ...]:
    """Return the cameras of the scene's file, in its order; none but for glTF."""
    from clgrid.meshfile.gltf_cameras import read_cameras

    return () if scene.path is None else read_cameras(scene.path)
