"""What the stages of a tile hand on to each other, on the device."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np


class TileArrays:
    """Arrays of a tile of pixels, ``pyopencl.array.Array`` of (rows, columns, ...), each made at first use.

    Parameters
    ----------
    queue : pyopencl.CommandQueue
    shape : (int, int)
        Rows and columns.
    """

    _DEPTHS: ClassVar = {"albedos": 3, "coordinates": 2, "sums": 4, "rgba": 4, "arriving": 1, "open": 1}
    _TYPES: ClassVar = {"coordinates": np.float32, "rgba": np.float32, "open": np.uint32}
    _VECTORS = ("origins", "directions", "starts", "ways", "positions", "faced", "shaded", "radiances")

    def __init__(self, queue: Any, shape: tuple[int, int]) -> None:
        self._queue = queue
        self.shape = shape
        self.count = shape[0] * shape[1]
        self._sky: tuple[Any, Any] | None = None

    def __getattr__(self, name: str) -> Any:
        depth = 3 if name in self._VECTORS else self._DEPTHS.get(name)
        if depth is None:
            raise AttributeError(name)
        made = self._made((*self.shape, depth), self._TYPES.get(name, np.float64))
        setattr(self, name, made)
        return made

    def sky_rays(self, rays: int) -> tuple[Any, Any]:
        """Origins and directions of so many pictures of rays, one below the other."""
        shape = (rays * self.shape[0], self.shape[1], 3)
        if self._sky is None or self._sky[0].shape != shape:
            self._sky = self._made(shape, np.float64), self._made(shape, np.float64)
        return self._sky

    def _made(self, shape: tuple[int, ...], dtype: Any) -> Any:
        import pyopencl.array as cl_array

        return cl_array.zeros(self._queue, shape, dtype)
