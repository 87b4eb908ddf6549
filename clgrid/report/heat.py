"""Heat maps as PNG: a palette of one ramp whose lightness only rises, so that it reads without colour."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import numpy.typing as npt

# From near black over violet and orange to pale yellow; equal steps of the ramp.
_ANCHORS = np.array(
    [
        [16, 18, 34],
        [54, 30, 92],
        [116, 40, 110],
        [184, 58, 88],
        [232, 104, 50],
        [248, 168, 48],
        [252, 238, 170],
    ]
)
_NOTHING = (128, 132, 140)


def palette() -> npt.NDArray[np.uint8]:
    """Return the ramp, (256, 3): entry 0 is 0, entry 255 the largest value."""
    places = np.linspace(0, len(_ANCHORS) - 1, 256)
    columns = [np.interp(places, range(len(_ANCHORS)), _ANCHORS[:, k]) for k in range(3)]
    return np.stack(columns, axis=1).round().astype(np.uint8)


def heat_png(values: npt.NDArray[np.floating], largest: float | None = None) -> bytes:
    """Write an array as a PNG, by the square root of its share of the largest value: small ones show too.

    Parameters
    ----------
    values : array (H, W)
        At least 0; NaN is drawn grey.
    largest : float, optional
        Of all heat maps that are to be compared; that of the array.

    Returns
    -------
    bytes
        8 bits a pixel, by palette.
    """
    known = np.isfinite(values)
    top = float(np.max(values, where=known, initial=0.0)) if largest is None else largest
    shares = np.where(known, values, 0.0) / (top or 1.0)
    # 0 alone is entry 0; the last entry but one of the palette is for what is not known.
    steps = np.where(shares > 0, np.maximum(1, np.sqrt(np.clip(shares, 0, 1)) * 254), 0).astype(np.uint8)
    steps[~known] = 255
    colours = palette()
    colours[254:] = [colours[255], _NOTHING]
    height, width = values.shape
    rows = np.concatenate([np.zeros((height, 1), np.uint8), steps], axis=1).tobytes()
    header = struct.pack(">IIBBBBB", width, height, 8, 3, 0, 0, 0)
    parts = (
        (b"IHDR", header),
        (b"PLTE", colours.tobytes()),
        (b"IDAT", zlib.compress(rows, 9)),
        (b"IEND", b""),
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(_chunk(kind, data) for kind, data in parts)


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
