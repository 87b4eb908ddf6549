"""How one picture differs from another."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from clgrid.tradeoff.intervals import rate_most
from clgrid.tradeoff_record import PictureErrors

Ids = npt.NDArray[np.uint32]
Colours = npt.NDArray[np.float32]


def picture_errors(ids: Ids, true_ids: Ids, colours: Colours, true_colours: Colours) -> PictureErrors:
    """Compare all pixels.

    Parameters
    ----------
    ids, true_ids : (h, w) uint32
        Triangle that each pixel shows.
    colours, true_colours : (h, w, 3 or more) float32
        Linear red, green and blue; what follows them is not compared.
    """
    others, pixels = int(np.count_nonzero(ids != true_ids)), ids.size
    off = np.abs(colours[..., :3].astype(np.float64) - true_colours[..., :3])
    square = float(np.mean(off * off))
    return PictureErrors(
        pixels=pixels,
        other_triangles=others,
        other_share=others / pixels,
        other_share_most=rate_most(others, pixels),
        largest=float(off.max()),
        rms=math.sqrt(square),
        psnr=-10.0 * math.log10(square) if square else None,
    )


def same_colours(a: Colours, b: Colours) -> bool:
    """Whether all channels are the same, bit for bit."""
    return a.shape == b.shape and np.array_equal(a.view(np.uint32), b.view(np.uint32))
