"""What a picture in stages is asked to be."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from clgrid.camera import Camera
from clgrid.errors import InputError
from clgrid.look import Look, Shading
from clgrid.mesh import Mesh
from clgrid.shading.lamps import lamps_of
from clgrid.shading.surfaces import check_look

Window = tuple[int, int, int, int]
_MOST = 1 << 16


@dataclass(frozen=True)
class Order:
    """What is to be drawn.

    Attributes
    ----------
    camera : Camera
    size : (int, int)
        Width and height of the whole picture.
    window : (x0, y0, x1, y1)
        The pixels of it that are drawn.
    background : 3 floats
    look : Look or None
        None for grey.
    shading : Shading or None
        None for the light at the eye on grey, whatever the look.
    """

    camera: Camera
    size: tuple[int, int]
    window: Window
    background: Sequence[float]
    look: Look | None
    shading: Shading | None


def check_shading(shading: Shading) -> None:
    """Refuse numbers out of range.

    Raises
    ------
    InputError
        Naming the number.
    """
    ranges = (("samples", 1, _MOST), ("occlusion_rays", 0, _MOST), ("seed", 0, 2**64 - 1))
    for name, least, most in ranges:
        value = getattr(shading, name)
        if not isinstance(value, int) or not least <= value <= most:
            raise InputError(f"shading: {name} is {value!r}; give a whole number from {least} to {most}")
    if shading.sun is not None and len(shading.sun) != 3:
        raise InputError(f"shading: sun is {shading.sun}; give the three numbers of a direction")
    if not shading.occlusion_distance > 0.0:
        raise InputError(
            f"shading: occlusion_distance is {shading.occlusion_distance}; give one above 0, or inf"
        )
    if shading.sky is not None and (
        len(shading.sky) != 3 or not all(0.0 <= c < math.inf for c in shading.sky)
    ):
        raise InputError(f"shading: sky is {shading.sky}; give three finite numbers from 0 on")
    if shading.occlusion_rays and shading.sky is None:
        raise InputError(
            "shading: occlusion_rays look for the sky, and there is none; give sky, or 0 of them"
        )


def cells_of(count: int) -> tuple[int, int]:
    """Columns and rows of so many cells of a unit square, as square as can be."""
    rows = next(rows for rows in range(math.isqrt(count), 0, -1) if count % rows == 0)
    return count // rows, rows


def check_order(order: Order, mesh: Mesh) -> None:
    """Refuse a shading out of range, or a look that does not fit the mesh.

    Raises
    ------
    InputError
        Naming what is wrong.
    """
    if order.look is not None:
        check_look(order.look, mesh)
    if order.shading is not None:
        check_shading(order.shading)
        lamps_of(order.look, order.shading)
