"""The way of a picture in stages: tile by tile, sample by sample, in memory that does not grow with it.

A sample of a tile is a picture of rays, cast as such; occlusion rays of a tile are pictures below each other,
each of one cell of the hemisphere, so that neighbours run near each other.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from clgrid import on_device
from clgrid.cast import Defines
from clgrid.grid import Grid
from clgrid.hits import checked_fields
from clgrid.image import NO_ID, Image
from clgrid.look import Shading
from clgrid.memory import Allocator
from clgrid.on_device import DeviceRays
from clgrid.program import kernel
from clgrid.shading.arrays import TileArrays
from clgrid.shading.lamps import Lamp, lamps_of
from clgrid.shading.order import Order, Window, cells_of
from clgrid.shading.passing import Passing
from clgrid.shading.surfaces import Surfaces, grey_look

_PIXELS_PER_ITEM = 64  # as in cl/picture_rays.h
# Rays of the eye, and of occlusion, that are held at once; the most columns of a tile.
_TILE_RAYS, _SKY_RAYS, _TILE_COLUMNS = 1 << 18, 1 << 20, 1 << 11
_TILE_ROWS = 8
# How light comes from the eye, as in cl/find_surfaces.cl.
_NO_HEADLIGHT, _HEADLIGHT, _PLAIN = 0, 1, 2
# So far above surfaces rays start, in local units (docs/numerics.md): more than starts and hits are off.
_LIFT = {"fast": 2.0**-17, "robust": 64 * 2.0**-24, "precise": 2.0**-40, "exact": 2.0**-40}


@dataclass
class Clock:
    """Seconds by stage."""

    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str, queue: Any) -> Iterator[None]:
        """Count what is done within."""
        start = time.perf_counter()
        yield
        queue.finish()
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start


def draw_staged(
    grid: Grid, order: Order, image: Image, progress: Callable[[float], None] | None
) -> dict[str, float]:
    """Fill the image, whose arrays say what is asked for; seconds by stage.

    Raises
    ------
    InputError
        If shading or look do not fit.
    """
    look = order.look if order.look is not None else grey_look(grid.mesh)
    shading = order.shading or Shading()
    lamps = lamps_of(look, shading) if order.shading else []
    drawing = _Drawing(grid, order, Surfaces(look, grid.mesh, Allocator(grid.device)), shading, lamps)
    tiles = list(_tiles(image.width, image.height))
    for done, tile in enumerate(tiles, 1):
        drawing.draw(tile, image)
        if progress is not None:
            progress(done / len(tiles))
    return drawing.clock.seconds


def _tiles(width: int, height: int) -> Iterator[Window]:
    columns = min(width, _TILE_COLUMNS)
    rows = max(_TILE_RAYS // columns // _TILE_ROWS, 1) * _TILE_ROWS
    for top in range(0, height, rows):
        for left in range(0, width, columns):
            yield left, top, min(left + columns, width), min(top + rows, height)


class _Drawing:
    """A picture on its way: what does not change from tile to tile."""

    def __init__(
        self, grid: Grid, order: Order, surfaces: Surfaces, shading: Shading, lamps: list[Lamp]
    ) -> None:
        self.grid = grid
        self.order = order
        self.surfaces = surfaces
        self.shading = shading
        self.lamps = lamps
        self.clock = Clock()
        self.queue = grid.device.queue
        self.allocator = surfaces.allocator
        self.camera = self.allocator.upload(order.camera.params(*order.size, order.window))
        # Kept while kernels read them: a grid may be rebuilt meanwhile.
        self.parts = grid.standing
        self.look_arguments = [surfaces.arguments(part) for part in self.parts]
        self.normals = [self._normals_of(part.mesh.used) for part in self.parts]
        self.passing = Passing(grid.target, self.parts, surfaces, self.look_arguments)
        scale = 2.0**-grid.frame.exponent
        # Far from the origin of the scene, what its doubles cannot hold comes on top.
        self.lift = _LIFT[grid.accuracy] / scale + 2.0**-48 * float(np.abs(grid.mesh.bounds).max())
        lit = bool(lamps) or shading.sky is not None
        self.headlight = _PLAIN if order.shading is None else _NO_HEADLIGHT if lit else _HEADLIGHT

    def _normals_of(self, used: Any) -> list[Any]:
        normals = self.grid.mesh.vertex_normals
        return [] if normals is None else [self.allocator.share(normals if used is None else normals[used])]

    def draw(self, tile: Window, image: Image) -> None:
        """Draw all samples of a tile, and what is asked for besides."""
        left, top, right, bottom = tile
        arrays = TileArrays(self.queue, (bottom - top, right - left))
        own = (np.uint32(left), np.uint32(top), np.uint32(right - left), np.uint32(arrays.count))
        window = (slice(top, bottom), slice(left, right))
        samples = self.shading.samples
        asked = _hit_fields(image)
        centred = _takes_hits(image)
        if samples > 1 and centred:
            self._store(self._hit(arrays, own, 0, 1, asked), arrays, image, window)
        for sample in range(samples):
            hits = self._hit(arrays, own, sample, samples, asked if samples == 1 else ())
            if samples == 1 and centred:
                self._store(hits, arrays, image, window)
            for lamp in self.lamps:
                self._light(arrays, lamp, hits)
            if self.shading.sky is not None and self.shading.occlusion_rays:
                self._look_for_sky(arrays, own, sample, hits)
            self._add(arrays, sample, hits)
        pixels = arrays.rgba.get().reshape(*arrays.shape, 4)
        image.rgba[window] = pixels
        if image.coverage is not None:
            image.coverage[window] = pixels[..., 3]

    def _run(self, file: str, count: int, *arguments: Any, **options: Any) -> None:
        run = kernel(self.grid.device, f"{file}.cl", file, **options)
        run(self.queue, (-(-count // _PIXELS_PER_ITEM),), (1,), *arguments)

    def _hit(
        self, arrays: TileArrays, tile: Sequence[Any], sample: int, samples: int, fields: Sequence[str]
    ) -> Any:
        """The hits of a sample's rays, and the surfaces there."""
        clock, queue, grid = self.clock, self.queue, self.grid
        columns, rows = cells_of(samples)
        with clock.stage("rays", queue):
            self._run(
                "sample_rays", arrays.count, self.camera, *tile, np.uint64(self.shading.seed),
                np.uint32(sample), np.uint32(columns), np.uint32(rows), arrays.origins.base_data,
                arrays.directions.base_data,
            )  # fmt: skip
        rays = DeviceRays(arrays.origins, arrays.directions, np.array([[0.0, np.inf]]))
        wanted = checked_fields(("primitive_uvs", *fields), grid.accuracy)
        with clock.stage("cast", queue):
            hits = on_device.cast_closest(grid.target, self.parts, queue, rays, wanted)
        if self.order.shading is not None and self.surfaces.passable:
            with clock.stage("pass", queue):
                self._see_through(arrays, hits)
        with clock.stage("surfaces", queue):
            for part, look, normals in zip(self.parts, self.look_arguments, self.normals, strict=True):
                options: Defines = {"REAL": "float" if grid.rung.real is np.float32 else "double"}
                options |= {"SMOOTH_NORMALS": 1} if normals else {}
                self._run(
                    "find_surfaces", arrays.count, grid.target.frame_params, *part.mesh.arguments, *look,
                    *normals, np.uint32(arrays.count), np.uint32(self.headlight), arrays.directions.base_data,
                    hits.primitive_ids.base_data, hits.primitive_uvs.base_data, arrays.positions.base_data,
                    arrays.faced.base_data, arrays.shaded.base_data, arrays.albedos.base_data,
                    arrays.radiances.base_data, arrays.coordinates.base_data,
                    **options, **self.surfaces.defines, **part.mesh.defines,
                )  # fmt: skip
        return hits

    def _see_through(self, arrays: TileArrays, hits: Any) -> None:
        device_arrays = (hits.t_hit, hits.primitive_ids, hits.primitive_uvs)
        on_host = [array.get().reshape(arrays.count, -1) for array in device_arrays]
        t, ids = on_host[0][:, 0], on_host[1][:, 0]
        rays = [array.get().reshape(-1, 3) for array in (arrays.origins, arrays.directions)]
        if self.passing.see_through(t, ids, on_host[2], *rays):
            for array, changed in zip(device_arrays, on_host, strict=True):
                array.set(changed.reshape(array.shape))

    def _light(self, arrays: TileArrays, lamp: Lamp, hits: Any) -> None:
        with self.clock.stage("light_rays", self.queue):
            self._run(
                "light_rays", arrays.count, self.allocator.upload(lamp.params), np.uint32(arrays.count),
                np.float64(self.lift), hits.primitive_ids.base_data, arrays.positions.base_data,
                arrays.faced.base_data, arrays.shaded.base_data, arrays.arriving.base_data,
                arrays.starts.base_data, arrays.ways.base_data,
            )  # fmt: skip
        occluded = self._occluded(arrays.starts, arrays.ways, lamp.t_max, "light_cast")
        with self.clock.stage("light_rays", self.queue):
            self._run(
                "add_light", arrays.count, np.uint32(arrays.count), *(np.float64(c) for c in lamp.colour),
                arrays.arriving.base_data, occluded.base_data, arrays.albedos.base_data,
                arrays.radiances.base_data,
            )  # fmt: skip

    def _look_for_sky(self, arrays: TileArrays, tile: Sequence[Any], sample: int, hits: Any) -> None:
        total, distance = self.shading.occlusion_rays, self.shading.occlusion_distance
        bounded = math.isfinite(distance)
        columns, rows = cells_of(total)
        together = max(1, _SKY_RAYS // arrays.count)
        for first in range(0, total, together):
            rays = min(together, total - first)
            starts, ways = arrays.sky_rays(rays)
            with self.clock.stage("sky_rays", self.queue):
                self._run(
                    "sky_rays", arrays.count, self.camera, *tile, np.uint64(self.shading.seed),
                    np.uint32(sample), np.uint32(first), np.uint32(rays), np.uint32(columns), np.uint32(rows),
                    np.float64(distance if bounded else 0.0), np.float64(self.lift),
                    hits.primitive_ids.base_data, arrays.positions.base_data, arrays.faced.base_data,
                    starts.base_data, ways.base_data,
                )  # fmt: skip
            occluded = self._occluded(starts, ways, 1.0 if bounded else math.inf, "sky_cast")
            with self.clock.stage("sky_rays", self.queue):
                self._run(
                    "count_open", arrays.count, np.uint32(arrays.count), np.uint32(rays),
                    np.uint32(first == 0), occluded.base_data, arrays.open.base_data,
                )  # fmt: skip

    def _occluded(self, origins: Any, directions: Any, t_max: float, stage: str) -> Any:
        grid = self.grid
        rays = DeviceRays(origins, directions, np.array([[0.0, t_max]]))
        with self.clock.stage(stage, self.queue):
            occluded = on_device.cast_any(grid.target, self.parts, self.queue, rays)
        if self.surfaces.masked:
            with self.clock.stage("pass", self.queue):
                found = occluded.get()
                ends = [array.get().reshape(-1, 3) for array in (origins, directions)]
                self.passing.let_through(found.reshape(-1), ends[0], ends[1], t_max)
                occluded.set(found)
        return occluded

    def _add(self, arrays: TileArrays, sample: int, hits: Any) -> None:
        sky = self.shading.sky if self.shading.sky is not None and self.order.shading else (0.0, 0.0, 0.0)
        rays = self.shading.occlusion_rays
        with self.clock.stage("sum", self.queue):
            self._run(
                "add_sample", arrays.count, np.uint32(arrays.count), np.uint32(sample),
                np.uint32(self.shading.samples), np.uint32(rays), *(np.float64(c) for c in sky),
                *(np.float64(c) for c in self.order.background), hits.primitive_ids.base_data,
                arrays.albedos.base_data, arrays.radiances.base_data, arrays.open.base_data,
                arrays.sums.base_data, arrays.rgba.base_data,
            )  # fmt: skip

    def _store(self, hits: Any, arrays: TileArrays, image: Image, window: tuple[slice, slice]) -> None:
        """Bring home what the image asks for of the rays through the pixels' middles."""
        with self.clock.stage("store", self.queue):
            ids = hits.primitive_ids.get()
            lit = ids != NO_ID
            for array, source in (
                (image.normal, arrays.shaded),
                (image.position, arrays.positions),
                (image.albedo, arrays.albedos),
                (image.uv, arrays.coordinates),
            ):
                if array is not None:
                    array[window] = np.where(lit[..., None], source.get(), 0)
            if image.depth is not None:
                image.depth[window] = hits.t_hit.get()
            if image.primitive_id is not None:
                image.primitive_id[window] = ids
            if image.steps is not None:
                image.steps[window] = hits.computed["steps"].get()
            if image.t_err is not None:
                # Not rounded down, as cl/render.cl.
                image.t_err[window] = np.where(lit, hits.computed["t_err"].get() * (1.0 + 2.0**-22), 0)


def _hit_fields(image: Image) -> tuple[str, ...]:
    """Fields of ``cast`` that AOVs take."""
    return tuple(name for name in ("t_err", "steps") if getattr(image, name) is not None)


def _takes_hits(image: Image) -> bool:
    names = ("depth", "normal", "primitive_id", "steps", "t_err", "position", "uv", "albedo")
    return any(getattr(image, name) is not None for name in names)
