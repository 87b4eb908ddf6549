"""Draw items one after another, keeping what the next one can use: scene, grid, compiled kernels.

What is kept changes no picture. Where the choice of a grid would (``fast``, and the AOV ``steps``), a grid is
kept only for the camera that it was chosen for; and a moving mesh's grid is always chosen at frame 0.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from clgrid import record
from clgrid.batch.item import GridRecord, Item
from clgrid.batch.job import Settings
from clgrid.batch.keys import KEY
from clgrid.batch.poses import Poses, bounds_of, poses_of
from clgrid.camera import DEFAULT_FOV, Camera
from clgrid.device import Device, choose
from clgrid.errors import InputError
from clgrid.grid import Grid, build
from clgrid.image import Image
from clgrid.imagefile import Window
from clgrid.look import Shading
from clgrid.renderer import render, warm_up
from clgrid.scene import Scene, default_camera, load_scene, named_camera, parse_up, up_axis

# Of a picture's metadata, what the choice of a grid decides; it is in the records.
_CHOSEN = ("clgrid:grid_bytes", "clgrid:resolution", "clgrid:references")
_SHADING = ("samples", "seed", "lights", "sun", "sun_strength", "sky", "occlusion_rays", "occlusion_distance")
# A picture is stopped within when it has more rays than this; others are finished.
_LONG = 1 << 20

Stage = Callable[[str], None]


@dataclass
class Loaded:
    """A scene in memory, with what moves it."""

    name: str
    vertices: str | None
    scene: Scene
    poses: Poses | None
    load_s: float


@dataclass
class Painted:
    """A picture with what was measured of it."""

    image: Image
    device: Device
    grid: GridRecord
    triangles: int
    compile_s: float = 0.0
    build_s: float = 0.0
    render_s: float = 0.0
    warnings: tuple[str, ...] = ()


def load_item(item: Item) -> Loaded:
    """Read what an item shows; needs no device, so it may run beside one.

    Raises
    ------
    ClgridError
        If a file cannot be used.
    """
    start = time.perf_counter()
    scene = load_scene(item.scene)
    poses = poses_of(scene, item.vertices) if item.frame is not None else None
    if item.frame is not None and poses is None:
        raise InputError(f"frame {item.frame}: nothing moves {item.scene}; give vertices, or no frames")
    return Loaded(item.scene, item.vertices, scene, poses, time.perf_counter() - start)


@dataclass
class Painter:
    """Draws items on devices.

    Attributes
    ----------
    device : str or None
        For items that name none.
    """

    device: str | None = None
    _scene: Scene | None = None
    _grid: Grid | None = None
    _grid_of: tuple[Any, ...] = ()
    _at: int = 0
    _warm: set[tuple[Any, ...]] = field(default_factory=set)

    def paint(
        self,
        item: Item,
        loaded: Loaded,
        stage: Stage = lambda name: None,
        progress: Callable[[float], None] | None = None,
    ) -> Painted:
        """Draw an item.

        Parameters
        ----------
        item : Item
        loaded : Loaded
            Of this item.
        stage : callable
            Told "compile" and "draw", before each.
        progress : callable, optional
            Told the share of rows done of a large picture; what it raises ends the picture.

        Raises
        ------
        ClgridError
            If the picture cannot be drawn.
        """
        settings = item.settings
        device = choose(settings.device if settings.device is not None else self.device)
        width, height = settings.size or (1024, 1024)
        aovs = settings.aovs or ()
        stage("compile")
        compile_s = self._warm_up(device, settings, loaded)
        stage("draw")
        view = view_of(item, loaded, width / height)
        start = time.perf_counter()
        grid = self._grid_for(item, loaded, device, view)
        built = time.perf_counter()
        # A frame's mesh is the moved one, which the scene of the file does not know.
        shown = loaded.scene if item.frame is None else replace(loaded.scene, mesh=grid.mesh)
        long = width * height * max(1, settings.samples or 1) >= _LONG
        image = render(
            shown, view, width, height, aovs, grid=grid, progress=progress if long else None,
            **_picture_options(settings),
        )  # fmt: skip
        drawn = time.perf_counter()
        _describe(image, item)
        described = GridRecord(
            layout=grid.layout,
            resolution=grid.stats.resolution,
            references=grid.stats.references,
            bytes=grid.nbytes,
        )
        warnings = loaded.scene.mesh.warnings
        return Painted(
            image,
            device,
            described,
            grid.mesh.triangle_count,
            compile_s,
            built - start,
            drawn - built,
            warnings,
        )

    def release(self) -> None:
        """Give the device's memory back."""
        if self._grid is not None:
            self._grid.release()
        self._scene, self._grid, self._grid_of = None, None, ()

    def _warm_up(self, device: Device, settings: Settings, loaded: Loaded) -> float:
        """Compile what an item needs, once; the seconds it took."""
        mesh = loaded.scene.mesh
        if not mesh.triangle_count:
            return 0.0
        smooth = mesh.vertex_normals is not None and loaded.poses is None
        options = _grid_options(settings)
        density = options["density"] if options["resolution"] is None else 1.0
        choices = options["layout"], density == "auto", options["accuracy"], options["skipping"]
        kind = (device.label, settings.aovs, smooth, choices)
        if kind in self._warm:
            return 0.0
        taken = warm_up(
            device,
            settings.aovs or (),
            smooth=smooth,
            layout=options["layout"],
            density=density,
            accuracy=options["accuracy"],
            skipping=options["skipping"],
        )
        self._warm.add(kind)
        return taken

    def _grid_for(self, item: Item, loaded: Loaded, device: Device, view: Camera) -> Grid:
        """The grid that stands, if it will do; moved to the item's frame."""
        settings = item.settings
        options = _grid_options(settings)
        width, height = settings.size or (1024, 1024)
        rays = width * height * max(1, settings.samples or 1)
        decides = options["accuracy"] == "fast" or "steps" in (settings.aovs or ())
        of: tuple[Any, ...] = (device.label, tuple(options.items()))
        of += (item.view, rays) if decides else ()
        if self._grid is None or self._scene is not loaded.scene or self._grid_of != of:
            self.release()
            mesh = loaded.scene.mesh
            if loaded.poses is not None:
                mesh = mesh.moved(loaded.poses.vertices(0))
            self._grid = build(mesh, device=device, rays=rays, view=view, **options)
            self._scene, self._grid_of = loaded.scene, of
            self._at = 0
        grid = self._grid
        if loaded.poses is not None and item.frame is not None and item.frame != self._at:
            self._move(grid, item.frame, loaded, loaded.poses)
        return grid

    def _move(self, grid: Grid, frame: int, loaded: Loaded, poses: Poses) -> None:
        if frame >= poses.count:
            raise InputError(f"frame {frame}: {loaded.name} has 0..{poses.count - 1}")
        # A failed update leaves no grid, and the next item must not take it.
        self._grid = None
        grid.update(poses.vertices(frame))
        self._grid, self._at = grid, frame


