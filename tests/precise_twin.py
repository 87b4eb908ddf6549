"""The numpy float64 twin of rung ``precise``: cl/ray.h and cl/triangle_precise.h, for every triangle.

No filter: what the kernels' float32 filter would drop is tested here.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import numpy.typing as npt

from clgrid.frame import LocalFrame
from clgrid.mesh import Mesh

F64 = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

START_LIMIT, ENTRY_CUBE = 2.0, 1.5
SMALLEST_PRODUCT = 2.0**-900


@dataclass(frozen=True)
class Closest:
    """What ``Hits`` must hold."""

    t_hit: F64
    ids: Ints
    uvs: F64


def two_sum(a: F64, b: F64) -> tuple[F64, F64]:
    high = a + b
    of_b = high - a
    return high, (a - (high - of_b)) + (b - of_b)


def split(a: F64) -> tuple[F64, F64]:
    c = 134217729.0 * a
    high = c - (c - a)
    return high, a - high


def two_product(a: F64, b: F64) -> tuple[F64, F64]:
    (ah, al), (bh, bl) = split(a), split(b)
    high = a * b
    return high, al * bl - (((high - ah * bh) - al * bh) - ah * bl)


def difference_of_products(p: F64, q: F64, r: F64, s: F64) -> F64:
    """P q - r s, its sign exact."""
    (ah, al), (bh, bl) = two_product(p, q), two_product(r, s)
    (hh, hl), (lh, ll) = two_sum(ah, -bh), two_sum(al, -bl)
    sh, sl = two_sum(hh, lh)
    result = sh + (sl + (hl + ll))
    left, right = (p != 0) & (q != 0), (r != 0) & (s != 0)
    lost = (left & (np.abs(ah) < SMALLEST_PRODUCT)) | (right & (np.abs(bh) < SMALLEST_PRODUCT))
    for i in zip(*np.nonzero(lost | ~left | ~right), strict=True):
        result[i] = _beyond(*(float(x[i]) for x in (p, q, r, s)))
    return result


def _beyond(p: float, q: float, r: float, s: float) -> float:
    left, right = p != 0 and q != 0, r != 0 and s != 0
    a, b = p * q, r * s
    exact = Fraction(p) * Fraction(q) - Fraction(r) * Fraction(s)
    tiny = 2.0**-1074 * ((exact > 0) - (exact < 0))
    if left and right:
        return a - b if a != b else tiny
    return a - b + tiny


def scale_up(values: F64) -> F64:
    """(N, 1) powers of two that bring the largest of each row of (N, 3) to about 1, if they are less."""
    reach = np.abs(values).max(1, keepdims=True)
    return np.where(reach > 0, np.ldexp(1.0, -np.clip(np.frexp(reach)[1], -1020, 0)), 1.0)


def closest(mesh: Mesh, origins: F64, directions: F64, t_min: float = 0.0, t_max: float = np.inf) -> Closest:
    """The nearest accepted t in the interval, the lowest id among equals; rays (N, 3) float64."""
    frame = LocalFrame.of_bounds(mesh.bounds)
    with np.errstate(all="ignore"):
        corners = frame.to_local_wide(mesh.vertices)[mesh.faces]
        parts = [
            _closest(frame, corners, origins[i : i + 1], directions[i : i + 1], t_min, t_max)
            for i in range(len(origins))
        ]
    return Closest(*(np.concatenate([part[k] for part in parts]) for k in range(3)))  # type: ignore[arg-type]


def _prepare(frame: LocalFrame, origin: F64, direction: F64) -> tuple[F64, F64, float, float] | None:
    """Local origin and direction, t_entry, t_unit; None for a ray that meets nothing."""
    scale = 2.0**-frame.exponent
    o, d = (origin - frame.offset) * scale, direction.copy()
    longest = np.abs(d).max()
    if not (np.isfinite(o).all() and np.isfinite(d).all() and longest > 0):
        return None
    first = 2.0**400 if longest < 2.0**-600 else 2.0**-400 if longest > 2.0**600 else 1.0
    second = 2.0 ** -int(np.frexp(longest * first)[1])
    d = d * first * second
    t_unit = 2.0**frame.exponent * first * second
    if not 2.0**-960 <= t_unit <= 2.0**960:
        return None
    t_entry = 0.0
    if np.abs(o).max() > START_LIMIT:
        if (np.abs(o[d == 0]) > ENTRY_CUBE).any():
            return None
        moving = d != 0
        side = np.where(d > 0, ENTRY_CUBE, -ENTRY_CUBE)
        near, far = ((-side - o) / d)[moving].max(), ((side - o) / d)[moving].min()
        if not near <= far:
            return None
        t_entry = float(near)
    rest = two_sum(origin, -frame.offset)[1] * scale
    along_high, along_low = two_product(np.full(3, t_entry), d)
    high, low = two_sum(o, along_high)
    return np.clip(high + (low + (rest + along_low)), -START_LIMIT, START_LIMIT), d, t_entry, t_unit


def _closest(
    frame: LocalFrame, corners: F64, origins: F64, directions: F64, t_min: float, t_max: float
) -> tuple[F64, Ints, F64]:
    miss = np.array([np.inf]), np.array([-1]), np.zeros((1, 2))
    ray = _prepare(frame, origins[0], directions[0])
    if ray is None:
        return miss
    origin, direction, t_entry, t_unit = ray
    # The axes are those of the float32 direction.
    x, y, z = np.abs(direction.astype(np.float32))
    kz = (0 if x >= z else 2) if x >= y else (1 if y >= z else 2)
    kx, ky = (kz + 1) % 3, (kz + 2) % 3
    if direction.astype(np.float32)[kz] < 0:
        kx, ky = ky, kx
    sx, sy, sz = direction[kx] / direction[kz], direction[ky] / direction[kz], 1.0 / direction[kz]
    pz = corners[..., kz] - origin[kz]
    px = (corners[..., kx] - origin[kx]) - sx * pz
    py = (corners[..., ky] - origin[ky]) - sy * pz
    (ax, bx, cx), (ay, by, cy), (az, bz, cz) = px.T, py.T, pz.T
    edges = np.stack([cx * by - cy * bx, ax * cy - ay * cx, bx * ay - by * ax])
    mixed = (edges < 0).any(0) & (edges > 0).any(0)
    reach = np.maximum(np.abs(px).max(1), np.abs(py).max(1))
    slender = np.abs((edges[0] + edges[1]) + edges[2]) < 2.0 * reach * reach * reach
    redo = np.flatnonzero(~mixed & (reach > 0) & (slender | (np.abs(edges).min(0) < SMALLEST_PRODUCT)))
    if len(redo):
        a_x, b_x, c_x = (px[redo] * scale_up(px[redo])).T
        a_y, b_y, c_y = (py[redo] * scale_up(py[redo])).T
        edges[0, redo] = difference_of_products(c_x, b_y, c_y, b_x)
        edges[1, redo] = difference_of_products(a_x, c_y, a_y, c_x)
        edges[2, redo] = difference_of_products(b_x, a_y, b_y, a_x)
        mixed = (edges < 0).any(0) & (edges > 0).any(0)
    u, v, w = edges
    det = (u + v) + w
    t = ((u / det * az + v / det * bz) + w / det * cz) * sz
    at = (t_entry + t) * t_unit
    accepted = ~mixed & (det != 0) & (reach > 0) & (at >= t_min) & (at <= t_max)
    if not accepted.any():
        return miss
    best = int(np.argmin(np.where(accepted, at, np.inf)))
    best = best if accepted[best] else int(np.argmax(accepted))  # t beyond double
    return at[best : best + 1], np.array([best]), np.array([[v[best] / det[best], w[best] / det[best]]])
