"""Measure scenes: load, first compile, build, render, bytes; the rows of the paper's Figure 1."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import median
from typing import TypeVar

from clgrid import record
from clgrid.camera import Camera
from clgrid.device import Device
from clgrid.errors import ClgridError, DeviceError, InputError
from clgrid.grid import Grid, build
from clgrid.image import Image
from clgrid.look import Shading
from clgrid.record import BenchRecord, Failure, Row
from clgrid.renderer import needs_look, render, warm_up
from clgrid.scene import Scene, default_camera, load_scene

Made = TypeVar("Made")


@dataclass(frozen=True)
class Work:
    """What is done to each scene.

    Attributes
    ----------
    width, height : int
        Pixels; one ray each.
    repetitions : int
        Times that build and render are timed, in turns, after one unmeasured turn.
    layout, density, resolution, accuracy, max_memory, skipping
        As for ``clgrid.build``, with a ray for each pixel.
    view : callable, optional
        Makes the camera for a scene and the picture's width over its height; by default that of
        ``clgrid.render``.

    Raises
    ------
    InputError
        If the repetitions are not at least 1.
    """

    width: int = 1024
    height: int = 1024
    repetitions: int = 5
    layout: str = "compact"
    density: float | str = "auto"
    resolution: tuple[int, int, int] | None = None
    accuracy: str = "robust"
    max_memory: int | None = None
    skipping: bool = False
    view: Callable[[Scene, float], Camera] | None = None

    def __post_init__(self) -> None:
        if self.repetitions < 1:
            raise InputError(f"bench: {self.repetitions} repetitions; give at least 1")

    def camera(self, scene: Scene) -> Camera:
        """Return the camera that looks at the scene.

        Raises
        ------
        InputError
            If the scene has no such camera.
        """
        return (self.view or default_camera)(scene, self.width / self.height)

    def build(self, scene: Scene, device: Device, view: Camera) -> Grid:
        """Build the scene's grid as this work asks, for pictures of a camera."""
        return build(
            scene.mesh,
            layout=self.layout,
            density=self.density,
            resolution=self.resolution,
            accuracy=self.accuracy,
            device=device,
            max_memory=self.max_memory,
            skipping=self.skipping,
            rays=self.width * self.height,
            view=view,
        )

    def warm_up(
        self,
        device: Device,
        aovs: Sequence[str] = (),
        scene: Scene | None = None,
        shading: Shading | None = None,
        orthographic: bool = False,
    ) -> float:
        """Compile what this work needs for pictures of a scene, or of flat triangles; the seconds it took."""
        return warm_up(
            device,
            aovs,
            smooth=scene is not None and scene.mesh.vertex_normals is not None,
            look=scene.look if scene is not None and needs_look(aovs, shading) else None,
            shading=shading,
            orthographic=orthographic,
            layout=self.layout,
            density=self.density if self.resolution is None else 1.0,
            accuracy=self.accuracy,
            skipping=self.skipping,
        )