def _grid_options(settings: Settings) -> dict[str, Any]:
    return {
        "layout": settings.layout or "compact",
        "density": "auto" if settings.density is None else settings.density,
        "resolution": settings.resolution,
        "accuracy": settings.accuracy or "robust",
        "max_memory": settings.max_memory,
        "skipping": settings.skipping or False,
    }


def _picture_options(settings: Settings) -> dict[str, Any]:
    """What ``render`` is told beside the size: only what the job sets."""
    options: dict[str, Any] = {}
    if settings.background is not None:
        options["background"] = settings.background
    shading = {name: getattr(settings, name) for name in _SHADING if getattr(settings, name) is not None}
    if shading:
        options["shading"] = Shading(**shading)
    if settings.crop is not None:
        options["crop"] = settings.crop
    return options


def view_of(item: Item, loaded: Loaded, aspect: float) -> Camera:
    """The camera of an item; of a moving mesh one that stays, and sees all frames.

    Raises
    ------
    InputError
        If the scene has no such camera, or it cannot be.
    """
    view, scene = item.view, loaded.scene
    if view.camera:
        found = named_camera(scene, view.camera)
        return found if view.fov is None else replace(found, fov=view.fov, fov_axis="y")
    up = parse_up(view.up, scene) if isinstance(view.up, str) else view.up
    fov = DEFAULT_FOV if view.fov is None else view.fov
    bounds = None
    if loaded.poses is not None and scene.mesh.triangle_count:
        bounds = bounds_of(loaded.poses, scene.mesh)
        framed = Camera.framing(bounds, up or up_axis(scene), fov, aspect)
    else:
        framed = default_camera(scene, aspect, up, fov)
        bounds = scene.mesh.bounds if scene.mesh.triangle_count else np.zeros((2, 3))
    if view.eye is None and view.look_at is None:
        return framed
    eye = framed.eye if view.eye is None else view.eye
    target = bounds[0] / 2 + bounds[1] / 2 if view.look_at is None else view.look_at
    return Camera.look_at(eye, target, up, fov)


def window_of(settings: Settings) -> Window | None:
    """Where a cropped picture lies in the whole one."""
    if settings.crop is None:
        return None
    width, height = settings.size or (1024, 1024)
    return Window(settings.crop[0], settings.crop[1], width, height)


def _describe(image: Image, item: Item) -> None:
    """Metadata that tell how to make the picture again, and none that another run would not have."""
    for name in _CHOSEN:
        image.metadata.pop(name, None)
    image.metadata[KEY] = item.key
    # The name alone: the same key means the same bytes, wherever the files are.
    image.metadata["clgrid:source"] = Path(item.scene).name
    image.metadata["clgrid:source_sha256"] = item.source_sha256
    if item.frame is not None:
        image.metadata["clgrid:frame"] = item.frame
    options = {
        name: value
        for name, value in msgspec.to_builtins(item.settings).items()
        if name not in ("time_limit", "retries", "max_memory", "device")
    }
    image.metadata["clgrid:options"] = msgspec.json.encode(options, order="sorted").decode()
    if item.settings.seed is not None:
        image.metadata["clgrid:seed"] = item.settings.seed


def compiled(device: Device) -> tuple[str, ...]:
    """Every kernel file built so far, with its options."""
    return record.describe_builds(device)
