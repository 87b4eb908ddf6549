"""Pictures for textures: any file that OpenImageIO reads, as 8-bit sRGB with alpha."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from clgrid.colour import srgb

MAX_PIXELS = 1 << 26
"""Pixels that a texture may have, asked of its header before anything is decoded: 256 MiB."""
MAX_TOTAL = 1 << 28
"""Pixels that all textures of a scene may have: 1 GiB."""

Pixels = npt.NDArray[np.uint8]


class PictureError(Exception):
    """A picture that cannot be used, and why; the reader of the scene puts a stand-in in its place."""


@dataclass
class Allowance:
    """Pixels that textures of one scene may still have."""

    pixels: int = MAX_TOTAL

    def take(self, width: int, height: int) -> None:
        """Refuse a picture that is too large, or too much with those before."""
        count = width * height
        if count > MAX_PIXELS:
            raise PictureError(f"has {width}x{height} pixels, at most {MAX_PIXELS} are read; make it smaller")
        if count > self.pixels:
            raise PictureError(f"has {width}x{height} pixels, and all textures have more than {MAX_TOTAL}")
        self.pixels -= count


def read_picture(path: Path, allowance: Allowance) -> Pixels:
    """Decode a picture file.

    Parameters
    ----------
    path : Path
        Of a regular file.
    allowance : Allowance
        What it is counted against, by its header.

    Returns
    -------
    (H, W, 4) uint8
        sRGB and unassociated alpha; grey becomes three equal channels, float pictures are taken as linear.

    Raises
    ------
    PictureError
        If it is missing, too large or damaged.
    """
    import OpenImageIO as oiio  # noqa: N813

    if not path.is_file():
        raise PictureError("is missing")
    config = oiio.ImageSpec()
    # else colours come multiplied by alpha, and cannot be looked up apart from it
    config["oiio:UnassociatedAlpha"] = 1
    source = oiio.ImageInput.open(str(path), config)
    if source is None:
        raise PictureError(f"cannot be read ({_reason(oiio.geterror())})")
    try:
        spec = source.spec()
        if spec.width < 1 or spec.height < 1 or spec.depth > 1 or not 1 <= spec.nchannels <= 64:
            raise PictureError(f"has {spec.width}x{spec.height}x{spec.depth} pixels")
        allowance.take(spec.width, spec.height)
        floats = spec.format in (oiio.FLOAT, oiio.HALF, oiio.DOUBLE)
        channels = min(4, spec.nchannels)
        read: Any = source.read_image(0, 0, 0, channels, "float" if floats else "uint8")
        if read is None:
            raise PictureError(f"is damaged ({_reason(source.geterror())})")
        return _rgba(_bytes(read) if floats else read, spec.alpha_channel)
    finally:
        source.close()


def unpack_picture(data: bytes | memoryview, allowance: Allowance) -> Pixels:
    """Decode a picture held in memory, as `read_picture`.

    OpenImageIO's Python module reads files alone, so it is given a temporary one; the bytes tell the format.
    """
    with tempfile.TemporaryDirectory(prefix="clgrid-") as folder:
        path = Path(folder) / f"picture{_suffix(data)}"
        path.write_bytes(data)
        return read_picture(path, allowance)


def _suffix(data: bytes | memoryview) -> str:
    """Suffix of the formats that scenes embed; OpenImageIO tries all of its readers for others."""
    first = bytes(data[:12])
    known = {b"\x89PNG": ".png", b"\xff\xd8\xff": ".jpg", b"DDS ": ".dds"}
    if first[:4] == b"RIFF" and first[8:] == b"WEBP":
        return ".webp"
    return next((suffix for magic, suffix in known.items() if first.startswith(magic)), ".bin")


def _bytes(light: npt.NDArray[np.float32]) -> Pixels:
    """Linear floats as sRGB bytes, alpha as it is."""
    values = np.nan_to_num(light, posinf=1.0, neginf=0.0)
    colours = values.shape[2] - (values.shape[2] in (2, 4))
    encoded = np.concatenate([srgb(values[..., :colours]), np.clip(values[..., colours:], 0, 1)], axis=2)
    packed: Pixels = np.rint(encoded * 255).astype(np.uint8)
    return packed


def _rgba(pixels: Pixels, alpha: int) -> Pixels:
    """Grey, grey with alpha, RGB or RGBA as RGBA; ``alpha`` is the number of its channel, -1 for none."""
    count = pixels.shape[2]
    full = np.full((*pixels.shape[:2], 4), 255, np.uint8)
    full[..., :3] = pixels[..., :3] if count >= 3 else pixels[..., :1]
    if 0 <= alpha < count:
        full[..., 3] = pixels[..., alpha]
    return full


def _reason(text: str) -> str:
    return text.strip().partition("\n")[0].rpartition("/")[2][:200] or "unknown format"
