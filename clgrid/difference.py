"""How two pictures differ: largest and mean difference, PSNR, and what an observer sees of it (FLIP).

Andersson et al., "FLIP: A Difference Evaluator for Alternating Images", 2020, by OpenImageIO.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from clgrid.imagefile import one_line

FLIP = "FLIP"
Colours = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Difference:
    """Of two arrays of pixels.

    Attributes
    ----------
    pixels, differing : int
        All, and those that differ in a bit; two that are not a number are alike.
    largest, mean : float
        Of the absolute differences, over all channels; inf where one of two numbers is.
    psnr : float or None
        Decibels to a signal of 1; None for equal arrays.
    """

    pixels: int
    differing: int
    largest: float
    mean: float
    psnr: float | None


def distances(first: npt.NDArray[Any], second: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    """Absolute differences of numbers; 0 between two that are not a number, or infinite alike."""
    a, b = first.astype(np.float64), second.astype(np.float64)
    with np.errstate(invalid="ignore"):
        away = np.abs(a - b)
    away[(a == b) | (np.isnan(a) & np.isnan(b))] = 0.0
    away[np.isnan(away)] = math.inf
    return away


def differing_pixels(first: npt.NDArray[Any], second: npt.NDArray[Any]) -> npt.NDArray[np.bool_]:
    """(h, w) whether they differ in a bit of any channel."""
    bits = np.dtype(f"u{first.dtype.itemsize}")
    other = np.ascontiguousarray(first).view(bits) != np.ascontiguousarray(second).view(bits)
    flags: npt.NDArray[np.bool_] = other.reshape(*other.shape[:2], -1).any(axis=-1)
    return flags


def difference(first: npt.NDArray[Any], second: npt.NDArray[Any]) -> Difference:
    """Of two arrays of the same shape, (h, w) or (h, w, channels), and dtype."""
    away = distances(first, second)
    square = float(np.mean(np.square(away)))
    return Difference(
        pixels=first.shape[0] * first.shape[1],
        differing=int(np.count_nonzero(differing_pixels(first, second))),
        largest=float(away.max(initial=0.0)),
        mean=float(away.mean()),
        psnr=None if square == 0 else -10.0 * math.log10(square),
    )


def flip(first: Colours, second: Colours) -> tuple[float, float] | None:
    """Mean and maximum of FLIP of linear colours, (h, w, 3), of any brightness; None where it fails.

    At OpenImageIO's 67 pixels a degree. Of the two, the first is the reference.
    """
    import OpenImageIO as oiio  # noqa: N813

    measure = getattr(oiio.ImageBufAlgo, "FLIP_diff", None)
    if measure is None or not (np.isfinite(first).all() and np.isfinite(second).all()):
        return None
    reference, tested = (oiio.ImageBuf(np.ascontiguousarray(each)) for each in (first, second))
    found = measure(reference, tested)
    if found.has_error:
        raise RuntimeError(f"OpenImageIO's FLIP fails: {one_line(found.geterror())}")
    spec = found.spec()
    return tuple(float(spec.getattribute(f"FLIP:{name}error")) for name in ("mean", "max"))  # type: ignore[return-value]
