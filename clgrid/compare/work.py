"""What a device does for a comparison: rays, grids, casts and a picture of one scene."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from clgrid import selftest
from clgrid.bench import Measurement, Work, rate
from clgrid.camera import Camera
from clgrid.compare.files import Answers, Folder, Recipe
from clgrid.compare.messages import Order
from clgrid.compare_record import CompareRays, CompareRow
from clgrid.device import Device
from clgrid.errors import DeviceError
from clgrid.grid import Grid, require_tested
from clgrid.hits import Hits
from clgrid.image import Image
from clgrid.renderer import render
from clgrid.scene import Scene
from clgrid.structured import Aim, structured
from clgrid.wavefront import Batch, Workload, batches

# Whose hits shadow and incoherent rays start from, if it is among the rungs.
_RAYS_RUNG = "robust"
_AOVS = ("id",)
# Of a bounce off the surface.
_SPREAD = "bounce 1"


@dataclass(frozen=True)
class Stage:
    """A scene and what looks at it.

    Attributes
    ----------
    number : int
        Of the scene.
    scene : Scene
    view : Camera
    load_s : float
    """

    number: int
    scene: Scene
    view: Camera
    load_s: float


def prepare(order: Order, stage: Stage, device: Device, folder: Folder) -> tuple[Recipe, dict[str, Batch]]:
    """The recipe and the rays of a scene: those that an earlier device left, or our own for all that follow.

    Raises
    ------
    ClgridError
        If the grid cannot be built.
    """
    found = folder.rays(stage.number)
    if found is not None:
        return found
    accuracy = _RAYS_RUNG if _RAYS_RUNG in order.accuracies else order.accuracies[0]
    waive_selftest(device, accuracy)
    asked = Work(
        order.width, order.height, 1, order.layout, order.density, order.resolution, accuracy,
        order.max_memory, order.skipping,
    )  # fmt: skip
    grid = asked.build(stage.scene, device, stage.view)
    folder.save_rays(stage.number, grid, rays_of(order, stage, grid))
    made = folder.rays(stage.number)
    assert made is not None
    return made


def rays_of(order: Order, stage: Stage, grid: Grid) -> dict[str, Batch]:
    """Rays by kind, each like those of a renderer or worse; kinds without a ray are left out."""
    seed, mesh = order.seed, stage.scene.mesh
    workload = Workload("diffuse", bounces=1, seed=seed, check=0)
    found: dict[str, Batch] = {}
    for batch in batches(
        mesh, stage.view, order.width, order.height, workload, lambda batch: _cast(grid, batch)
    ):
        found.setdefault(batch.kind, batch)
        if batch.kind == _SPREAD:
            break
    named = {"incoherent" if kind == _SPREAD else kind: batch for kind, batch in found.items()}
    if mesh.triangle_count:
        hard = structured(Aim.at(mesh, grid.stats.resolution), order.rays, np.zeros((0, 3)), (seed,))
        named["structured"] = Batch("structured", hard.origins, hard.directions)
    return named


def measure(
    order: Order,
    stage: Stage,
    accuracy: str,
    device: Device,
    folder: Folder,
    say: Callable[[str], None],
) -> CompareRow:
    """Build, cast and draw a scene on a rung; the arrays go into the folder.

    Raises
    ------
    ClgridError
        If the grid cannot be built or the device does not compile the kernels.
    """
    of_scene = f"{accuracy} of {stage.scene.name}"
    say(f"compile {of_scene}")
    recipe, rays = prepare(order, stage, device, folder)
    failed = waive_selftest(device, accuracy)
    work = Work(
        order.width, order.height, order.repetitions, recipe.layout, recipe.density, recipe.resolution,
        accuracy, order.max_memory, recipe.skipping,
    )  # fmt: skip
    seen = Measurement(stage.scene, stage.load_s, device)
    seen.first_compile_s.append(work.warm_up(device, _AOVS, stage.scene))
    say(f"build {of_scene}")
    grid = work.build(stage.scene, device, stage.view)

    def draw(grid: Grid) -> Image:
        return render(stage.scene, stage.view, order.width, order.height, _AOVS, grid=grid)

    image = draw(grid)
    for _ in range(order.repetitions):
        # One grid at a time: the old one's memory is free before the next is built.
        del grid
        grid = seen.build(work, stage.view)
        image = seen.render(lambda grid=grid: draw(grid))  # type: ignore[misc]
    kinds, hits = [], {}
    for kind, batch in rays.items():
        say(f"cast {kind} rays, {of_scene}")
        start = time.perf_counter()
        _cast(grid, Batch(kind, batch.origins[:1], batch.directions[:1]))
        seen.first_compile_s[0] += time.perf_counter() - start
        hits[kind], seconds = _timed_cast(grid, batch, order.repetitions)
        kinds.append(
            CompareRays(
                kind=kind,
                rays=len(batch.origins),
                hits=int(np.count_nonzero(hits[kind].mask)),
                cast_s=seconds,
                mrays_per_s=rate(len(batch.origins), seconds),
                digest=selftest.digest(hits[kind]),
            )
        )
    folder.save_answers(stage.number, accuracy, order.number, Answers.of(hits, image))
    return _row(seen, grid, image, kinds, failed)


def waive_selftest(device: Device, accuracy: str) -> str:
    """Let a device that fails the self-test of a rung go on, to see where it differs; what it fails.

    Raises
    ------
    DeviceError
        If it cannot run it.
    """
    try:
        require_tested(device, accuracy)
    except DeviceError as error:
        if not selftest.waive(device, accuracy):
            raise
        return str(error)
    return ""


def _cast(grid: Grid, batch: Batch) -> Hits:
    return grid.cast(batch.origins, batch.directions, t_max=batch.t_max)


def _timed_cast(grid: Grid, batch: Batch, repetitions: int) -> tuple[Hits, list[float]]:
    hits, seconds = _cast(grid, batch), []
    for _ in range(repetitions):
        start = time.perf_counter()
        hits = _cast(grid, batch)
        seconds.append(time.perf_counter() - start)
    return hits, seconds


def _row(seen: Measurement, grid: Grid, image: Image, kinds: list[CompareRays], failed: str) -> CompareRow:
    stats, mesh = grid.stats, seen.scene.mesh
    return CompareRow(
        scene=seen.scene.name,
        triangles=mesh.triangle_count,
        accuracy=grid.accuracy,
        layout=grid.layout,
        skipping=grid.skipping,
        density=stats.density,
        resolution=stats.resolution,
        cells=stats.cells,
        references=stats.references,
        parts=stats.parts,
        nbytes=stats.nbytes,
        grid_bytes=grid.nbytes,
        bytes_per_triangle=grid.nbytes / mesh.triangle_count if mesh.triangle_count else 0.0,
        peak_bytes=grid.peak_nbytes,
        load_s=[seen.load_s],
        first_compile_s=seen.first_compile_s,
        build_s=seen.build_s,
        build_stages_s=seen.stages_s,
        grid_digests=grid_digests(grid),
        kinds=kinds,
        render_s=seen.render_s,
        image_hits=image.hits,
        image_digest=image_digest(image),
        self_test=failed,
        warnings=mesh.warnings,
    )


def grid_digests(grid: Grid) -> dict[str, str]:
    """Of every byte of each array; those of further parts are called ``NAME/PART``."""
    digests: dict[str, str] = {}
    for number in range(0 if grid.empty else len(grid.standing)):
        for name, array in grid.arrays(number).items():
            called = f"{name}/{number}" if number else name
            digests[called] = hashlib.sha256(array.tobytes()).hexdigest()[:16]
    return digests


def image_digest(image: Image) -> str:
    """Of every bit of colours and ids."""
    hashed = hashlib.sha256(image.rgba.tobytes())
    if image.primitive_id is not None:
        hashed.update(image.primitive_id.tobytes())
    return hashed.hexdigest()[:16]
