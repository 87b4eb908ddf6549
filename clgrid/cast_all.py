"""All hits of rays, as one array with the splits between rays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from clgrid.cast import Arrays, GridPart, blank, field_defines, launch_on_host, tile_launch
from clgrid.errors import InputError
from clgrid.hits import AllHits
from clgrid.memory import largest_buffer
from clgrid.rays import Rays
from clgrid.target import DeviceMesh
from clgrid.tiles import Division, division_of

# Room that each ray gets at first, in hits; those that need more are cast again.
_ROOM = 16
_RAYS_PER_LAUNCH = 1 << 18
_BYTES_OF_A_HIT = 16  # the largest array: two weights in float64


@dataclass
class _Found:
    """Hits of rays, those of each in a region of its own, as far as it has room."""

    counts: npt.NDArray[np.uint32]
    starts: npt.NDArray[np.uint64]
    invalid: int
    arrays: Arrays

    @property
    def room(self) -> npt.NDArray[np.int64]:
        return np.diff(self.starts).astype(np.int64)


def cast_all(target: DeviceMesh, parts: Sequence[GridPart], rays: Rays, fields: Sequence[str]) -> AllHits:
    """All hits through the grids of all parts.

    Raises
    ------
    InputError
        If the rays of one launch have more hits than a buffer of the device can hold.
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
    t, invalid = results["t_hit"], found[0][2]
    return AllHits(splits, t, ids, invalid, target.mesh, rays.origins, rays.directions, computed)


def _of_part(
    target: DeviceMesh, part: GridPart, rays: Rays, fields: Sequence[str]
) -> tuple[npt.NDArray[np.int64], Arrays, int]:
    """Hits of each ray, the hits in order, and the number of invalid rays."""
    o, d = rays.origins.reshape(-1, 3), rays.directions.reshape(-1, 3)
    counts, pieces, invalid = [], [blank(0, fields, target.rung.real)], 0
    division = division_of(rays)
    most = division.launch_of(_RAYS_PER_LAUNCH)
    for first in range(0, len(o), most):
        batch = slice(first, first + most)
        bounds = rays.bounds if len(rays.bounds) == 1 else rays.bounds[batch]
        of_batch = Rays(o[batch], d[batch], bounds)
        starts = np.arange(len(of_batch.origins) + 1, dtype=np.uint64) * np.uint64(_ROOM)
        done = _cast(target, part, of_batch, division, fields, starts)
        counts.append(done.counts)
        invalid += done.invalid
        pieces += _in_order(target, part, of_batch, fields, done)
    joined = {name: np.concatenate([piece[name] for piece in pieces]) for name in pieces[0]}
    joined["primitive_ids"] = joined["primitive_ids"].astype(np.int64) + part.mesh.first
    return np.concatenate([np.zeros(0, np.int64), *counts]).astype(np.int64), joined, invalid


def _in_order(
    target: DeviceMesh, part: GridPart, rays: Rays, fields: Sequence[str], done: _Found
) -> list[Arrays]:
    """The hits of all rays, one ray after another; rays that had no room for all are cast again."""
    needed, begins = done.counts.astype(np.int64), done.starts[:-1].astype(np.int64)
    again = np.flatnonzero(needed > done.room)
    if not len(again):
        rows = _rows(begins, needed)
        return [{name: array[rows] for name, array in done.arrays.items()}]
    starts = np.concatenate([[0], np.cumsum(needed[again])]).astype(np.uint64)
    bounds = rays.bounds if len(rays.bounds) == 1 else rays.bounds[again]
    some = Rays(rays.origins[again], rays.directions[again], bounds)
    second = _cast(target, part, some, division_of(some), fields, starts)
    # The regions of the second cast follow those of the first; rows are then picked in the order of rays.
    begins[again] = int(done.starts[-1]) + starts[:-1].astype(np.int64)
    rows = _rows(begins, needed)
    return [{name: np.concatenate([array, second.arrays[name]])[rows] for name, array in done.arrays.items()}]


def _rows(begins: npt.NDArray[np.int64], lengths: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """begins[0], begins[0] + 1, ... lengths[0] of them, then from begins[1] on, and so forth."""
    before = np.cumsum(lengths) - lengths
    return np.repeat(begins - before, lengths) + np.arange(int(lengths.sum()))


def _cast(
    target: DeviceMesh,
    part: GridPart,
    rays: Rays,
    division: Division,
    fields: Sequence[str],
    starts: npt.NDArray[np.uint64],
) -> _Found:
    room = int(starts[-1])
    if room * _BYTES_OF_A_HIT > largest_buffer(target.device):
        raise InputError(
            f"cast_all: {room:,} hits at once exceed the device's largest buffer; cast fewer rays"
        )
    shapes = blank(0, fields, target.rung.real)
    arrays = {name: np.empty((max(room, 1), *a.shape[1:]), a.dtype) for name, a in shapes.items()}
    rejected = np.zeros(division.items(len(rays.origins)), np.uint32)
    counts = np.zeros(len(rays.origins), np.uint32)
    launch, further = tile_launch("cast_all", target, [part], field_defines(fields), division)
    inputs = [rays.origins, rays.directions, rays.bounds]
    results: list[npt.NDArray[Any]] = [rejected, counts, starts, *arrays.values()]
    launch_on_host(target, launch, [*inputs, *further(inputs)], results)
    return _Found(counts, starts, int(rejected.sum()), arrays)


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
