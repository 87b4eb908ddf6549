"""The uneven scene: small copies of a scan, scattered and in clusters over a large terrain, as binary PLY."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

Doubles = npt.NDArray[np.float64]
Points = npt.NDArray[np.float32] | Doubles
Faces = npt.NDArray[np.uint32]
Soup = tuple[Points, Faces]

SEED = 2008
_CLUSTERS = 24
# Longest side of a copy over the side of the terrain: smallest and largest.
_SIZES = (0.02, 0.2)
_FACE = np.dtype([("corners", "u1"), ("indices", "<i4", (3,))])
_CHUNK = 1 << 20


def copies_for(triangles: int, ground_triangles: int, copy_triangles: int) -> int:
    """How many copies bring the scene nearest to ``triangles``; at least one."""
    return max(1, round((triangles - ground_triangles) / copy_triangles))


def upright_unit(vertices: Points) -> Doubles:
    """Turn a y-up scan z up, its foot on the origin, its longest side 1; shape (V, 3)."""
    x, y, z = vertices.astype(np.float64).T
    turned = np.stack([x, -z, y], axis=1)
    low, high = turned.min(axis=0), turned.max(axis=0)
    foot = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    unit: Doubles = (turned - foot) / float((high - low).max())
    return unit


def placements(ground: Points, side: int, count: int) -> Doubles:
    """Foot x, y, z, size and turn of each copy, shape (count, 5): every other one belongs to a cluster."""
    random = np.random.default_rng(SEED)
    extent = float(np.ptp(ground[:, 0]))
    lattice = random.integers(0, side + 1, size=(count, 2))
    centres = random.integers(0, side + 1, size=(_CLUSTERS, 2))
    around = centres[random.integers(0, _CLUSTERS, size=count)]
    near = np.rint(around + random.normal(0.0, side / 40.0, size=(count, 2))).astype(np.int64)
    lattice[::2] = np.clip(near, 0, side)[::2]
    size = extent * np.exp(random.uniform(np.log(_SIZES[0]), np.log(_SIZES[1]), size=count))
    turn = random.uniform(0.0, 2.0 * np.pi, size=count)
    foot = ground[lattice[:, 0] * (side + 1) + lattice[:, 1]].astype(np.float64)
    # A little into the ground, so that nothing floats on a slope.
    foot[:, 2] -= 0.05 * size
    return np.column_stack([foot, size, turn])


def _copy_vertices(unit: Doubles, placed: Doubles) -> Iterator[npt.NDArray[np.float32]]:
    for x, y, z, size, turn in placed:
        c, s = size * np.cos(turn), size * np.sin(turn)
        rotation = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, size]])
        yield (unit @ rotation + (x, y, z)).astype("<f4")


def _face_records(faces: Faces, first_vertex: int) -> Iterator[npt.NDArray[Any]]:
    for start in range(0, len(faces), _CHUNK):
        chunk = faces[start : start + _CHUNK]
        records = np.empty(len(chunk), _FACE)
        records["corners"] = 3
        records["indices"] = chunk.astype(np.int64) + first_vertex
        yield records


def write_scattered(path: Path, copy: Soup, ground: Soup, *, side: int, triangles: int) -> None:
    """Write the scene to ``path``, one copy in memory at a time.

    Parameters
    ----------
    copy : (V, 3) vertices, (F, 3) faces
        The scan, y up.
    ground : (V, 3) vertices, (F, 3) faces
        Terrain over ``side`` x ``side`` squares, z up, vertices in rows of ``side + 1``.
    triangles : int
        Of the whole scene; met to within half a copy.
    """
    (vertices, faces), (land, land_faces) = copy, ground
    count = copies_for(triangles, len(land_faces), len(faces))
    unit, placed = upright_unit(vertices), placements(land, side, count)
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(land) + count * len(vertices)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        f"element face {len(land_faces) + count * len(faces)}\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    with open(path, "wb") as file:
        file.write(header.encode("ascii"))
        file.write(land.astype("<f4").tobytes())
        for moved in _copy_vertices(unit, placed):
            file.write(moved.tobytes())
        for first, part in [(0, land_faces)] + [(len(land) + k * len(vertices), faces) for k in range(count)]:
            for records in _face_records(part, first):
                file.write(records.tobytes())
