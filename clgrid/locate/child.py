"""The child process of one side: builds the grid, casts the ray as ever, and traces it.

Everything goes by files, since drivers write to stdout.
"""

from __future__ import annotations

import os
from pathlib import Path

import msgspec
import numpy as np

from clgrid.cast import GridPart
from clgrid.errors import ClgridError
from clgrid.grid import Grid, untested
from clgrid.locate.trace import Words, trace
from clgrid.mesh import Mesh
from clgrid.rays import as_bounded_rays
from clgrid.recipe import Recipe
from clgrid.record import DeviceRecord, describe_builds, describe_device
from clgrid.repro_record import AnswerRecord, ReproGrid, ReproRay

JOB, MESH, RESULT, WORDS = "job.json", "mesh.npz", "result.json", "words.npy"
# Rays that fill a tile, which go together.
_TOGETHER = 64


class Job(msgspec.Struct, frozen=True):
    """What to do, beside the mesh."""

    device: str
    grid: ReproGrid
    ray: ReproRay


class Planes(msgspec.Struct, frozen=True):
    """Of a grid, local units, as the kernels have them."""

    lower: tuple[float, float, float]
    upper: tuple[float, float, float]
    cell_size: tuple[float, float, float]
    resolution: tuple[int, int, int]


class Result(msgspec.Struct, frozen=True):
    """What came of it, beside the words of the trace."""

    label: str
    device: DeviceRecord
    compiled: tuple[str, ...]
    alone: AnswerRecord
    together: AnswerRecord
    planes: list[Planes]


class Failed(msgspec.Struct, frozen=True):
    """In place of a result: why there is none, and the exit code."""

    error: str
    exit_code: int


def main(folder: str) -> None:
    """Run in the child: do the job in the folder, and leave the result there."""
    place = Path(folder)
    job = msgspec.json.decode((place / JOB).read_bytes(), type=Job)
    outcome: Result | Failed
    try:
        outcome, words = _done(job, place)
        np.save(place / WORDS, words)
    except ClgridError as error:
        outcome = Failed(str(error), error.exit_code)
    (place / RESULT).write_bytes(msgspec.json.encode(outcome))
    # Drivers may hang in their own tear-down.
    os._exit(0)


def _done(job: Job, place: Path) -> tuple[Result, Words]:
    from clgrid.device import choose

    with np.load(place / MESH) as arrays:
        mesh = Mesh(arrays["vertices"], arrays["faces"])
    asked = job.grid
    recipe = Recipe(asked.layout, asked.density, asked.resolution, asked.accuracy, None, asked.skipping)
    device = choose(job.device)
    # A device that fails the self-test is what this is for.
    grid = untested(mesh, device, recipe)
    origin, direction = job.ray.arrays
    bounded = as_bounded_rays(origin[None], direction[None], *job.ray.interval)
    words = [trace(grid.target, part, bounded) for part in grid.standing]
    result = Result(
        device.label,
        describe_device(device),
        (),
        _answer(grid, job.ray, 1),
        _answer(grid, job.ray, _TOGETHER),
        [planes_of(recipe, part) for part in grid.standing],
    )
    return msgspec.structs.replace(result, compiled=describe_builds(device)), np.concatenate(words)


def planes_of(recipe: Recipe, part: GridPart) -> Planes:
    """The planes of the grid over a part of the mesh."""
    params = recipe.params(part.mesh)
    return Planes(*(tuple(params[name].tolist()) for name in Planes.__struct_fields__))


def _answer(grid: Grid, ray: ReproRay, count: int) -> AnswerRecord:
    """The hit of the first of so many rays like this."""
    origin, direction = (np.ascontiguousarray(np.broadcast_to(row, (count, 3))) for row in ray.arrays)
    hits = grid.cast(origin, direction, *ray.interval)
    u, v = hits.primitive_uvs[0].tolist()
    return AnswerRecord(int(hits.primitive_ids[0]), hits.t_hit.item(0).hex(), u.hex(), v.hex())
