"""Who is right where two renderers differ: the ray against every triangle, in integers."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction

import numpy as np
from second_opinion_compare import F64, Mask, View

from clgrid import rational
from clgrid.mesh import Mesh
from clgrid.prefilter import Triangles

# So many pixels of a picture are decided; crossings within this share of t are in one place.
_MOST, _SAME = 12, Fraction(1, 10**6)


def verdicts(mesh: Mesh, rays: tuple[F64, F64], ours: View, theirs: View, apart: Mask) -> Iterator[str]:
    """One line for each pixel of ``apart``, up to twelve.

    Views are of the same rays and the same triangles; ``rays`` are (H, W, 3) origins and directions.
    """
    if not apart.any():
        return
    triangles = Triangles.of_mesh(mesh)
    for y, x in np.argwhere(apart)[:_MOST].tolist():
        mine, other = int(ours.triangle[y, x]), int(theirs.triangle[y, x])
        met = [c for c in rational.crossings(triangles, rays[0][y, x], rays[1][y, x]) if c.t > 0]
        told = f"clgrid meets {named(mine)}, Mitsuba {named(other)}"
        yield f"pixel {x}, {y}: {told}: {decided(met, mine, other)}"
    if apart.sum() > _MOST:
        yield f"and {int(apart.sum()) - _MOST} more"


def named(triangle: int) -> str:
    return "nothing" if triangle < 0 else f"triangle {triangle}"


def decided(met: list[rational.Crossing], mine: int, other: int) -> str:
    """What exact arithmetic says, given all crossings by distance."""
    if not met:
        right = [name for name, found in (("clgrid", mine), ("Mitsuba", other)) if found < 0]
        return f"nothing is met; {' and '.join(right) or 'neither'} is right"
    first = met[0]
    place = {crossing.id for crossing in met if crossing.t - first.t <= _SAME * first.t}
    if mine == other and mine in place:
        return "the same, and right: only depth or normals differ"
    if mine in place and other in place:
        return "both are in the nearest place"
    right = [name for name, found in (("clgrid", mine), ("Mitsuba", other)) if found in place]
    return f"the first is triangle {first.id}; {' and '.join(right) or 'neither'} is right"
