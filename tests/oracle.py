"""What the kernels must answer, computed apart from them.

``prepare_rays``, ``intersect`` and ``closest`` are the numpy twins of cl/ray.h and cl/triangle.h: the same
float32 and float64 operations, vectorised over rays and triangles, so that every bit must agree.
``exact_t`` is the exact reference, for one ray and triangle: the truth of whatever it is given.
``exact_lists`` is what the compact grid must hold, from exact planes.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import numpy.typing as npt

from clgrid.frame import LocalFrame
from clgrid.mesh import Mesh
from clgrid.rational import crossing_t

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]
Ints = npt.NDArray[np.int64]

U = 2.0**-24
START_LIMIT, ENTRY_CUBE = 2.0, 1.5
SMALLEST_EDGE = np.float32(2.0**-80)

_PAIRS_AT_ONCE = 1 << 18


@dataclass(frozen=True)
class LocalRays:
    """Rays as cl/ray.h stores them; all arrays have one row a ray."""

    origin: F32
    direction: F32
    t_min: F64
    t_max: F64
    t_entry: F64
    t_unit: F64
    valid: Bool
    reaches: Bool

    def __len__(self) -> int:
        return len(self.origin)

    def part(self, rows: slice) -> LocalRays:
        return LocalRays(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))

    def scene_t(self, t: F32) -> F64:
        """Scene t of local t: (N, ...) float32."""
        shape = (len(self),) + (1,) * (t.ndim - 1)
        with np.errstate(all="ignore"):
            return (self.t_entry.reshape(shape) + t.astype(np.float64)) * self.t_unit.reshape(shape)


@dataclass(frozen=True)
class Tests:
    """Every ray against every triangle, (N, F) each: what ``intersect_triangle`` answers."""

    accepted: Bool
    t: F32
    u: F32
    v: F32
    slender: Bool
    weights: F64
    """(N, F, 3) float64: the edge functions that t was made of."""


def prepare_rays(
    origins: npt.NDArray[np.float64] | F32,
    directions: npt.NDArray[np.float64] | F32,
    frame: LocalFrame,
    t_min: npt.ArrayLike = 0.0,
    t_max: npt.ArrayLike = np.inf,
) -> LocalRays:
    """Twin of ``prepare_ray``; origins and directions (N, 3)."""
    count = len(origins)
    low = np.array(np.broadcast_to(np.asarray(t_min, np.float64), count))
    high = np.array(np.broadcast_to(np.asarray(t_max, np.float64), count))
    with np.errstate(all="ignore"):
        o = (origins.astype(np.float64) - frame.offset) * 2.0**-frame.exponent
        d = directions.astype(np.float64)
        longest = np.max(np.where(np.isnan(d), 0.0, np.abs(d)), axis=1, initial=0.0)
        farthest = np.max(np.where(np.isnan(o), 0.0, np.abs(o)), axis=1, initial=0.0)
        finite = np.isfinite(o).all(1) & np.isfinite(d).all(1) & ~np.isnan(low) & ~np.isnan(high)
        valid = finite & (longest > 0)

        first = np.where(longest < 2.0**-600, 2.0**400, np.where(longest > 2.0**600, 2.0**-400, 1.0))
        exponent = np.frexp(np.where(valid, longest * first, 1.0))[1]
        second = np.ldexp(1.0, -exponent)
        d = d * first[:, None] * second[:, None]
        t_unit = 2.0**frame.exponent * first * second
        valid &= (t_unit >= 2.0**-960) & (t_unit <= 2.0**960)

        moved = farthest > START_LIMIT
        side = np.where(d > 0, ENTRY_CUBE, -ENTRY_CUBE)
        t0 = np.where(d != 0, (-side - o) / d, -np.inf)
        t1 = np.where(d != 0, (side - o) / d, np.inf)
        t_near = np.max(t0, axis=1)
        t_far = np.min(t1, axis=1)
        outside = ((d == 0) & (np.abs(o) > ENTRY_CUBE)).any(1)
        reaches = valid & (~moved | (~outside & (t_near <= t_far)))
        t_entry = np.where(moved & reaches, t_near, 0.0)

        start = np.clip(o + t_entry[:, None] * d, -START_LIMIT, START_LIMIT)
        keep = reaches[:, None]
        return LocalRays(
            np.where(keep, start, 0.0).astype(np.float32),
            np.where(keep, d, 0.0).astype(np.float32),
            low,
            high,
            t_entry,
            np.where(valid, t_unit, 1.0),
            valid,
            reaches,
        )


def _shear(rays: LocalRays) -> tuple[Ints, F32, F32]:
    """Twin of ``shear_of``: (N, 3) axes kx, ky, kz; (N, 3) permuted origin; (N, 3) sx, sy, sz."""
    x, y, z = np.abs(rays.direction).T
    kz = np.where(x >= y, np.where(x >= z, 0, 2), np.where(y >= z, 1, 2))
    kx = (kz + 1) % 3
    ky = (kz + 2) % 3
    rows = np.arange(len(rays))
    back = rays.direction[rows, kz] < 0
    axes = np.stack([np.where(back, ky, kx), np.where(back, kx, ky), kz], axis=1)
    origin = np.take_along_axis(rays.origin, axes, axis=1)
    d = np.take_along_axis(rays.direction, axes, axis=1).astype(np.float64)
    with np.errstate(all="ignore"):
        s = np.stack([d[:, 0] / d[:, 2], d[:, 1] / d[:, 2], 1.0 / d[:, 2]], axis=1).astype(np.float32)
    return axes, origin, s


def intersect(rays: LocalRays, vertices: F32, faces: npt.NDArray[np.uint32]) -> Tests:
    """Twin of ``intersect_triangle`` for every ray and every triangle."""
    axes, origin, s = _shear(rays)
    corners = vertices[faces]  # (F, 3 corners, 3)
    with np.errstate(all="ignore"):
        # (N, F, 3 corners) on each permuted axis
        p = [np.moveaxis(corners, -1, 0)[axes[:, k]] - origin[:, k, None, None] for k in range(3)]
        z = p[2]
        x = p[0] - s[:, 0, None, None] * z
        y = p[1] - s[:, 1, None, None] * z
        (ax, bx, cx), (ay, by, cy) = np.moveaxis(x, -1, 0), np.moveaxis(y, -1, 0)
        u32 = cx * by - cy * bx
        v32 = ax * cy - ay * cx
        w32 = bx * ay - by * ax
        assert u32.dtype == np.float32
        edges32 = np.stack([u32, v32, w32], axis=-1)
        mixed = (edges32 < 0).any(-1) & (edges32 > 0).any(-1)

        det32 = np.abs((u32 + v32) + w32)
        reach = np.maximum(np.abs(x).max(-1), np.abs(y).max(-1))
        slender = det32 < np.float32(2) * reach * reach * reach
        redo = slender | (np.abs(edges32).min(-1) < SMALLEST_EDGE)
        wide = [a.astype(np.float64) for a in (ax, bx, cx, ay, by, cy)]
        ax, bx, cx, ay, by, cy = wide
        edges64 = np.stack([cx * by - cy * bx, ax * cy - ay * cx, bx * ay - by * ax], axis=-1)
        edges = np.where(redo[..., None], edges64, edges32.astype(np.float64))
        mixed |= (edges < 0).any(-1) & (edges > 0).any(-1)
        u, v, w = np.moveaxis(edges, -1, 0)
        det = (u + v) + w
        az, bz, cz = np.moveaxis(z.astype(np.float64), -1, 0)
        t = ((u * az + v * bz) + w * cz) * s[:, 2, None].astype(np.float64) / det
        accepted = ~mixed & (det != 0) & rays.reaches[:, None]
        return Tests(
            accepted, t.astype(np.float32), (v / det).astype(np.float32), (w / det).astype(np.float32),
            slender, edges,
        )  # fmt: skip


@dataclass(frozen=True)
class Closest:
    """What ``Hits`` must hold, and the local float32 t behind it."""

    t_hit: F64
    ids: Ints
    uvs: F32
    local_t: F32


def closest(rays: LocalRays, vertices: F32, faces: npt.NDArray[np.uint32]) -> Closest:
    """Twin of ``closest_of_all``: the nearest accepted t in the interval, the lowest id among equals."""
    step = max(1, _PAIRS_AT_ONCE // len(faces))
    parts = [_closest(rays.part(slice(i, i + step)), vertices, faces) for i in range(0, len(rays), step)]
    return Closest(
        np.concatenate([p.t_hit for p in parts]),
        np.concatenate([p.ids for p in parts]),
        np.concatenate([p.uvs for p in parts]),
        np.concatenate([p.local_t for p in parts]),
    )


def _closest(rays: LocalRays, vertices: F32, faces: npt.NDArray[np.uint32]) -> Closest:
    tests = intersect(rays, vertices, faces)
    at = rays.scene_t(tests.t)
    inside = tests.accepted & (at >= rays.t_min[:, None]) & (at <= rays.t_max[:, None])
    t = np.where(inside, tests.t, np.float32(np.inf))
    best = np.argmin(np.where(inside, at, np.inf), axis=1)  # the first of equals
    best = np.where(inside[np.arange(len(rays)), best], best, np.argmax(inside, axis=1))  # t beyond double
    rows = np.arange(len(rays))
    hit = inside[rows, best]
    return Closest(
        np.where(hit, at[rows, best], np.inf),
        np.where(hit, best, -1),
        np.where(hit[:, None], np.stack([tests.u[rows, best], tests.v[rows, best]], axis=1), np.float32(0)),
        t[rows, best],
    )


def local_mesh(mesh: Mesh) -> tuple[LocalFrame, F32]:
    """The mesh's frame, and its vertices in it."""
    frame = LocalFrame.of_bounds(mesh.bounds)
    return frame, frame.to_local(mesh.vertices)


