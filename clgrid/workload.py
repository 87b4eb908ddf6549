"""Measure the rays of a workload: rates, steps, bytes, and the share that differs from brute force."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from clgrid import record
from clgrid.bench import Work, each, rate
from clgrid.brute import brute_force
from clgrid.camera import Camera
from clgrid.device import Device
from clgrid.grid import Grid
from clgrid.hits import Hits
from clgrid.record import RayKind, WorkloadRecord, WorkloadRow
from clgrid.rungs import LOSSLESS
from clgrid.scene import Scene, load_scene
from clgrid.wavefront import Batch, Vectors, Workload, batches


def bit_rows(hits: Hits, rows: npt.NDArray[np.int64] | slice = slice(None)) -> npt.NDArray[np.uint64]:
    """(N, 4) uint64: the bits of t, id, u and v of the chosen rays, so that equal rows are equal answers."""
    uvs = np.ascontiguousarray(hits.primitive_uvs[rows])
    bits = uvs.view(np.uint32 if uvs.dtype == np.float32 else np.uint64)
    ids = hits.primitive_ids[rows].view(np.uint64)
    return np.stack([hits.t_hit[rows].view(np.uint64), ids, bits[:, 0], bits[:, 1]], axis=-1)


def even_parts(sizes: Sequence[int], total: int) -> list[int]:
    """How many to take of each so that they sum to ``total``: alike, but never more than there are."""
    parts = [0] * len(sizes)
    smallest_first = sorted(range(len(sizes)), key=sizes.__getitem__)
    for done, k in enumerate(smallest_first):
        parts[k] = min(sizes[k], total // (len(sizes) - done))
        total -= parts[k]
    return parts


class _Sample(NamedTuple):
    """Rays of a batch, each with its own t_max, and the bits that the grid answered."""

    origins: Vectors
    directions: Vectors
    t_max: Vectors
    found: npt.NDArray[np.uint64]

    def first(self, count: int) -> _Sample:
        origins, directions, t_max, found = self
        return _Sample(origins[:count], directions[:count], t_max[:count], found[:count])


@dataclass
class _Tally:
    """What is counted of one kind of ray."""

    rays: int = 0
    hits: int = 0
    steps: int = 0
    cast_s: list[float] = field(default_factory=list)

    def add(self, rays: int, hits: int, steps: int, cast_s: Sequence[float]) -> None:
        self.rays += rays
        self.hits += hits
        self.steps += steps
        self.cast_s = [a + b for a, b in zip(self.cast_s or [0.0] * len(cast_s), cast_s, strict=True)]

    @property
    def steps_per_ray(self) -> float:
        return self.steps / self.rays if self.rays else 0.0

    def record(self, kind: str) -> RayKind:
        return RayKind(
            kind=kind,
            rays=self.rays,
            hits=self.hits,
            steps_per_ray=self.steps_per_ray,
            cast_s=self.cast_s,
            mrays_per_s=rate(self.rays, self.cast_s),
        )


class Survey:
    """Casts batches through a grid: times them, counts them, keeps a sample to compare with brute force."""

    def __init__(self, grid: Grid, workload: Workload, repetitions: int) -> None:
        self.grid = grid
        self.repetitions = repetitions
        self.kinds: dict[str, _Tally] = {}
        self._random = np.random.default_rng([workload.seed, 1])
        self._sample_size = workload.sample_size(grid.mesh.triangle_count)
        self._sample: list[_Sample] = []

    def look(self, batch: Batch) -> Hits:
        """Cast once, untimed."""
        return self.grid.cast(batch.origins, batch.directions, t_max=batch.t_max)

    def measure(self, batch: Batch) -> None:
        """Cast once untimed and then as often as asked; the last hits are counted and sampled.

        Steps come from one further cast: the kernel that counts them is another one.
        """
        hits = self.look(batch)
        seconds: list[float] = []
        for _ in range(self.repetitions):
            start = time.perf_counter()
            hits = self.grid.cast(batch.origins, batch.directions, t_max=batch.t_max)
            seconds.append(time.perf_counter() - start)
        counted = self.grid.cast(batch.origins, batch.directions, t_max=batch.t_max, fields=("steps",))
        tally = self.kinds.setdefault(batch.kind, _Tally())
        steps = int(counted["steps"].sum(dtype=np.int64))
        tally.add(len(batch.origins), int(np.count_nonzero(hits.mask)), steps, seconds)
        self._keep_sample(batch, hits)

    def _keep_sample(self, batch: Batch, hits: Hits) -> None:
        """Keep a random part of the batch, in random order: how much of it is needed shows at the end."""
        count = min(self._sample_size, len(batch.origins))
        chosen = self._random.choice(len(batch.origins), count, replace=False)
        rays = batch.origins[chosen], batch.directions[chosen]
        self._sample.append(_Sample(*rays, np.full(count, batch.t_max), bit_rows(hits, chosen)))

    def compare(self) -> tuple[int, int]:
        """How many rays are in the sample, and how many of them differ from brute force in any bit."""
        sizes = even_parts([len(part.found) for part in self._sample], self._sample_size)
        if not any(sizes):
            return 0, 0
        parts = [part.first(size) for part, size in zip(self._sample, sizes, strict=True)]
        origins, directions, t_max, found = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
        grid = self.grid
        truth = brute_force(
            grid.mesh, origins, directions, t_max=t_max, device=grid.device, accuracy=grid.accuracy
        )
        return len(found), int(np.count_nonzero((found != bit_rows(truth)).any(axis=-1)))

    def row(self, scene: Scene, view: Camera, work: Work, workload: Workload) -> WorkloadRow:
        """Return everything measured, with the grid's numbers."""
        grid, stats, triangles = self.grid, self.grid.stats, scene.mesh.triangle_count
        total = _Tally()
        for tally in self.kinds.values():
            total.add(tally.rays, tally.hits, tally.steps, tally.cast_s)
        checked, differing = self.compare()
        return WorkloadRow(
            scene=scene.name,
            triangles=triangles,
            workload=workload.name,
            bounces=workload.bounces if workload.name == "diffuse" else 0,
            layout=grid.layout,
            accuracy=grid.accuracy,
            density=stats.density,
            resolution=stats.resolution,
            references=stats.references,
            grid_bytes=grid.nbytes,
            bytes_per_triangle=grid.nbytes / triangles if triangles else 0.0,
            peak_bytes=grid.peak_nbytes,
            width=work.width,
            height=work.height,
            eye=tuple(view.eye.tolist()),
            skipping=work.skipping,
            kinds=[tally.record(kind) for kind, tally in self.kinds.items()],
            rays=total.rays,
            hits=total.hits,
            steps_per_ray=total.steps_per_ray,
            cast_s=total.cast_s or [0.0] * self.repetitions,
            mrays_per_s=rate(total.rays, total.cast_s),
            checked=checked,
            differing=differing,
            differing_share=differing / checked if checked else None,
            device=grid.device.label,
            warnings=scene.mesh.warnings,
        )


