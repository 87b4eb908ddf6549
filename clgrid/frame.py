"""The local frame: where the kernels see the mesh, at unit size and near the origin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgrid import structs
from clgrid.errors import MeshError
from clgrid.mesh import FloatArray, Mesh

# Beyond these exponents a double cannot hold the scale and its inverse with room for directions.
_LARGEST_EXPONENT = 900
# Vertices at a time, few enough for a core's cache.
_CHUNK = 1 << 13
_LONG_ROW = 256
# float32 holds two to this power and its inverse.
_FLOAT_EXPONENT = 126
_SMALLEST_NORMAL = np.float32(2.0**-126)


@dataclass(frozen=True)
class LocalFrame:
    """Maps scene coordinates to local ones: ``local = (scene - offset) * 2**-exponent``.

    All local vertices lie within [-1, 1]. For float32 vertices the map is exact, but for
    values that underflow: an axis is only moved where its bounds differ by at most a factor of
    two, so that the difference of floats is a float (Sterbenz 1974).

    Attributes
    ----------
    offset : (3,) float64
        In scene units.
    exponent : int
        The largest extent lies below ``2**exponent`` scene units.
    """

    offset: npt.NDArray[np.float64]
    exponent: int

    @classmethod
    def of_bounds(cls, bounds: npt.NDArray[np.float64]) -> LocalFrame:
        """The frame of a mesh with these bounds.

        Parameters
        ----------
        bounds : (2, 3) float64
            Lowest and highest corner, scene units.

        Raises
        ------
        MeshError
            If coordinates exceed 2**900.
        """
        low, high = bounds
        smaller, larger = np.minimum(np.abs(low), np.abs(high)), np.maximum(np.abs(low), np.abs(high))
        far = (low > 0) == (high > 0)
        far &= (low != 0) & (high != 0) & (larger / 2 <= smaller)
        # float32, so that the difference to a float32 vertex needs no more digits than it has.
        with np.errstate(over="ignore"):
            middle = (low / 2 + high / 2).astype(np.float32).astype(np.float64)
        middle = np.where(np.isfinite(middle), middle, low)
        offset = np.where(far, np.clip(middle, low, high), 0.0)
        reach = float(np.max(np.abs(bounds - offset)))
        exponent = int(np.frexp(reach)[1]) if reach > 0 else 0
        if exponent > _LARGEST_EXPONENT:
            raise MeshError(f"coordinates reach {reach:g}; scale the mesh below 2^{_LARGEST_EXPONENT}")
        return cls(offset, max(exponent, -_LARGEST_EXPONENT))

    def to_local(
        self, vertices: FloatArray, out: npt.NDArray[np.float32] | None = None
    ) -> npt.NDArray[np.float32]:
        """Local float32 coordinates, each rounded at most once.

        Parameters
        ----------
        vertices : (V, 3) float32 or float64
            Scene units.
        out : (V, 3) float32, optional
            Where to put them.
        """
        local = np.empty(vertices.shape, np.float32) if out is None else out
        scale = 2.0**-self.exponent
        with np.errstate(under="ignore", over="ignore", invalid="ignore"):
            if vertices.dtype == np.float32 and abs(self.exponent) <= _FLOAT_EXPONENT:
                if not self.offset.any():
                    return np.multiply(vertices, np.float32(scale), out=local)
                if (self.offset.astype(np.float32) == self.offset).all():
                    return self._to_local_short(vertices, local)
            rows = min(_CHUNK, len(vertices))
            moved = np.empty((rows, *vertices.shape[1:]))
            for start in range(0, len(vertices), _CHUNK):
                part = vertices[start : start + _CHUNK]
                np.subtract(part, self.offset, out=moved[: len(part)])
                # Exact: the scale is a power of two, and what underflows float64 is nothing in float32.
                np.multiply(moved[: len(part)], scale, out=local[start : start + _CHUNK], casting="same_kind")
        return local

    def _to_local_short(
        self, vertices: FloatArray, local: npt.NDArray[np.float32]
    ) -> npt.NDArray[np.float32]:
        """``to_local`` in float32 alone: the difference to a vertex in use is exact, and so is the scale."""
        offset, scale = self.offset.astype(np.float32), np.float32(2.0**-self.exponent)
        # Long rows: numpy takes ten times as long for rows of three numbers.
        whole = len(vertices) // _LONG_ROW * _LONG_ROW
        rows, wide = vertices[:whole].reshape(-1, 3 * _LONG_ROW), np.tile(offset, _LONG_ROW)
        moved = local[:whole].reshape(-1, 3 * _LONG_ROW)
        at_once = _CHUNK // _LONG_ROW
        for start in range(0, len(rows), at_once):
            part = moved[start : start + at_once]
            np.subtract(rows[start : start + at_once], wide, out=part)
            np.multiply(part, scale, out=part)
        np.multiply(vertices[whole:] - offset, scale, out=local[whole:])
        return local

    def to_local_wide(self, vertices: FloatArray) -> npt.NDArray[np.float64]:
        """Local float64 coordinates: exact, unless they are below 2**-1022.

        An axis is only moved where that is exact for doubles too (Sterbenz 1974).

        Parameters
        ----------
        vertices : (V, 3) float32 or float64
            Scene units.
        """
        local = np.subtract(vertices, self.offset, dtype=np.float64)
        with np.errstate(under="ignore", over="ignore", invalid="ignore"):
            local *= 2.0**-self.exponent
        return local

    def loses(self, vertices: FloatArray, wide: npt.NDArray[np.float64]) -> bool:
        """Whether a local coordinate is not the vertex' own, being rounded or too small beside the mesh."""
        with np.errstate(over="ignore", invalid="ignore"):
            back = np.ldexp(wide, self.exponent) + self.offset
        return not np.array_equal(back, vertices, equal_nan=True)

    def holds(self, vertices: FloatArray, local: npt.NDArray[np.float32]) -> bool:
        """Whether the float32 ``local`` coordinates are the vertices' own, without rounding."""
        return all(
            self._holds(vertices[start : start + _CHUNK], local[start : start + _CHUNK])
            for start in range(0, len(vertices), _CHUNK)
        )

    def _holds(self, vertices: FloatArray, local: npt.NDArray[np.float32]) -> bool:
        # float32 vertices are rounded only where they underflow.
        if vertices.dtype == np.float32 and bool((np.abs(local) >= _SMALLEST_NORMAL).all()):
            return True
        return not self.loses(vertices, local.astype(np.float64))

    def max_rounding(self, mesh: Mesh) -> float:
        """Largest change, in scene units, that a used coordinate suffers on its way to local."""
        worst = 0.0
        used = np.unique(mesh.faces) if mesh.faces.size else np.zeros(0, np.int64)
        for start in range(0, len(used), _CHUNK):
            part = mesh.vertices[used[start : start + _CHUNK]]
            back = np.ldexp(self.to_local(part).astype(np.float64), self.exponent)
            worst = max(worst, float(np.max(np.abs((part.astype(np.float64) - self.offset) - back))))
        return worst

    def params(self) -> npt.NDArray[np.void]:
        """The struct that kernels read."""
        return structs.FRAME.pack(
            offset=self.offset, scale=2.0**-self.exponent, inverse_scale=2.0**self.exponent
        )
