"""What a ray's values are computed from: the caller's ray, the local frame, planes and corners."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import numpy.typing as npt

from clgrid.frame import LocalFrame
from clgrid.locate.arithmetic import Number
from clgrid.locate.child import Planes
from clgrid.locate.stages import DOUBLE, FLOAT, LONG
from clgrid.mesh import Mesh
from clgrid.repro_record import ReproGrid, ReproRay

CONSTANTS = {
    "START_LIMIT": (2.0, DOUBLE),
    "ENTRY_CUBE": (1.5, DOUBLE),
    "FAR": (2.0**1000, DOUBLE),
    "T_SLACK": (32 * 2.0**-24, DOUBLE),
    "TWO_TO_MINUS_50": (2.0**-50, DOUBLE),
    "SMALLEST_CLIMB": (2.0**-200, DOUBLE),
    "SMALLEST_EDGE": (2.0**-80, FLOAT),
    "SMALLEST_PRODUCT": (2.0**-900, DOUBLE),
    "TICKS": (2.0**54, DOUBLE),
    "MOST_TICKS": (2.0**57, DOUBLE),
}
"""Of cl/config.h, cl/walk.h and cl/triangle_precise.h, but for FAR."""


def number(value: float, kind: str) -> Number | None:
    """The number, or None for one that is none."""
    return Number(Fraction(value), kind) if math.isfinite(value) else None


@dataclass(frozen=True)
class Setting:
    """What one ray's values are computed from.

    Attributes
    ----------
    constants : dict of str to Number
    resolution : (int, int, int)
    cells : int
        Of a grid whose cells are all of one size; of a nested one those of the top grid.
    """

    constants: dict[str, Number]
    resolution: tuple[int, int, int]
    mesh: Mesh
    local: npt.NDArray[np.float32] | npt.NDArray[np.float64]
    names: Sequence[int] | None = None

    @classmethod
    def of(
        cls, mesh: Mesh, grid: ReproGrid, ray: ReproRay, planes: Planes, names: Sequence[int] | None
    ) -> Setting:
        """The setting of a ray through the grid over a mesh."""
        frame = LocalFrame.of_bounds(mesh.bounds)
        values = {**CONSTANTS, **_of_ray(ray), **_of_frame(frame)}
        for axis, a in enumerate("xyz"):
            values[f"lower_{a}"] = planes.lower[axis], DOUBLE
            values[f"upper_{a}"] = planes.upper[axis], DOUBLE
            values[f"cell_size_{a}"] = planes.cell_size[axis], DOUBLE
            values[f"cells_{a}"] = planes.resolution[axis], LONG
        known = {name: number(*value) for name, value in values.items()}
        wide = grid.accuracy != "robust"
        local = frame.to_local_wide(mesh.vertices) if wide else frame.to_local(mesh.vertices)
        constants = {name: each for name, each in known.items() if each is not None}
        return cls(constants, planes.resolution, mesh, local, names)

    def corners(self, triangle: int, axes: Sequence[int]) -> dict[str, Number]:
        """Local coordinates of a triangle along the axes of the shear: ``a_kx`` and so on."""
        kind = FLOAT if self.local.dtype == np.float32 else DOUBLE
        rows = self.local[self.mesh.faces[triangle]].astype(np.float64).tolist()
        return {
            f"{corner}_k{a}": Number(Fraction(row[axis]), kind)
            for corner, row in zip("abc", rows, strict=True)
            for a, axis in zip("xyz", axes, strict=True)
        }

    def cell_at(self, cell: int) -> tuple[int, int, int] | None:
        """A cell along x, y and z; None for one of a subgrid."""
        x, y, z = self.resolution
        return (cell % x, cell // x % y, cell // (x * y)) if cell < x * y * z else None

    def name_of(self, triangle: int) -> int:
        """The scene's number of a triangle."""
        return triangle if self.names is None else self.names[triangle]


def _of_ray(ray: ReproRay) -> dict[str, tuple[float, str]]:
    origin, direction = (row.astype(np.float64).tolist() for row in ray.arrays)
    values: dict[str, tuple[float, str]] = {}
    for a, o, d in zip("xyz", origin, direction, strict=True):
        values[f"caller_origin_{a}"] = o, DOUBLE
        values[f"caller_direction_{a}"] = d, DOUBLE
    for name, bound in zip(("t_min", "t_max"), ray.interval, strict=True):
        values[name] = bound, DOUBLE
    # As prepare_ray chooses them.
    longest = max(abs(d) for d in direction)
    if math.isfinite(longest) and longest > 0:
        first = 2.0**400 if longest < 2.0**-600 else 2.0**-400 if longest > 2.0**600 else 1.0
        values["first_factor"] = first, DOUBLE
        values["second_factor"] = 2.0 ** -math.frexp(longest * first)[1], DOUBLE
    return values


def _of_frame(frame: LocalFrame) -> dict[str, tuple[float, str]]:
    values = {f"offset_{a}": (each, DOUBLE) for a, each in zip("xyz", frame.offset.tolist(), strict=True)}
    values["scale"] = 2.0**-frame.exponent, DOUBLE
    values["inverse_scale"] = 2.0**frame.exponent, DOUBLE
    return values
