"""Draw items one after another, keeping what the next one can use: scene, grid, compiled kernels.

What is kept changes no picture. Where the choice of a grid would (``fast``, and the AOV ``steps``), a grid is
kept only for the camera that it was chosen for; and a moving mesh's grid is always chosen at frame 0.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from clgrid import record
from clgrid.batch.item import GridRecord, Item
from clgrid.batch.job import Settings
from clgrid.batch.keys import KEY
from clgrid.batch.loader import Loaded, shading_of
from clgrid.device import Device, choose
from clgrid.grid import Grid, build
from clgrid.image import Image
from clgrid.look import Shading
from clgrid.mesh import Mesh
from clgrid.renderer import DEFAULT_BACKGROUND, render, warm_up
from clgrid.scene import Scene
from clgrid.shading.stand_in import few, traits

# Of a picture's metadata, what the choice of a grid decides; it is in the records.
_CHOSEN = ("clgrid:grid_bytes", "clgrid:resolution", "clgrid:references")
# A picture is stopped within when it has more rays than this; others are finished.
_LONG = 1 << 20

Stage = Callable[[str], None]


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


@dataclass
class Painter:
    """Draws items on devices.

    Attributes
    ----------
    device : str or None
        For items that name none.
    """

    device: str | None = None
    _base: Scene | None = None
    _grid: Grid | None = None
    _grid_of: tuple[Any, ...] = ()
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
        shading = shading_of(settings)
        stage("compile")
        compile_s = self._warm_up(device, settings, loaded, shading)
        stage("draw")
        start = time.perf_counter()
        grid = self._grid_for(item, loaded, device)
        built = time.perf_counter()
        long = width * height * max(1, settings.samples or 1) >= _LONG
        image = render(
            grid.mesh, loaded.view, width, height, aovs, grid=grid, progress=progress if long else None,
            look=loaded.look, shading=shading, crop=settings.crop,
            background=settings.background or DEFAULT_BACKGROUND,
        )  # fmt: skip
        drawn = time.perf_counter()
        _describe(image, item)
        described = GridRecord(
            layout=grid.layout,
            resolution=grid.stats.resolution,
            references=grid.stats.references,
            bytes=grid.nbytes,
        )
        return Painted(
            image,
            device,
            described,
            grid.mesh.triangle_count,
            compile_s,
            built - start,
            drawn - built,
            loaded.warnings,
        )

    def release(self) -> None:
        """Give the device's memory back."""
        if self._grid is not None:
            self._grid.release()
        self._base, self._grid, self._grid_of = None, None, ()

    def _warm_up(self, device: Device, settings: Settings, loaded: Loaded, shading: Shading | None) -> float:
        """Compile what an item needs, once; the seconds it took."""
        mesh = loaded.mesh
        if not mesh.triangle_count:
            return 0.0
        options = _grid_options(settings)
        density = options["density"] if options["resolution"] is None else 1.0
        wanted: dict[str, Any] = {
            "aovs": settings.aovs or (),
            "smooth": mesh.vertex_normals is not None,
            "layout": options["layout"],
            "density": density,
            "accuracy": options["accuracy"],
            "skipping": options["skipping"],
            "orthographic": loaded.view.orthographic_height is not None,
        }
        kind = (device.label, *wanted.values(), traits(loaded.look), few(loaded.look, shading))
        if kind in self._warm:
            return 0.0
        taken = warm_up(device, **wanted, look=loaded.look, shading=shading)
        self._warm.add(kind)
        return taken

    def _grid_for(self, item: Item, loaded: Loaded, device: Device) -> Grid:
        """The grid that stands, if it will do; moved to the item's frame."""
        settings = item.settings
        options = _grid_options(settings)
        width, height = settings.size or (1024, 1024)
        rays = width * height * max(1, settings.samples or 1)
        decides = options["accuracy"] == "fast" or "steps" in (settings.aovs or ())
        of: tuple[Any, ...] = (device.label, tuple(options.items()), item.frame is None)
        of += (item.view, rays) if decides else ()
        frames = loaded.frames
        # Other triangles are another mesh, whose grid is chosen anew; a camera that moves sees another part.
        anew = frames is not None and (frames.topology_changes or (decides and frames.cameras_move))
        of += (item.frame,) if anew else ()
        if self._grid is None or self._base is not loaded.base or self._grid_of != of:
            self.release()
            self._grid = build(loaded.first, device=device, rays=rays, view=loaded.view, **options)
            self._base, self._grid_of = loaded.base, of
        grid = self._grid
        if not _same_place(grid.mesh, loaded.mesh):
            # A failed update leaves no grid, and the next item must not take it.
            self._grid = None
            grid.update(loaded.mesh.vertices)
            self._grid = grid
        return grid


def _same_place(one: Mesh, other: Mesh) -> bool:
    """Whether a grid of one mesh is one of the other, which has the same triangles."""
    return one is other or np.array_equal(one.vertices, other.vertices)


def _grid_options(settings: Settings) -> dict[str, Any]:
    return {
        "layout": settings.layout or "compact",
        "density": "auto" if settings.density is None else settings.density,
        "resolution": settings.resolution,
        "accuracy": settings.accuracy or "robust",
        "max_memory": settings.max_memory,
        "skipping": settings.skipping or False,
    }


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
        image.metadata["clgrid:fps"] = item.fps
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
