"""Pictures: float arrays with named channel groups, written to EXR, PNG and JPEG and read back.

An EXR holds one part a group: ``rgba`` (R G B A), ``depth`` (Z), ``normal`` (N.X N.Y N.Z), ``id``
(primitive_id geometry_id), ``steps``, ``t_err``, ``P`` (P.X P.Y P.Z), ``uv`` (uv.U uv.V), ``albedo``
(albedo.R albedo.G albedo.B), ``coverage``. Ids and steps are UINT32 parts filled from integers: through float
buffers OpenImageIO would scale them. A PNG or JPEG holds the colour alone, 8-bit sRGB
without alpha.
"""

from __future__ import annotations

import os
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from clgrid.colour import linear as decoded
from clgrid.errors import ImageError
from clgrid.imagefile import (
    EXTENSIONS,
    OIIO_TYPES,
    Attribute,
    Part,
    Saving,
    Window,
    one_line,
    partial_of,
    write_parts,
)
from clgrid.shown import Facts, Shown, below_picture

__all__ = ["NO_ID", "Attribute", "Image", "check_output", "read_image", "to_srgb8"]

NO_ID = 0xFFFFFFFF

# Of the metadata, what a notebook shows.
_TOLD = ("clgrid:source", "clgrid:triangles", "clgrid:device", "clgrid:layout", "clgrid:render_s")

# Name, numpy type and channel names of each group, in the order of an EXR's parts.
_PARTS: tuple[tuple[str, Any, tuple[str, ...]], ...] = (
    ("rgba", np.float32, ("R", "G", "B", "A")),
    ("depth", np.float32, ("Z",)),
    ("normal", np.float32, ("N.X", "N.Y", "N.Z")),
    ("id", np.uint32, ("primitive_id", "geometry_id")),
    ("steps", np.uint32, ("steps",)),
    ("t_err", np.float32, ("t_err",)),
    ("P", np.float32, ("P.X", "P.Y", "P.Z")),
    ("uv", np.float32, ("uv.U", "uv.V")),
    ("albedo", np.float32, ("albedo.R", "albedo.G", "albedo.B")),
    ("coverage", np.float32, ("coverage",)),
)

GROUPS = tuple(name for name, _, _ in _PARTS)
"""Names of the groups, in the order of an EXR's parts."""