def exact_t(origin: F32, direction: F32, triangle: F32) -> Fraction | None:
    """Exact t at which the line of the stored ray crosses the stored triangle, or None."""
    return crossing_t(triangle, origin, direction)


def exact_lists(
    vertices: F32,
    faces: npt.NDArray[np.uint32],
    planes: npt.NDArray[np.void],
    resolution: tuple[int, int, int],
    pad: float,
) -> list[list[int]]:
    """The triangles of each closed cell that their box, padded by ``pad``, touches. All exact.

    Plane k lies at lower + k * cell_size of the GridParams record, without rounding.
    """
    lower, cell_size = planes["lower"], planes["cell_size"]
    lists: list[list[int]] = [[] for _ in range(int(np.prod(resolution)))]
    corners = vertices[faces]
    lows, highs = corners.min(axis=1), corners.max(axis=1)
    for face, (low, high) in enumerate(zip(lows, highs, strict=True)):
        spans = []
        for axis in range(3):
            origin, cell = Fraction(float(lower[axis])), Fraction(float(cell_size[axis]))
            first = (Fraction(float(low[axis])) - Fraction(pad) - origin) / cell
            last = (Fraction(float(high[axis])) + Fraction(pad) - origin) / cell
            # A box that ends in a plane touches the cells on both sides.
            begin = -(-first // 1) - 1
            spans.append(range(max(0, int(begin)), min(resolution[axis] - 1, int(last // 1)) + 1))
        for z in spans[2]:
            for y in spans[1]:
                for x in spans[0]:
                    lists[(z * resolution[1] + y) * resolution[0] + x].append(face)
    return lists


def touched_lists(
    vertices: F32,
    faces: npt.NDArray[np.uint32],
    planes: npt.NDArray[np.void],
    resolution: tuple[int, int, int],
    pad: float,
) -> list[list[int]]:
    """The triangles that touch each closed cell widened by ``pad``: 13 separating axes, in float64.

    Rounding is some 1e-15, where pads that tests compare differ by 1e-7.
    """
    counts = np.array(resolution)
    index = np.stack(np.meshgrid(*(np.arange(n) for n in counts), indexing="ij"), -1).reshape(-1, 3)
    half = planes["cell_size"] / 2 + pad
    centres = planes["lower"] + (index + 0.5) * planes["cell_size"]
    numbers = (index[:, 2] * counts[1] + index[:, 1]) * counts[0] + index[:, 0]
    lists: list[list[int]] = [[] for _ in range(int(counts.prod()))]
    for face, corners in enumerate(vertices[faces].astype(np.float64)):
        edges = np.roll(corners, -1, axis=0) - corners
        axes = [*np.eye(3), np.cross(edges[0], edges[1])]
        axes += [np.cross(edge, axis) for edge in edges for axis in np.eye(3)]
        touched = np.ones(len(centres), bool)
        for axis in axes:
            at, reach = (corners @ axis)[None] - (centres @ axis)[:, None], np.abs(axis) @ half
            touched &= (at.min(axis=1) <= reach) & (at.max(axis=1) >= -reach)
        for number in numbers[touched]:
            lists[number].append(face)
    return lists


def errors(rays: LocalRays, tests: Tests, vertices: F32, faces: npt.NDArray[np.uint32]) -> tuple[F64, F64]:
    """How far hits are off, in units of 2^-24: (N, F) each, 0 where there is no hit.

    The point P of the triangle with the weights that t was made of; first, the largest distance on any
    axis from P to the ray at P's depth; second, from the computed t to the t of that depth.
    """
    axes, origin, _ = _shear(rays)
    d = np.take_along_axis(rays.direction, axes, axis=1).astype(np.float64)
    corners = np.moveaxis(vertices[faces].astype(np.float64), -1, 0)
    with np.errstate(all="ignore"):
        share = tests.weights / tests.weights.sum(-1, keepdims=True)
        # One axis at a time, relative to the origin: (N, F).
        at = [((corners[axes[:, k]] - origin[:, k, None, None]) * share).sum(-1) for k in range(3)]
        t = at[2] / d[:, 2, None]
        aside = np.maximum(np.abs(at[0] - t * d[:, 0, None]), np.abs(at[1] - t * d[:, 1, None]))
        late = np.abs(tests.t.astype(np.float64) - t)
        return np.where(tests.accepted, aside, 0.0) / U, np.where(tests.accepted, late, 0.0) / U
