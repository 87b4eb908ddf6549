"""Pictures: float arrays with named channel groups, written to EXR and PNG and read back.

An EXR holds one part a group: ``rgba`` (R G B A), ``depth`` (Z), ``normal`` (N.X N.Y N.Z), ``id``
(primitive_id geometry_id), ``steps``, ``t_err``, ``P`` (P.X P.Y P.Z), ``uv`` (uv.U uv.V), ``albedo``
(albedo.R albedo.G albedo.B), ``coverage``. Ids and steps are UINT32 parts filled from integers: through float
buffers OpenImageIO would scale them. A PNG holds the colour alone, 8-bit sRGB without alpha.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from clgrid.errors import ImageError
from clgrid.shown import Facts, Shown, below_picture

Attribute = str | int | float | npt.NDArray[np.float64]

EXTENSIONS = (".exr", ".png")
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
# OpenImageIO's names; it takes a name that it does not know, such as "float32", for half floats.
_OIIO_TYPES = {"float32": "float", "uint32": "uint", "uint8": "uint8"}


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

    def save(self, path: str | Path) -> None:
        """Write to ``.exr`` or ``.png``; the file appears under its name only when complete.

        Raises
        ------
        ImageError
            If the extension is unknown or the file cannot be written.
        """
        target = Path(path)
        check_output(target)
        partial = target.with_name(f".{target.stem}.{os.getpid()}.partial{target.suffix.lower()}")
        try:
            if target.suffix.lower() == ".exr":
                _write(partial, self._exr_parts(), self.metadata)
            else:
                colour = to_srgb8(self.rgba[..., :3])
                _write(partial, [("", ("R", "G", "B"), colour)], _as_text(self.metadata))
            os.replace(partial, target)
        except OSError as error:
            raise ImageError(f"{target}: cannot be written ({error.strerror}); choose another -o") from error
        finally:
            partial.unlink(missing_ok=True)

    def _exr_parts(self) -> list[tuple[str, tuple[str, ...], npt.NDArray[Any]]]:
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
        raise ImageError(f"{target}: unknown picture format; end its name in {' or '.join(EXTENSIONS)}")
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
        Groups that the file lacks are None; a PNG's colour stays sRGB in [0, 1], its alpha is 1.

    Raises
    ------
    ImageError
        If the file cannot be read or has no colour.
    """
    import OpenImageIO as oiio  # noqa: N813

    source = oiio.ImageInput.open(str(path))
    if source is None:
        raise ImageError(f"{path}: cannot be read as a picture ({_one_line(oiio.geterror())})")
    found: dict[str, npt.NDArray[Any]] = {}
    metadata: dict[str, Any] = {}
    part = 0
    while source.seek_subimage(part, 0):
        spec = source.spec()
        name = spec.getattribute("oiio:subimagename") or "rgba"
        wanted = {known: (dtype, channels) for known, dtype, channels in _PARTS}.get(name)
        if part == 0:
            metadata = {a.name: a.value for a in spec.extra_attribs if not a.name.startswith("oiio:")}
        if wanted is not None:
            pixels = source.read_image(part, 0, 0, spec.nchannels, _OIIO_TYPES[np.dtype(wanted[0]).name])
            if pixels is None:
                raise ImageError(f"{path}: damaged picture ({_one_line(source.geterror())})")
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
        metadata=metadata,
    )


def to_srgb8(linear: npt.NDArray[np.float32]) -> npt.NDArray[np.uint8]:
    """Convert linear values to 8-bit sRGB, clipped to [0, 1] and rounded to nearest (IEC 61966-2-1)."""
    # The linear value at which each 8-bit step begins, so that one search converts a pixel.
    steps = (np.arange(1, 256) - 0.5) / 255.0
    starts = np.where(steps <= 0.04045, steps / 12.92, ((steps + 0.055) / 1.055) ** 2.4)
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


def _write(
    path: Path,
    parts: list[tuple[str, tuple[str, ...], npt.NDArray[Any]]],
    metadata: Mapping[str, Attribute],
) -> None:
    import OpenImageIO as oiio  # noqa: N813

    specs = []
    for name, channels, array in parts:
        spec = oiio.ImageSpec(array.shape[1], array.shape[0], len(channels), _OIIO_TYPES[array.dtype.name])
        spec.channelnames = channels
        if name:
            spec["oiio:subimagename"] = name
            # Rows of a part are compressed one by one: fast to write, exact.
            spec["compression"] = "zips"
        if array.dtype == np.uint8:
            spec["oiio:ColorSpace"] = "sRGB"
        elif name == "rgba":
            spec["oiio:ColorSpace"] = "lin_rec709"
        specs.append(spec)
    for key, value in metadata.items():
        if isinstance(value, np.ndarray):
            # Row vectors, the order of OpenEXR and Imath.
            specs[0].attribute(key, "matrix", tuple(float(x) for x in value.T.ravel()))
        elif isinstance(value, int) and not -(2**31) <= value < 2**31:
            # Integer attributes have 32 bits.
            specs[0].attribute(key, str(value))
        else:
            specs[0].attribute(key, value)
    out = oiio.ImageOutput.create(str(path))
    if out is None:
        raise ImageError(f"{path}: OpenImageIO cannot write {path.suffix} ({_one_line(oiio.geterror())})")
    try:
        done = out.open(str(path), tuple(specs)) if len(specs) > 1 else out.open(str(path), specs[0])
        for k, (_, _, array) in enumerate(parts):
            if done and k:
                done = out.open(str(path), specs[k], "AppendSubimage")
            done = done and out.write_image(array)
        if not done:
            raise ImageError(f"{path.parent}: picture cannot be written ({_one_line(out.geterror())})")
    finally:
        out.close()


def _as_text(metadata: Mapping[str, Attribute]) -> dict[str, Attribute]:
    """Put everything into the description of a PNG, which has room for few named texts."""
    lines = [
        f"{key}: {value.tolist() if isinstance(value, np.ndarray) else value}"
        for key, value in metadata.items()
    ]
    software = {key: value for key, value in metadata.items() if key == "Software"}
    return {**software, "Description": "\n".join(lines)}


def _one_line(text: str) -> str:
    return " ".join(text.split()) or "no reason given"