@dataclass(repr=False)
class Image(Shown):
    """A rendered picture; row 0 is the top row.

    Attributes
    ----------
    rgba : (h, w, 4) float32
        Linear colour (Rec. 709) and coverage: alpha is 1 on a hit and 0 on the background, whose
        colour is kept.
    depth : (h, w) float32 or None
        Planar depth along the view axis in scene units; inf on the background.
    normal : (h, w, 3) float32 or None
        Unit shading normal in scene axes, on the viewer's side; zero on the background.
    primitive_id, geometry_id : (h, w) uint32 or None
        Triangle and geometry hit; 0xFFFFFFFF on the background.
    steps : (h, w) uint32 or None
        Cells that the pixel's ray looked at.
    t_err : (h, w) float32 or None
        Bound on the error of the distance along the ray, in lengths of its direction, whose component along
        the view axis is 1; 0 on the background.
    position : (h, w, 3) float32 or None
        Where the pixel's ray hits, in scene units; zero on the background.
    uv : (h, w, 2) float32 or None
        Texture coordinates there, of the first set; zero on the background and where there are none.
    albedo : (h, w, 3) float32 or None
        Linear share of light that the surface sends back; zero on the background.
    coverage : (h, w) float32 or None
        Share of the pixel's samples that hit.
    crop : (int, int)
        Column and row of the first pixel in the whole picture.
    full_size : (int, int) or None
        Width and height of that, where this is a window of it.
    metadata : dict
        Text, numbers and (4, 4) matrices: attributes of an EXR, lines of a PNG's description.
    """

    rgba: npt.NDArray[np.float32]
    depth: npt.NDArray[np.float32] | None = None
    normal: npt.NDArray[np.float32] | None = None
    primitive_id: npt.NDArray[np.uint32] | None = None
    geometry_id: npt.NDArray[np.uint32] | None = None
    steps: npt.NDArray[np.uint32] | None = None
    t_err: npt.NDArray[np.float32] | None = None
    position: npt.NDArray[np.float32] | None = None
    uv: npt.NDArray[np.float32] | None = None
    albedo: npt.NDArray[np.float32] | None = None
    coverage: npt.NDArray[np.float32] | None = None
    crop: tuple[int, int] = (0, 0)
    full_size: tuple[int, int] | None = None
    metadata: dict[str, Attribute] = field(default_factory=dict)

    @property
    def width(self) -> int:
        """Pixels in a row."""
        return int(self.rgba.shape[1])

    @property
    def height(self) -> int:
        """Rows."""
        return int(self.rgba.shape[0])

    @property
    def hits(self) -> int:
        """Pixels that show the mesh."""
        return int(np.count_nonzero(self.rgba[..., 3]))

    def _headline(self) -> str:
        return f"{self.width} x {self.height}, {self.hits:,} pixels show the mesh"

    def _facts(self) -> Facts:
        names = ("depth", "normal", "primitive_id", "steps", "t_err", "position", "uv", "albedo", "coverage")
        groups = [name for name in names if self._has(name)]
        told = {key.removeprefix("clgrid:"): self.metadata.get(key) for key in _TOLD}
        facts = {"groups": ", ".join(["rgba", *groups])}
        return {**facts, **{name: str(value) for name, value in told.items() if value is not None}}

    def _has(self, name: str) -> bool:
        return getattr(self, name) is not None

    def _repr_html_(self) -> str:
        """The picture and a table, for notebooks."""
        return below_picture(self.png(), super()._repr_html_())

    def png(self) -> bytes:
        """The colours as a PNG file, in sRGB."""
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "picture.png"
            self.save(path)
            return path.read_bytes()

    def save(
        self,
        path: str | Path,
        *,
        compression: str = "zips",
        half: bool = False,
        tile: int = 0,
        quality: int = 90,
        timings: bool = True,
    ) -> None:
        """Write to ``.exr``, ``.png`` or ``.jpg``; the file appears under its name only when complete.

        A window of a whole picture keeps its place there, as an EXR's data and display windows.

        Parameters
        ----------
        path : str or Path
            A file that is there is replaced.
        compression : str
            Of an EXR: none, rle, zips, zip, piz, or a lossy one for its colours: pxr24, b44, b44a, dwaa,
            dwab.
        half : bool
            Write an EXR's colours in 16 bits; all else keeps its 32.
        tile : int
            Side of an EXR's tiles, a multiple of 16; 0 writes scanlines.
        quality : int
            Of a JPEG, 1 to 100.
        timings : bool
            Keep the seconds among the metadata; without them the same picture gives the same bytes.

        Raises
        ------
        ImageError
            If the extension is unknown or the file cannot be written.
        InputError
            If an option is unknown or out of range.
        """
        saving = Saving(compression, half, tile, quality, timings)
        window = None if self.full_size is None else Window(*self.crop, *self.full_size)
        target = Path(path)
        check_output(target)
        partial = partial_of(target)
        try:
            if target.suffix.lower() == ".exr":
                write_parts(partial, self._exr_parts(), self.metadata, saving, window)
            else:
                colour = to_srgb8(self.rgba[..., :3])
                write_parts(partial, [("", ("R", "G", "B"), colour)], self.metadata, saving)
            os.replace(partial, target)
        except OSError as error:
            raise ImageError(f"{target}: cannot be written ({error.strerror}); choose another -o") from error
        finally:
            partial.unlink(missing_ok=True)

    def _exr_parts(self) -> list[Part]:
        ids = None
        if self.primitive_id is not None and self.geometry_id is not None:
            ids = np.stack([self.primitive_id, self.geometry_id], -1)
        arrays = {
            "rgba": self.rgba,
            "depth": self.depth,
            "normal": self.normal,
            "id": ids,
            "steps": self.steps,
            "t_err": self.t_err,
            "P": self.position,
            "uv": self.uv,
            "albedo": self.albedo,
            "coverage": self.coverage,
        }
        parts = []
        for name, dtype, channels in _PARTS:
            array = arrays[name]
            if array is not None:
                # Always with a channel axis: OpenImageIO reads (h, w) as w channels.
                pixels = np.ascontiguousarray(array, dtype).reshape(self.height, self.width, len(channels))
                parts.append((name, channels, pixels))
        return parts


