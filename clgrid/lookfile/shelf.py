"""The look of a scene in the making: textures once each, warnings counted, numbers that can be used."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from pathlib import Path

import numpy as np
import numpy.typing as npt

from clgrid.look import Light, Look, Material, Texture, Wrap
from clgrid.lookfile.pictures import Allowance, PictureError, Pixels
from clgrid.meshfile import one_line

Texel = tuple[int, int, int, int]
MAGENTA, BLACK = (255, 0, 255, 255), (0, 0, 0, 255)
_STAND_INS = {MAGENTA: "magenta", BLACK: "black"}


class Shelf:
    """What one reader gathers of one file."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._counts: dict[str, int] = {}
        self._pictures: dict[Hashable, Pixels | str] = {}
        self._numbers: dict[Hashable, int] = {}
        self._allowance = Allowance()
        self.textures: list[Texture] = []

    def warn(self, what: str) -> None:
        """Note something; the same thing again is counted."""
        self._counts[what] = self._counts.get(what, 0) + 1

    def picture(self, key: Hashable, decode: Callable[[Allowance], Pixels]) -> Pixels | str:
        """Pixels of a picture, or why there are none; decoded once a key."""
        if key not in self._pictures:
            try:
                self._pictures[key] = decode(self._allowance)
            except PictureError as error:
                self._pictures[key] = str(error)
        return self._pictures[key]

    def texture(
        self,
        key: Hashable,
        name: str,
        decode: Callable[[Allowance], Pixels],
        wrap: tuple[Wrap, Wrap] = ("repeat", "repeat"),
        smooth: bool = True,
        stand_in: Texel = MAGENTA,
    ) -> int:
        """Number of a texture; a texel of ``stand_in`` and a warning where its picture cannot be used."""
        pixels = self.picture(key, decode)
        whole = (key, wrap, smooth, stand_in if isinstance(pixels, str) else None)
        if whole not in self._numbers:
            if isinstance(pixels, str):
                self.warn(f"texture {name!r} {pixels}; drawn {_STAND_INS[stand_in]}")
                pixels = np.array([[stand_in]], np.uint8)
            self._numbers[whole] = len(self.textures)
            self.textures.append(Texture(pixels, wrap, smooth, one_line(name)))
        return self._numbers[whole]

    def finite(self, values: npt.NDArray[np.float32], what: str) -> npt.NDArray[np.float32]:
        """Values with those that are NaN or infinite set to zero, and a warning with that."""
        if np.isfinite(values).all():
            return values
        self.warn(f"{what} that are NaN or infinite, taken as 0")
        return np.where(np.isfinite(values), values, np.float32(0))

    def look(
        self,
        materials: list[Material],
        material_ids: npt.NDArray[np.integer],
        uvs: list[npt.NDArray[np.float32]],
        uv_faces: list[npt.NDArray[np.uint32] | None],
        colours: npt.NDArray[np.float32] | None,
        lights: tuple[Light, ...] = (),
    ) -> Look:
        """All of it as a `Look`."""
        lines = (f"{what} ({count})" if count > 1 else what for what, count in self._counts.items())
        return Look(
            materials=tuple(materials),
            material_ids=material_ids.astype(np.uint16 if len(materials) <= 1 << 16 else np.uint32),
            textures=tuple(self.textures),
            uvs=tuple(uvs),
            uv_faces=tuple(uv_faces),
            colours=colours,
            lights=lights,
            warnings=tuple(one_line(f"{self._path}: {line}") for line in lines),
        )

    @property
    def has_warnings(self) -> bool:
        """Whether anything was noted."""
        return bool(self._counts)
