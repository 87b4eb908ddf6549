"""All hits of rays, as one array with the splits between rays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from clgrid.cast import Arrays, GridPart, blank, field_defines, grid_launch, launch_on_host
from clgrid.errors import InputError
from clgrid.hits import AllHits
from clgrid.memory import largest_buffer
from clgrid.rays import Rays
from clgrid.target import DeviceMesh
from clgrid.tiles import RAYS_PER_ITEM

# Room that each chunk of rays gets at first, in hits a ray; a chunk that needs more is cast again.
_ROOM = 8
_RAYS_PER_LAUNCH = 1 << 18
_BYTES_OF_A_HIT = 16  # the largest array: two weights in float64


@dataclass
class _Chunks:
    """Hits of chunks of rays, chunk by chunk in regions of their own."""

    counts: npt.NDArray[np.uint32]
    starts: npt.NDArray[np.uint64]
    invalid: int
    arrays: Arrays

    @property
    def by_chunk(self) -> npt.NDArray[np.int64]:
        """Hits of each chunk, also those without room."""
        return np.add.reduceat(self.counts, np.arange(0, len(self.counts), RAYS_PER_ITEM), dtype=np.int64)

    @property
    def room(self) -> npt.NDArray[np.int64]:
        return np.diff(self.starts).astype(np.int64)


def cast_all(target: DeviceMesh, parts: Sequence[GridPart], rays: Rays, fields: Sequence[str]) -> AllHits:
    """All hits through the grids of all parts.

    Raises
    ------
    InputError
        If the rays of one chunk have more hits than a buffer of the device can hold.
    """
    count = len(rays.origins.reshape(-1, 3))
    stored = list(fields)
    if target.rung.name == "exact" and "t_err" not in stored:
        stored.append("t_err")  # by which hits are sorted
    found = [_of_part(target, part, rays, stored) for part in parts]
    counts = np.sum([each[0] for each in found], axis=0, dtype=np.int64) if count else np.zeros(0, np.int64)
    splits = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    results = found[0][1] if len(found) == 1 else _merged(target, rays, found)
    if target.rung.name == "exact":
        _let_ascend(results, splits)
    ids = results["primitive_ids"].astype(np.int64)
    computed = {name: results[name] for name in fields}
    return AllHits(splits, results["t_hit"], ids, found[0][2], computed)


def _of_part(
    target: DeviceMesh, part: GridPart, rays: Rays, fields: Sequence[str]
) -> tuple[npt.NDArray[np.int64], Arrays, int]:
    """Hits of each ray, the hits in order, and the number of invalid rays."""
    o, d = rays.origins.reshape(-1, 3), rays.directions.reshape(-1, 3)
    counts, pieces, invalid = [], [blank(0, fields, target.rung.real)], 0
    for first in range(0, len(o), _RAYS_PER_LAUNCH):
        batch = slice(first, first + _RAYS_PER_LAUNCH)
        bounds = rays.bounds if len(rays.bounds) == 1 else rays.bounds[batch]
        of_batch = Rays(o[batch], d[batch], bounds)
        chunks = -(-len(of_batch.origins) // RAYS_PER_ITEM)
        starts = np.arange(chunks + 1, dtype=np.uint64) * np.uint64(_ROOM * RAYS_PER_ITEM)
        done = _cast(target, part, of_batch, fields, starts)
        counts.append(done.counts)
        invalid += done.invalid
        pieces += _in_order(target, part, of_batch, fields, done)
    joined = {name: np.concatenate([piece[name] for piece in pieces]) for name in pieces[0]}
    joined["primitive_ids"] = joined["primitive_ids"].astype(np.int64) + part.mesh.first
    return np.concatenate([np.zeros(0, np.int64), *counts]).astype(np.int64), joined, invalid


def _in_order(
    target: DeviceMesh, part: GridPart, rays: Rays, fields: Sequence[str], done: _Chunks
) -> list[Arrays]:
    """The hits of all chunks in the order of rays; chunks that had no room for all are cast again."""
    needed, begins = done.by_chunk, done.starts[:-1].astype(np.int64)
    again = np.flatnonzero(needed > done.room)
    if not len(again):
        rows = _rows(begins, needed)
        return [{name: array[rows] for name, array in done.arrays.items()}]
    starts = np.concatenate([[0], np.cumsum(needed[again])]).astype(np.uint64)
    second = _cast(target, part, _chunks_of(rays, again), fields, starts)
    # The regions of the second cast follow those of the first; rows are then picked in the order of chunks.
    begins[again] = int(done.starts[-1]) + starts[:-1].astype(np.int64)
    rows = _rows(begins, needed)
    return [{name: np.concatenate([array, second.arrays[name]])[rows] for name, array in done.arrays.items()}]


def _rows(begins: npt.NDArray[np.int64], lengths: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """begins[0], begins[0] + 1, ... lengths[0] of them, then from begins[1] on, and so forth."""
    before = np.cumsum(lengths) - lengths
    return np.repeat(begins - before, lengths) + np.arange(int(lengths.sum()))


def _chunks_of(rays: Rays, chunks: npt.NDArray[np.int64]) -> Rays:
    """The rays of some chunks; the last may be short."""
    rows = (chunks[:, None] * RAYS_PER_ITEM + np.arange(RAYS_PER_ITEM)).reshape(-1)
    rows = rows[rows < len(rays.origins)]
    bounds = rays.bounds if len(rays.bounds) == 1 else rays.bounds[rows]
    return Rays(rays.origins[rows], rays.directions[rows], bounds)


def _cast(
    target: DeviceMesh, part: GridPart, rays: Rays, fields: Sequence[str], starts: npt.NDArray[np.uint64]
) -> _Chunks:
    room = int(starts[-1])
    if room * _BYTES_OF_A_HIT > largest_buffer(target.device):
        raise InputError(
            f"cast_all: {room:,} hits at once exceed the device's largest buffer; cast fewer rays"
        )
    shapes = blank(0, fields, target.rung.real)
    arrays = {name: np.zeros((max(room, 1), *a.shape[1:]), a.dtype) for name, a in shapes.items()}
    rejected = np.zeros(len(starts) - 1, np.uint32)
    counts = np.zeros(len(rays.origins), np.uint32)
    launch = grid_launch("cast_all", target, [part], field_defines(fields))
    inputs = [rays.origins, rays.directions, rays.bounds]
    launch_on_host(target, launch, inputs, [rejected, counts, starts, *arrays.values()])
    return _Chunks(counts, starts, int(rejected.sum()), arrays)


def _merged(
    target: DeviceMesh, rays: Rays, found: Sequence[tuple[npt.NDArray[np.int64], Arrays, int]]
) -> Arrays:
    """The hits of several parts, sorted anew within each ray."""
    ray_ids = np.concatenate([np.repeat(np.arange(len(counts)), counts) for counts, _, _ in found])
    joined = {name: np.concatenate([arrays[name] for _, arrays, _ in found]) for name in found[0][1]}
    order = np.lexsort([joined["primitive_ids"], joined["t_hit"], ray_ids])
    if target.rung.name == "exact":
        order = _exactly(target, rays, ray_ids, joined, order)
    return {name: array[order] for name, array in joined.items()}


def _exactly(
    target: DeviceMesh,
    rays: Rays,
    ray_ids: npt.NDArray[np.int64],
    hits: Arrays,
    order: npt.NDArray[np.int64],
) -> npt.NDArray[np.int64]:
    """The order with runs whose t are too close to tell sorted by the exact t."""
    low = (hits["t_hit"] - hits["t_err"])[order]
    high = (hits["t_hit"] + hits["t_err"])[order]
    rays_in_order = ray_ids[order]
    fixed = order.copy()
    first = 0
    for last in range(1, len(order) + 1):
        end = last == len(order) or rays_in_order[last] != rays_in_order[first]
        if end or low[last] > high[first:last].max():
            run = order[first:last].tolist()
            if len(run) > 1:
                fixed[first:last] = sorted(run, key=lambda hit: _exact_key(target, rays, ray_ids, hits, hit))
            first = last
    return fixed


def _let_ascend(hits: Arrays, splits: npt.NDArray[np.int64]) -> None:
    """Raise a t that contradicts the order of the exact ones to the one before; both errors cover that."""
    t, errors = hits["t_hit"], hits["t_err"]
    falls = np.flatnonzero(t[1:] < t[:-1]) + 1
    begins = set(splits.tolist())
    for fall in falls.tolist():
        at = fall
        while at < len(t) and at not in begins and t[at] < t[at - 1]:
            t[at], errors[at] = t[at - 1], max(errors[at], errors[at - 1])
            at += 1


def _exact_key(
    target: DeviceMesh, rays: Rays, ray_ids: npt.NDArray[np.int64], hits: Arrays, hit: int
) -> tuple[Any, int]:
    from clgrid.rational import plane_t

    triangle, ray = int(hits["primitive_ids"][hit]), int(ray_ids[hit])
    o, d = rays.origins.reshape(-1, 3)[ray], rays.directions.reshape(-1, 3)[ray]
    return plane_t(target.mesh.vertices[target.mesh.faces[triangle]], o, d), triangle
