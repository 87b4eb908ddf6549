"""Picture files: how channel groups become an EXR, a PNG or a JPEG. The same picture gives the same bytes."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from clgrid.errors import ImageError, InputError

Attribute = str | int | float | npt.NDArray[np.float64]
# Name of the group, its channels and its pixels (h, w, channels).
Part = tuple[str, tuple[str, ...], npt.NDArray[Any]]

EXTENSIONS = (".exr", ".png", ".jpg", ".jpeg")
COMPRESSIONS = ("none", "rle", "zips", "zip", "piz", "pxr24", "b44", "b44a", "dwaa", "dwab")
# They alter values, which is for colours; depths, normals and ids are then packed by zip.
_LOSSY = ("pxr24", "b44", "b44a", "dwaa", "dwab")
# Exif's date that is not known. OpenImageIO would put today's into an EXR that has none.
_NO_DATE = "    :  :     :  :  "
# Groups of colours, which may be halves and may be lossy.
_COLOURS = ("rgba", "albedo")
# OpenImageIO's names; it takes a name that it does not know, such as "float32", for half floats.
OIIO_TYPES = {"float32": "float", "uint32": "uint", "uint8": "uint8"}


_PARTIAL = re.compile(r"\.(.+)\.\d+-[0-9a-f]{8}\.partial(\.\w+)")


@dataclass(frozen=True)
class Window:
    """Where a cropped picture lies in the whole one: the data window within the display window.

    Attributes
    ----------
    x, y : int
        Of the picture's upper left pixel in the whole picture.
    full_width, full_height : int
        Pixels of the whole picture.
    """

    x: int
    y: int
    full_width: int
    full_height: int


@dataclass(frozen=True)
class Saving:
    """How a picture is written.

    Attributes
    ----------
    compression : str
        Of an EXR, one of ``COMPRESSIONS``; a lossy one is for the colours alone.
    half : bool
        Whether an EXR's colours have 16 bits; all other channels keep their 32.
    tile : int
        Side of an EXR's tiles in pixels; 0 for scanlines.
    quality : int
        Of a JPEG, 1 to 100.
    timings : bool
        Whether seconds and the date are among the metadata; without them the same picture gives the same
        bytes.

    Raises
    ------
    InputError
        Naming what is unknown or out of range.
    """

    compression: str = "zips"
    half: bool = False
    tile: int = 0
    quality: int = 90
    timings: bool = True

    def __post_init__(self) -> None:
        if self.compression not in COMPRESSIONS:
            raise InputError(f"compression {self.compression!r}; choose one of {', '.join(COMPRESSIONS)}")
        if self.tile < 0 or self.tile % 16:
            raise InputError(f"tile {self.tile}; give a multiple of 16 pixels, or 0 for scanlines")
        if not 1 <= self.quality <= 100:
            raise InputError(f"quality {self.quality}; give 1 to 100")

    def keeps(self, key: str) -> bool:
        """Whether an entry of the metadata goes into the file."""
        return self.timings or not (key.startswith("clgrid:") and key.endswith("_s"))


def write_parts(
    path: Path,
    parts: Sequence[Part],
    metadata: Mapping[str, Attribute],
    saving: Saving,
    window: Window | None = None,
) -> None:
    """Write channel groups with the metadata; the format follows from the suffix. A window is of an EXR.

    Raises
    ------
    ImageError
        If OpenImageIO cannot write the file.
    """
    import OpenImageIO as oiio  # noqa: N813

    specs = [_spec(part, saving, window) for part in parts]
    kept = {key: value for key, value in metadata.items() if saving.keeps(key)}
    described = kept if path.suffix == ".exr" else _as_text(kept)
    for key, value in described.items():
        _describe(specs[0], key, value)
    out = oiio.ImageOutput.create(str(path))
    if out is None:
        raise ImageError(f"{path}: OpenImageIO cannot write {path.suffix} ({one_line(oiio.geterror())})")
    try:
        done = out.open(str(path), tuple(specs)) if len(specs) > 1 else out.open(str(path), specs[0])
        for k, (_, _, array) in enumerate(parts):
            if done and k:
                done = out.open(str(path), specs[k], "AppendSubimage")
            done = done and out.write_image(array)
        # What is buffered may fail to reach the disk only here.
        done = out.close() and done
        if not done:
            raise ImageError(_why(path, parts, one_line(out.geterror())))
    finally:
        out.close()


def _why(path: Path, parts: Sequence[Part], said: str) -> str:
    """Why a picture could not be written, under the name that it was to have."""
    target = target_of(path) or path
    left = shutil.disk_usage(path.parent).free
    if left < sum(array.nbytes for _, _, array in parts):
        return f"{target}: cannot be written, the disk has {left} bytes left; make room"
    return f"{target}: cannot be written ({said})"


def _spec(part: Part, saving: Saving, window: Window | None) -> Any:
    import OpenImageIO as oiio  # noqa: N813

    name, channels, array = part
    colours = name in _COLOURS
    kind = "half" if saving.half and colours else OIIO_TYPES[array.dtype.name]
    spec = oiio.ImageSpec(array.shape[1], array.shape[0], len(channels), kind)
    spec.channelnames = channels
    if name:
        spec["oiio:subimagename"] = name
        lossy = saving.compression in _LOSSY
        spec["compression"] = "zip" if lossy and not colours else saving.compression
        if saving.tile:
            spec.tile_width = spec.tile_height = saving.tile
        if window is not None:
            spec.x, spec.y = window.x, window.y
            spec.full_width, spec.full_height = window.full_width, window.full_height
        if not saving.timings:
            spec["DateTime"] = _NO_DATE
    else:
        spec["CompressionQuality"] = saving.quality
    if array.dtype == np.uint8:
        spec["oiio:ColorSpace"] = "sRGB"
    elif name == "rgba":
        spec["oiio:ColorSpace"] = "lin_rec709"
    return spec


def _describe(spec: Any, key: str, value: Attribute) -> None:
    if isinstance(value, np.ndarray):
        # Row vectors, the order of OpenEXR and Imath.
        spec.attribute(key, "matrix", tuple(float(x) for x in value.T.ravel()))
    elif isinstance(value, int) and not -(2**31) <= value < 2**31:
        # Integer attributes have 32 bits.
        spec.attribute(key, str(value))
    else:
        spec.attribute(key, value)


def _as_text(metadata: Mapping[str, Attribute]) -> dict[str, Attribute]:
    """Put everything into the description of a PNG or JPEG, which has room for few named texts."""
    lines = [
        f"{key}: {value.tolist() if isinstance(value, np.ndarray) else value}"
        for key, value in metadata.items()
    ]
    software = {key: value for key, value in metadata.items() if key == "Software"}
    return {**software, "ImageDescription": "\n".join(lines)}


def partial_of(target: Path) -> Path:
    """Where a picture is written before it gets its name; each writer has a place of its own."""
    token = f"{os.getpid()}-{os.urandom(4).hex()}"
    return target.with_name(f".{target.stem}.{token}.partial{target.suffix.lower()}")


def target_of(partial: Path) -> Path | None:
    """The picture that a partial file was to become; None of any other file."""
    match = _PARTIAL.fullmatch(partial.name)
    return None if match is None else partial.with_name(match[1] + match[2])


def one_line(text: str) -> str:
    """What OpenImageIO said, as part of a message."""
    return " ".join(text.split()) or "no reason given"