def bench_workload(name: str, workload: Workload, work: Work, device: Device) -> WorkloadRow:
    """Build one scene's grid once, and cast a workload's rays through it.

    Raises
    ------
    ClgridError
        If the scene cannot be loaded or built, has no such camera, or there are too many pixels.
    """
    scene = load_scene(name)
    view = work.camera(scene)
    survey = Survey(work.build(scene, device, view), workload, work.repetitions)
    for batch in batches(scene.mesh, view, work.width, work.height, workload, survey.look):
        survey.measure(batch)
    return survey.row(scene, view, work, workload)


def bench_workloads(
    names: Sequence[str],
    workload: Workload,
    work: Work,
    device: Device,
    progress: Callable[[str], None] = lambda name: None,
) -> WorkloadRecord:
    """Cast a workload's rays through scenes one after another; one that fails does not stop the others.

    Parameters
    ----------
    names : sequence of str
        Files or built-in scenes.
    workload : Workload
        Which rays.
    work : Work
        Pixels, repetitions and the grid.
    device : Device
        Where.
    progress : callable
        Called with each name before its turn.

    Raises
    ------
    DeviceError
        If the device cannot be used at all.
    """
    rows, failures = each(names, lambda name: bench_workload(name, workload, work, device), progress)
    return WorkloadRecord(
        schema=record.schema("bench.workload"),
        clgrid=record.version(),
        device=record.describe_device(device),
        compiled=record.describe_builds(device),
        seeds={"workload": workload.seed},
        process_peak_bytes=record.process_peak_bytes(),
        rows=rows,
        failures=failures,
    )


def broken_promises(result: WorkloadRecord) -> list[str]:
    """Say, a line each, where a rung that promises the bits of brute force differs from it."""
    return [
        f"{row.scene}: {row.differing} of {row.checked} rays differ from brute force, which"
        f" {row.accuracy!r} rules out; please report the scene, with --seed {result.seeds['workload']}"
        for row in result.rows
        if row.differing and row.accuracy in LOSSLESS
    ]
