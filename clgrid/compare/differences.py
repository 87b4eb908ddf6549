"""Where the answers of two devices differ: rays by what differs in them, and pictures."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import numpy.typing as npt

from clgrid.compare.files import Answers
from clgrid.compare_record import DifferingRay, HeatMap, ImageDifferences, RayDifferences
from clgrid.difference import FLIP, difference, differing_pixels, distances, flip
from clgrid.rungs import RUNGS
from clgrid.wavefront import Batch, pixel_order

Mask = npt.NDArray[np.bool_]

_MISS = 0xFFFFFFFF
_MOST_BLOCKS = 128


def ray_masks(first: Answers, second: Answers, kind: str) -> dict[str, Mask]:
    """(N,) each: which rays differ in a bit of ``id``, ``t``, ``u`` and ``v``."""
    uvs, others = (_bits(answers.uvs[kind]) for answers in (first, second))
    return {
        "id": first.ids[kind] != second.ids[kind],
        "t": _bits(first.t[kind]) != _bits(second.t[kind]),
        "u": uvs[:, 0] != others[:, 0],
        "v": uvs[:, 1] != others[:, 1],
    }


def _bits(reals: npt.NDArray[Any]) -> npt.NDArray[Any]:
    return np.ascontiguousarray(reals).view(f"u{reals.dtype.itemsize}")


def any_of(masks: dict[str, Mask]) -> Mask:
    """(N,) which rays differ in anything."""
    differing: Mask = np.logical_or.reduce(list(masks.values()))
    return differing


def ray_differences(first: Answers, second: Answers, kind: str, accuracy: str) -> RayDifferences:
    """How the hits of a kind of rays differ on a rung."""
    masks = ray_masks(first, second, kind)
    hit, other = first.ids[kind] != _MISS, second.ids[kind] != _MISS
    same = hit & ~masks["id"]
    real = RUNGS[accuracy].real
    uvs, others = first.uvs[kind][same], second.uvs[kind][same]
    return RayDifferences(
        kind=kind,
        rays=len(hit),
        differing=int(np.count_nonzero(any_of(masks))),
        **{name: int(np.count_nonzero(mask)) for name, mask in masks.items()},
        only_first=int(np.count_nonzero(hit & ~other)),
        only_second=int(np.count_nonzero(other & ~hit)),
        t_ulps=most_ulps(first.t[kind][same], second.t[kind][same], real),
        u_ulps=most_ulps(uvs[:, 0], others[:, 0], real),
        v_ulps=most_ulps(uvs[:, 1], others[:, 1], real),
    )


def most_ulps(first: npt.NDArray[Any], second: npt.NDArray[Any], real: type[np.floating[Any]]) -> float:
    """The largest difference, in last places that the larger number has as a ``real``; 0 of none."""
    away = distances(first, second)
    # Two that are not a number are alike, and have no last place.
    apart = away > 0
    with np.errstate(over="ignore"):
        larger = np.maximum(np.abs(first[apart]), np.abs(second[apart])).astype(real)
    # That of the largest number of all is beyond what numpy can tell.
    last = np.spacing(np.fmin(larger, np.finfo(real).max / 2)).astype(np.float64)
    return _finite(float((away[apart] / last).max(initial=0.0)))


def _finite(value: float) -> float:
    """The number, or the largest there is: JSON has no infinite ones."""
    return min(value, sys.float_info.max)


def image_differences(first: Answers, second: Answers) -> ImageDifferences:
    """How the pictures differ."""
    seen = difference(first.rgba, second.rgba)
    colours = difference(first.rgba[..., :3], second.rgba[..., :3])
    told = flip(first.rgba[..., :3], second.rgba[..., :3]) if seen.differing else (0.0, 0.0)
    mean, most = told or (None, None)
    return ImageDifferences(
        pixels=seen.pixels,
        differing=seen.differing,
        ids=int(np.count_nonzero(first.primitive_id != second.primitive_id)),
        largest=_finite(colours.largest),
        mean=_finite(colours.mean),
        psnr=None if colours.psnr is None else max(colours.psnr, -sys.float_info.max),
        perceptual=mean,
        largest_perceptual=most,
        measure=FLIP,
    )


def heat_map(first: Answers, second: Answers) -> HeatMap | None:
    """Where in the picture primary rays and colours differ; None where none do."""
    height, width = first.primitive_id.shape
    rays = np.zeros(height * width, np.float64)
    if "primary" in first.t:
        rays[pixel_order(width, height)] = any_of(ray_masks(first, second, "primary"))
    away = distances(first.rgba[..., :3], second.rgba[..., :3]).max(axis=-1)
    other = differing_pixels(first.rgba, second.rgba) | (first.primitive_id != second.primitive_id)
    if not rays.any() and not other.any():
        return None
    block = -(-max(width, height) // _MOST_BLOCKS)
    counts = _by_block(rays.reshape(height, width), block, np.add)
    colours = _by_block(away, block, np.maximum)
    return HeatMap(
        width=counts.shape[1],
        height=counts.shape[0],
        block=block,
        rays=counts.astype(np.int64).ravel().tolist(),
        image=[_finite(float(f"{value:.3g}")) for value in colours.ravel().tolist()],
    )


def _by_block(values: npt.NDArray[np.float64], block: int, joined: np.ufunc) -> npt.NDArray[np.float64]:
    """What the values of each block come to."""
    for axis in (0, 1):
        starts = np.arange(0, values.shape[axis], block)
        values = joined.reduceat(values, starts, axis=axis)
    return values


def first_ray(first: Answers, second: Answers, rays: dict[str, Batch]) -> tuple[DifferingRay, Batch] | None:
    """The first ray that differs, as the record tells it and alone in a batch; None if none does."""
    for kind, batch in rays.items():
        masks = ray_masks(first, second, kind)
        rows = np.flatnonzero(any_of(masks))
        if not len(rows):
            continue
        row = int(rows[0])
        alone = Batch(kind, batch.origins[row], batch.directions[row], batch.t_max)
        return DifferingRay(
            kind=kind,
            index=row,
            origin=_hexadecimal(alone.origins),
            direction=_hexadecimal(alone.directions),
            t_min=(0.0).hex(),
            t_max=float(batch.t_max).hex(),
            differs=tuple(name for name, mask in masks.items() if mask[row]),
            first=_in_words(first, kind, row),
            second=_in_words(second, kind, row),
        ), alone
    return None


def _hexadecimal(vector: npt.NDArray[np.float64]) -> tuple[str, str, str]:
    x, y, z = (value.hex() for value in vector.tolist())
    return x, y, z


def _in_words(answers: Answers, kind: str, row: int) -> str:
    if answers.ids[kind][row] == _MISS:
        return "a miss"
    u, v = answers.uvs[kind][row].tolist()
    return f"t {answers.t[kind].item(row)!r}, triangle {answers.ids[kind][row]}, u {u!r}, v {v!r}"