class Measurement:
    """Collects the timings of one scene; ``row`` makes the record of them."""

    def __init__(self, scene: Scene, load_s: float, device: Device) -> None:
        self.scene = scene
        self.device = device
        self.load_s = load_s
        self.first_compile_s: list[float] = []
        self.build_s: list[float] = []
        self.stages_s: dict[str, list[float]] = {}
        self.render_s: list[float] = []

    def build(self, work: Work, view: Camera) -> Grid:
        """Build the grid and note the seconds of the whole and of each stage."""
        start = time.perf_counter()
        grid = work.build(self.scene, self.device, view)
        self.build_s.append(time.perf_counter() - start)
        if not grid.empty:
            for stage, seconds in {"upload": grid.upload_s, **grid.stats.build_s}.items():
                self.stages_s.setdefault(stage, []).append(seconds)
        return grid

    def render(self, draw: Callable[[], Image]) -> Image:
        """Call ``draw`` and note the seconds."""
        start = time.perf_counter()
        image = draw()
        self.render_s.append(time.perf_counter() - start)
        return image

    def row(self, grid: Grid, image: Image) -> Row:
        """Return everything measured, with the grid's and the picture's numbers."""
        stats, triangles = grid.stats, self.scene.mesh.triangle_count
        return Row(
            scene=self.scene.name,
            triangles=triangles,
            layout=grid.layout,
            accuracy=grid.accuracy,
            density=stats.density,
            resolution=stats.resolution,
            references=stats.references,
            empty_share=stats.empty_share,
            load_factor=stats.load_factor,
            nbytes=stats.nbytes,
            parts=stats.parts,
            grid_bytes=grid.nbytes,
            bytes_per_triangle=grid.nbytes / triangles if triangles else 0.0,
            peak_bytes=grid.peak_nbytes,
            load_s=[self.load_s],
            first_compile_s=self.first_compile_s,
            build_s=self.build_s,
            build_stages_s=self.stages_s,
            render_s=self.render_s,
            time_to_image_s=[b + r for b, r in zip(self.build_s, self.render_s, strict=True)],
            width=image.width,
            height=image.height,
            rays=image.width * image.height,
            hits=image.hits,
            device=self.device.label,
            warnings=self.scene.mesh.warnings,
        )


def load_timed(name: str) -> tuple[Scene, float]:
    """Load a scene; also the seconds it took."""
    start = time.perf_counter()
    scene = load_scene(name)
    return scene, time.perf_counter() - start


def bench_scene(name: str, work: Work, device: Device) -> Row:
    """Measure one scene.

    Raises
    ------
    ClgridError
        If the scene cannot be loaded, built or rendered, or has no such camera.
    """
    scene, load_s = load_timed(name)
    view = work.camera(scene)
    seen = Measurement(scene, load_s, device)
    seen.first_compile_s.append(work.warm_up(device, scene=scene))

    def draw(grid: Grid) -> Image:
        return render(scene, view, work.width, work.height, grid=grid)

    grid = work.build(scene, device, view)
    image = draw(grid)
    for _ in range(work.repetitions):
        # One grid at a time: the old one's memory is free before the next is built.
        del grid
        grid = seen.build(work, view)
        image = seen.render(lambda grid=grid: draw(grid))  # type: ignore[misc]
    return seen.row(grid, image)


def bench(
    names: Sequence[str],
    work: Work,
    device: Device,
    progress: Callable[[str], None] = lambda name: None,
) -> BenchRecord:
    """Measure scenes one after another; one that fails does not stop the others.

    Parameters
    ----------
    names : sequence of str
        Files or built-in scenes.
    work : Work
        What to do with each.
    device : Device
        Where.
    progress : callable
        Called with each name before its turn.

    Raises
    ------
    DeviceError
        If the device cannot be used at all.
    """
    rows, failures = each(names, lambda name: bench_scene(name, work, device), progress)
    return BenchRecord(
        schema=record.schema("bench"),
        clgrid=record.version(),
        device=record.describe_device(device),
        compiled=record.describe_builds(device),
        process_peak_bytes=record.process_peak_bytes(),
        rows=rows,
        failures=failures,
    )


def each(
    names: Sequence[str], measure: Callable[[str], Made], progress: Callable[[str], None]
) -> tuple[list[Made], list[Failure]]:
    """Measure scenes one after another; one that fails does not stop the others.

    Raises
    ------
    DeviceError
        If the device cannot be used at all.
    """
    rows: list[Made] = []
    failures: list[Failure] = []
    for name in names:
        progress(name)
        try:
            rows.append(measure(name))
        except DeviceError:
            raise
        except ClgridError as error:
            failures.append(Failure(name, str(error)))
        except Exception as error:  # whatever else a scene provokes is this scene's failure too
            failures.append(Failure(name, f"{type(error).__name__}: {error}"))
    return rows, failures


def rate(count: int, seconds: Sequence[float]) -> float:
    """Return millions a second, by the median; 0 where nothing was timed."""
    return count / median(seconds) / 1e6 if seconds and median(seconds) > 0 else 0.0