def check_output(path: str | Path) -> None:
    """Find out before the work whether an image could be written to ``path``.

    Raises
    ------
    ImageError
        If the extension is unknown, or the folder is missing or not writable.
    """
    target = Path(path)
    if target.suffix.lower() not in EXTENSIONS:
        raise ImageError(f"{target}: unknown picture format; end its name in {', '.join(EXTENSIONS)}")
    if not target.parent.is_dir():
        raise ImageError(f"{target}: no such folder {target.parent}; create it or choose another -o")
    if target.is_dir():
        raise ImageError(f"{target}: is a folder; choose another -o")
    if not os.access(target.parent, os.W_OK):
        raise ImageError(f"{target}: folder {target.parent} is not writable; choose another -o")


def read_image(path: str | Path) -> Image:
    """Read an EXR that clgrid wrote, or the first part of any picture that OpenImageIO reads.

    Returns
    -------
    image : Image
        Groups that the file lacks are None; a PNG's colour stays sRGB in [0, 1], its alpha is 1. An EXR of a
        window has its ``crop`` and ``full_size``.

    Raises
    ------
    ImageError
        If the file cannot be read or has no colour.
    """
    import OpenImageIO as oiio  # noqa: N813

    source = oiio.ImageInput.open(str(path))
    if source is None:
        raise ImageError(f"{path}: cannot be read as a picture ({one_line(oiio.geterror())})")
    found: dict[str, npt.NDArray[Any]] = {}
    metadata: dict[str, Any] = {}
    crop, full_size = (0, 0), None
    part = 0
    while source.seek_subimage(part, 0):
        spec = source.spec()
        name = spec.getattribute("oiio:subimagename") or "rgba"
        wanted = {known: (dtype, channels) for known, dtype, channels in _PARTS}.get(name)
        if part == 0:
            metadata = {a.name: a.value for a in spec.extra_attribs if not a.name.startswith("oiio:")}
            if (spec.x, spec.y, spec.width, spec.height) != (0, 0, spec.full_width, spec.full_height):
                crop, full_size = (spec.x, spec.y), (spec.full_width, spec.full_height)
        if wanted is not None:
            pixels = source.read_image(part, 0, 0, spec.nchannels, OIIO_TYPES[np.dtype(wanted[0]).name])
            if pixels is None:
                raise ImageError(f"{path}: damaged picture ({one_line(source.geterror())})")
            found[name] = _pick(pixels, list(spec.channelnames), wanted[1], path)
        part += 1
    source.close()
    if "rgba" not in found:
        raise ImageError(f"{path}: has no colour part")
    ids = found.get("id")
    return Image(
        found["rgba"],
        depth=found["depth"][..., 0] if "depth" in found else None,
        normal=found.get("normal"),
        primitive_id=None if ids is None else ids[..., 0],
        geometry_id=None if ids is None else ids[..., 1],
        steps=found["steps"][..., 0] if "steps" in found else None,
        t_err=found["t_err"][..., 0] if "t_err" in found else None,
        position=found.get("P"),
        uv=found.get("uv"),
        albedo=found.get("albedo"),
        coverage=found["coverage"][..., 0] if "coverage" in found else None,
        crop=crop,
        full_size=full_size,
        metadata=metadata,
    )


def to_srgb8(linear: npt.NDArray[np.float32]) -> npt.NDArray[np.uint8]:
    """Convert linear values to 8-bit sRGB, clipped to [0, 1] and rounded to nearest (IEC 61966-2-1)."""
    red = linear[..., 0]
    if linear.shape[-1] == 3 and all(np.array_equal(red, linear[..., k]) for k in (1, 2)):
        # Grey, as plain pictures are: one search for three.
        return np.repeat(to_srgb8(np.ascontiguousarray(red)[..., None]), 3, axis=-1)
    # The linear value at which each 8-bit step begins, so that one search converts a pixel.
    starts = decoded((np.arange(1, 256) - 0.5) / 255.0)
    return np.searchsorted(starts.astype(np.float32), linear, side="right").astype(np.uint8)


def _pick(
    pixels: npt.NDArray[Any], names: list[str], wanted: tuple[str, ...], path: str | Path
) -> npt.NDArray[Any]:
    """Look up the wanted channels by name: files keep channels in their own order."""
    planes = []
    for channel in wanted:
        if channel in names:
            planes.append(pixels[..., names.index(channel)])
        elif channel == "A":
            planes.append(np.ones(pixels.shape[:2], pixels.dtype))
        else:
            raise ImageError(f"{path}: part lacks channel {channel}, it has {', '.join(names)}")
    return np.stack(planes, -1)
