"""Scenes made by formula: no file needed, the same mesh on every machine.

Sines and cosines are taken of short float64 tables only and everything else is ``+ - * / sqrt``;
rounded to float32 at the end, the meshes do not depend on a platform's vector library.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from clgrid.errors import InputError
from clgrid.mesh import Mesh

Points = npt.NDArray[np.float64]
Faces = npt.NDArray[np.uint32]
Patch = tuple[Points, Faces]

_MAX_ICOSPHERE, _MAX_TERRAIN = 9, 8192


def cube() -> Mesh:
    """Make twelve triangles around [-1, 1]^3, wound outwards."""
    corners = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], np.float32)
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    faces = [triangle for a, b, c, d in quads for triangle in ((a, b, c), (a, c, d))]
    return Mesh(corners, np.array(faces, np.uint32), geometry_names=("cube",), source="cube")


def icosphere(level: int = 5) -> Mesh:
    """Make a closed unit sphere of ``20 * 4**level`` triangles.

    Raises
    ------
    InputError
        If ``level`` is not in 0..9.
    """
    _check_range("icosphere", level, 0, _MAX_ICOSPHERE)
    points, faces = _icosphere(level)
    return Mesh(points.astype(np.float32), faces, geometry_names=("icosphere",), source=f"icosphere:{level}")


def terrain(side: int = 512) -> Mesh:
    """Make hills over ``side`` by ``side`` squares of two triangles each, z up.

    Raises
    ------
    InputError
        If ``side`` is not in 1..8192.
    """
    _check_range("terrain", side, 1, _MAX_TERRAIN)
    x, y, height, faces = _hills(side, extent=10.0)
    points = np.stack(np.broadcast_arrays(x[:, None], y[None, :], height), -1).reshape(-1, 3)
    return Mesh(points.astype(np.float32), faces, geometry_names=("terrain",), source=f"terrain:{side}")


def demo() -> Mesh:
    """Make about a million triangles: a ribbed torus knot and eleven studded balls above hills, y up."""
    x, z, height, ground_faces = _hills(460, extent=4.6)
    height *= 0.35
    ground = np.stack(np.broadcast_arrays(x[:, None], height, -z[None, :]), -1).reshape(-1, 3)
    knot_points, knot_faces = _torus_knot(turns=1800, around=104)
    ball_points, ball_faces = _studded_ball()
    patches: list[Patch] = [(ground, ground_faces), (knot_points + np.array([0.0, 3.3, 0.0]), knot_faces)]
    angle = np.arange(11) * (2.0 * np.pi / 11)
    for k, (c, s) in enumerate(zip(np.cos(angle), np.sin(angle), strict=True)):
        radius = 0.32 + 0.1 * (k % 3)
        column = int(np.searchsorted(x, 3.7 * c)), int(np.searchsorted(z, -3.7 * s))
        rest = height[column] + 0.8 * radius
        patches.append((ball_points * radius + np.array([3.7 * c, rest, 3.7 * s]), ball_faces))
    names = ("ground", "knot", *(f"ball{k}" for k in range(11)))
    return _join(patches, names, "demo")


SCENES: dict[str, Callable[..., Mesh]] = {
    "demo": demo,
    "cube": cube,
    "icosphere": icosphere,
    "terrain": terrain,
}


def is_name(name: str) -> bool:
    """Tell whether ``name`` is a built-in scene, with or without its ``:N``."""
    return name.split(":", 1)[0] in SCENES


def make(name: str) -> Mesh:
    """Make the built-in scene ``demo``, ``cube``, ``icosphere[:N]`` or ``terrain[:N]``.

    Raises
    ------
    InputError
        If the name is unknown, or ``N`` is no integer in its range.
    """
    base, _, number = name.partition(":")
    if base not in SCENES:
        raise InputError(f"scene {name!r}: not built in; choose one of {', '.join(SCENES)}")
    if not number:
        return SCENES[base]()
    if base in ("demo", "cube") or not number.isascii() or not number.isdigit():
        raise InputError(f"scene {name!r}: give icosphere:N or terrain:N with an integer N")
    return SCENES[base](int(number))


def _check_range(name: str, value: int, low: int, high: int) -> None:
    if not low <= value <= high:
        raise InputError(f"scene {name}:{value}: out of range, give {name}:N with N in {low}..{high}")


def _join(patches: list[Patch], names: tuple[str, ...], source: str) -> Mesh:
    """Make one mesh of several patches, each a geometry of its own."""
    first_vertex = np.cumsum([0] + [len(points) for points, _ in patches])
    starts = np.cumsum([0] + [len(faces) for _, faces in patches]).astype(np.int64)
    return Mesh(
        np.concatenate([points for points, _ in patches]).astype(np.float32),
        np.concatenate(
            [faces + np.uint32(first) for (_, faces), first in zip(patches, first_vertex, strict=False)]
        ),
        geometry_starts=starts,
        geometry_names=names,
        source=source,
    )


def _lattice(rows: int, columns: int, *, closed: bool) -> Faces:
    """Make two triangles for each square of a rows x columns vertex lattice, joined at its ends if closed."""
    r = np.arange(rows if closed else rows - 1, dtype=np.uint32)[:, None]
    c = np.arange(columns if closed else columns - 1, dtype=np.uint32)[None, :]
    r1, c1 = (r + 1) % np.uint32(rows), (c + 1) % np.uint32(columns)
    n = np.uint32(columns)
    a, b, d, e = r * n + c, r1 * n + c, r1 * n + c1, r * n + c1
    return np.stack([a, b, d, a, d, e], -1).reshape(-1, 3).astype(np.uint32)


def _hills(side: int, extent: float) -> tuple[Points, Points, Points, Faces]:
    """Make axes, heights and faces of a square patch of hills; waves of falling height and length."""
    axis = np.linspace(-extent, extent, side + 1)
    height = np.zeros((side + 1, side + 1))
    # Directions and phases of the waves: multiples of the golden angle, so that none repeats.
    for k in range(14):
        turn = 2.399963229728653 * k
        frequency = 0.45 * 1.31**k
        along, across = frequency * np.cos(turn) * axis + turn, frequency * np.sin(turn) * axis
        wave = np.outer(np.sin(along), np.cos(across)) + np.outer(np.cos(along), np.sin(across))
        height += (0.75 / 1.55**k) * wave
    return axis, axis, height, _lattice(side + 1, side + 1, closed=False)


def _torus_knot(turns: int, around: int) -> Patch:
    """Make an upright tube along the (2, 3) torus knot, ribbed in both directions."""
    a = np.arange(turns) * (2.0 * np.pi / turns)
    c2, s2, c3, s3 = np.cos(2 * a), np.sin(2 * a), np.cos(3 * a), np.sin(3 * a)
    ring = 1.9 + 0.85 * c3
    centre = np.stack([ring * c2, ring * s2, -0.95 * s3], -1)
    d_ring = -2.55 * s3
    tangent = np.stack([d_ring * c2 - 2 * ring * s2, d_ring * s2 + 2 * ring * c2, -2.85 * c3], -1)
    outward = np.stack([c3 * c2, c3 * s2, -s3], -1)
    binormal = np.cross(tangent, outward)
    binormal /= np.sqrt((binormal * binormal).sum(1, keepdims=True))
    normal = np.cross(binormal, tangent)
    normal /= np.sqrt((normal * normal).sum(1, keepdims=True))
    b = np.arange(around) * (2.0 * np.pi / around)
    # Ribs that wind around the tube: cos(8 b + 30 a) and rings cos(90 a), from 1-D tables.
    wind = np.outer(np.cos(30 * a), np.cos(8 * b)) - np.outer(np.sin(30 * a), np.sin(8 * b))
    radius = 0.40 + 0.035 * wind + 0.012 * np.cos(90 * a)[:, None]
    points = centre[:, None] + radius[..., None] * (
        np.cos(b)[None, :, None] * normal[:, None] + np.sin(b)[None, :, None] * binormal[:, None]
    )
    return points.reshape(-1, 3), _lattice(turns, around, closed=True)[:, ::-1]


def _studded_ball() -> Patch:
    """Make a unit ball of 20,480 triangles with a stud towards each corner of a coarser ball."""
    points, faces = _icosphere(5)
    studs, _ = _icosphere(1)
    nearness = np.max(points @ studs.T, axis=1)
    bump = np.clip((nearness - 0.975) / 0.02, 0.0, 1.0)
    return points * (1.0 + 0.12 * (bump * bump * (3.0 - 2.0 * bump)))[:, None], faces


def _icosphere(level: int) -> Patch:
    """Split each triangle of an icosahedron in four ``level`` times, pushed out to the unit sphere."""
    g = (1.0 + np.sqrt(5.0)) / 2.0
    points = np.array(
        [
            *[[-1, g, 0], [1, g, 0], [-1, -g, 0], [1, -g, 0], [0, -1, g], [0, 1, g]],
            *[[0, -1, -g], [0, 1, -g], [g, 0, -1], [g, 0, 1], [-g, 0, -1], [-g, 0, 1]],
        ]
    )
    faces = np.array(
        [
            *[[0, 11, 5], [0, 5, 1], [0, 1, 7], [0, 7, 10], [0, 10, 11]],
            *[[1, 5, 9], [5, 11, 4], [11, 10, 2], [10, 7, 6], [7, 1, 8]],
            *[[3, 9, 4], [3, 4, 2], [3, 2, 6], [3, 6, 8], [3, 8, 9]],
            *[[4, 9, 5], [2, 4, 11], [6, 2, 10], [8, 6, 7], [9, 8, 1]],
        ],
        np.uint32,
    )
    for _ in range(level):
        points, faces = _split(points, faces)
    return points / np.sqrt((points * points).sum(1, keepdims=True)), faces


def _split(points: Points, faces: Faces) -> Patch:
    """Split each triangle in four; the middle of an edge is one vertex for both its triangles."""
    ends = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1).astype(np.uint64)
    keys, middle = np.unique(ends[:, 0] << np.uint64(32) | ends[:, 1], return_inverse=True)
    low, high = (keys >> np.uint64(32)).astype(np.int64), (keys & np.uint64(0xFFFFFFFF)).astype(np.int64)
    ab, bc, ca = (middle.reshape(-1, 3) + len(points)).astype(np.uint32).T
    a, b, c = faces.T
    split = np.stack([a, ab, ca, b, bc, ab, c, ca, bc, ab, bc, ca], -1).reshape(-1, 3)
    return np.concatenate([points, 0.5 * (points[low] + points[high])]), split
