"""Compare two picture files, group by group."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import clgrid
from clgrid.colour import linear
from clgrid.difference import difference, distances, flip
from clgrid.difference_record import DiffRecord, GroupRecord
from clgrid.errors import InputError
from clgrid.image import GROUPS, Image, read_image


def compare_pictures(
    first: str | Path,
    second: str | Path,
    tolerance: float = 0.0,
    max_flip: float | None = None,
    groups: Sequence[str] = (),
) -> DiffRecord:
    """Compare two pictures.

    Colours are compared as linear light: those of an 8-bit file beside an EXR are decoded.

    Parameters
    ----------
    first, second : str or Path
        EXRs of clgrid, or any pictures that OpenImageIO reads.
    tolerance : float
        Largest absolute difference of a channel; ids and steps have none.
    max_flip : float, optional
        Largest mean of FLIP; colours within it may differ by more than the tolerance.
    groups : sequence of str
        Which groups to compare; by default all that either has.

    Raises
    ------
    ImageError
        If one cannot be read.
    InputError
        If they differ in size or window, or a number or a group is unknown or out of range.
    """
    unknown = [name for name in groups if name not in GROUPS]
    if unknown:
        raise InputError(f"diff: unknown group {unknown[0]!r}; choose of {', '.join(GROUPS)}")
    if not tolerance >= 0 or not (max_flip is None or max_flip >= 0):
        raise InputError(f"diff: tolerance {tolerance:g}, max-flip {max_flip}; give none below 0")
    images = [read_image(path) for path in (first, second)]
    _require_same_size(images, first, second)
    arrays = [_arrays(image) for image in images]
    if Path(first).suffix.lower() == ".exr" or Path(second).suffix.lower() == ".exr":
        for found, path in zip(arrays, (first, second), strict=True):
            if Path(path).suffix.lower() in (".png", ".jpg", ".jpeg"):
                found["rgba"] = _decoded(found["rgba"])
    wanted = [name for name in GROUPS if name in (groups or GROUPS)]
    missing = [name for name in wanted if (name in arrays[0]) != (name in arrays[1])]
    absent = [name for name in groups if name not in arrays[0] and name not in arrays[1]]
    if absent:
        raise InputError(f"diff: neither picture has the group {absent[0]!r}; render both with --aov")
    both = [name for name in wanted if name in arrays[0] and name in arrays[1]]
    colours = [found["rgba"][..., :3] for found in arrays]
    seen = (flip(*colours) if "rgba" in both else None) or (None, None)
    records = [_group(name, arrays[0][name], arrays[1][name], tolerance) for name in both]
    alike = max_flip is not None and seen[0] is not None and seen[0] <= max_flip
    strict = [each for each in records if not (alike and each.group == "rgba")]
    flip_within = max_flip is None or "rgba" not in both or alike
    return DiffRecord(
        schema="clgrid.diff/1",
        clgrid=clgrid.__version__,
        first=str(first),
        second=str(second),
        width=images[0].width,
        height=images[0].height,
        pixels=images[0].width * images[0].height,
        tolerance=tolerance,
        max_flip=max_flip,
        groups=records,
        missing=tuple(missing),
        flip=seen[0],
        largest_flip=seen[1],
        within=not missing and flip_within and not any(each.beyond for each in strict),
    )


def _require_same_size(images: Sequence[Image], first: str | Path, second: str | Path) -> None:
    sizes = [f"{image.width}x{image.height} at {image.crop}" for image in images]
    if sizes[0] != sizes[1]:
        raise InputError(
            f"diff: {first} is {sizes[0]} and {second} {sizes[1]}; give pictures of the same pixels"
        )


def _arrays(image: Image) -> dict[str, npt.NDArray[Any]]:
    """Arrays by group, (h, w) or (h, w, channels)."""
    named: dict[str, npt.NDArray[Any] | None] = {
        **{name: getattr(image, name, None) for name in GROUPS},
        "P": image.position,
        "id": image.primitive_id,
    }
    return {name: array for name, array in named.items() if array is not None}


def _decoded(rgba: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
    """Linear light of sRGB colours; alpha stays."""
    return np.concatenate([linear(rgba[..., :3]), rgba[..., 3:]], axis=-1).astype(np.float32)


def _group(name: str, first: npt.NDArray[Any], second: npt.NDArray[Any], tolerance: float) -> GroupRecord:
    seen, away = difference(first, second), distances(first, second)
    whole = np.issubdtype(first.dtype, np.integer)
    beyond = (away > (0.0 if whole else tolerance)).reshape(*away.shape[:2], -1).any(axis=-1)
    psnr = None if whole else seen.psnr
    return GroupRecord(
        group=name,
        differing=seen.differing,
        beyond=int(np.count_nonzero(beyond)),
        largest=_finite(seen.largest),
        mean=_finite(seen.mean),
        psnr=None if psnr is None else _finite(psnr),
    )


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
