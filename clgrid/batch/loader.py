"""Read what items show: all that needs files and no device, so that it runs beside one.

The scene of the item before is kept, and so is its frame: cameras of one frame share both.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from clgrid.animation import Frames
from clgrid.batch.item import Item
from clgrid.batch.job import Settings
from clgrid.camera import DEFAULT_FOV, Camera
from clgrid.errors import InputError
from clgrid.look import Look, Shading
from clgrid.mesh import Mesh
from clgrid.renderer import needs_look
from clgrid.scene import Scene, default_camera, load_scene, named_camera, parse_up, up_axis

_SHADING = ("samples", "seed", "lights", "sun", "sun_strength", "sky", "occlusion_rays", "occlusion_distance")


@dataclass(frozen=True)
class Loaded:
    """What an item shows, in memory.

    Attributes
    ----------
    base : Scene
        As loaded; the same object for all items of it.
    frames : Frames or None
        What moves it; None where nothing does.
    mesh, first : Mesh
        Of the item's frame; and that which a grid is chosen for: of frame 0, whatever frame comes first.
    view : Camera
        Of the item, in its frame.
    look : Look or None
        Of the frame, where the item shows it.
    load_s : float
        Seconds.
    """

    base: Scene
    frames: Frames | None
    mesh: Mesh
    first: Mesh
    view: Camera
    look: Look | None
    load_s: float

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was left out of the files, one line each."""
        parts = [self.mesh.warnings, () if self.look is None else self.look.warnings]
        parts.append(() if self.frames is None else self.frames.warnings)
        return tuple(dict.fromkeys(line for part in parts for line in part))


class Loader:
    """Reads items one after another."""

    def __init__(self) -> None:
        self._source: tuple[Any, ...] = ()
        self._base: Scene | None = None
        self._number: int | None = None
        self._scene: Scene | None = None
        self._first: Mesh | None = None

    def load(self, item: Item) -> Loaded:
        """Read an item's scene, unless it is that of the item before.

        Raises
        ------
        ClgridError
            If a file cannot be used, or the scene has no such frame or camera.
        """
        start = time.perf_counter()
        source = (item.scene, item.vertices, item.fps, item.animation)
        new = self._base is None or source != self._source
        if new:
            # What is not needed any more goes before more is read.
            self._base = self._scene = self._first = None
            self._base = load_scene(item.scene, item.vertices, fps=item.fps, animation=item.animation)
            self._source = source
        assert self._base is not None
        base = self._base
        frames = base.frames if item.frame is not None else None
        if self._scene is None or item.frame != self._number:
            self._scene, self._number = None, item.frame
            self._scene, new = _frame(base, frames, item), True
        scene = self._scene
        look = None
        if needs_look(item.settings.aovs or (), shading_of(item.settings)):
            # Kept by the scene, so that it is read once.
            new = new or "look" not in scene.__dict__
            look = scene.look
        first = scene.mesh
        if frames is not None and not frames.topology_changes:
            first = self._first = self._first or frames.mesh(0)
        width, height = item.settings.size or (1024, 1024)
        view = view_of(item, scene, frames, width / height)
        load_s = time.perf_counter() - start if new else 0.0
        return Loaded(base, frames, scene.mesh, first, view, look, load_s)


def _frame(base: Scene, frames: Frames | None, item: Item) -> Scene:
    """The scene as it is in the item's frame; one that stands still has frame 0."""
    if frames is not None and item.frame is not None:
        return frames.scene(item.frame)
    if item.frame:
        raise InputError(f"frame {item.frame}: nothing moves {item.scene}; give vertices, or no frames")
    return base


def shading_of(settings: Settings) -> Shading | None:
    """How a picture is lit, None where the job says nothing of it.

    Raises
    ------
    InputError
        If a number cannot be.
    """
    given = {name: getattr(settings, name) for name in _SHADING if getattr(settings, name) is not None}
    return Shading(**given) if given else None


def view_of(item: Item, scene: Scene, frames: Frames | None, aspect: float) -> Camera:
    """The camera of an item; without a camera, of a moving mesh one that stays and sees all frames.

    Raises
    ------
    InputError
        If the scene has no such camera, or it cannot be.
    """
    view = item.view
    if view.camera:
        found = named_camera(scene, view.camera)
        return found if view.fov is None else replace(found, fov=view.fov, fov_axis="y")
    base = scene if frames is None else frames.base
    up = parse_up(view.up, base) if isinstance(view.up, str) else view.up
    fov = DEFAULT_FOV if view.fov is None else view.fov
    if view.eye is not None and view.look_at is not None:
        return Camera.look_at(view.eye, view.look_at, up, fov)
    bounds = None
    if frames is not None:
        bounds = frames.bounds
    elif scene.mesh.triangle_count:
        bounds = scene.mesh.bounds
    if bounds is None:
        bounds, framed = np.zeros((2, 3)), default_camera(scene, aspect, up, fov)
    else:
        framed = Camera.framing(bounds, up or up_axis(base), fov, aspect)
    if view.eye is None and view.look_at is None:
        return framed
    eye = framed.eye if view.eye is None else view.eye
    target = bounds[0] / 2 + bounds[1] / 2 if view.look_at is None else view.look_at
    return Camera.look_at(eye, target, up, fov)
