"""Rays as renderers cast them: of a camera, towards a light, and of a small path tracer.

A workload is a list of batches; the next ones start where earlier ones hit. Everything is seeded: the same
scene, size and seed give the same rays, whatever the layout.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgrid.cast import Hits
from clgrid.errors import InputError
from clgrid.mesh import Mesh
from clgrid.scene import Scene, default_camera

Vectors = npt.NDArray[np.float64]

NAMES = ("primary", "shadow", "diffuse")
DEFAULT_BOUNCES, MOST_BOUNCES = 4, 64
DEFAULT_CHECK = 4096

_TILE = 8
_MOST_PIXELS = 1 << 24
_MOST_TESTS = 4_000_000_000
# Paths leave a surface from this share of the longest side of the bounds above it: 256 roundings of
# float32, which is more than a hit point may be off, and less than the edges of scanned triangles.
_LIFT = 2.0**-16
# The light stands beyond the highest corner of the bounds, by this share of their longest side along
# each axis: outside of every mesh, and on the side from which the default camera looks down.
_LIGHT = 0.5


@dataclass(frozen=True)
class Workload:
    """Which rays are cast, besides the size of the picture.

    Attributes
    ----------
    name : {"primary", "shadow", "diffuse"}
        The camera's rays; one ray from each of their hits towards the light; or a path tracer's: primary
        rays, ``bounces`` diffuse ones, and a shadow ray from each vertex of the path.
    bounces : int
        Diffuse rays of a path that never leaves the scene.
    seed : int
        Of directions and samples.
    check : int
        Rays of a scene to compare with brute force, all batches together; fewer where the triangles
        are so many that this would take more than 4e9 tests.

    Raises
    ------
    InputError
        If the name is unknown or a number is out of range.
    """

    name: str
    bounces: int = DEFAULT_BOUNCES
    seed: int = 0
    check: int = DEFAULT_CHECK

    def __post_init__(self) -> None:
        if self.name not in NAMES:
            raise InputError(f"workload is {self.name!r}; choose one of {', '.join(NAMES)}")
        if not 1 <= self.bounces <= MOST_BOUNCES:
            raise InputError(f"workload: {self.bounces} bounces; give 1 to {MOST_BOUNCES}")
        if self.seed < 0 or self.check < 0:
            raise InputError(f"workload: seed {self.seed}, check {self.check}; give none below 0")

    def sample_size(self, triangles: int) -> int:
        """Rays to compare with brute force, so many that it ends."""
        return min(self.check, _MOST_TESTS // max(triangles, 1))


@dataclass(frozen=True)
class Batch:
    """Rays of one kind, cast at once.

    Attributes
    ----------
    kind : str
        ``primary``, ``shadow`` or ``bounce K``.
    origins, directions : (N, 3) float64
        Scene units; directions of any length.
    t_max : float
        For all of them.
    """

    kind: str
    origins: Vectors
    directions: Vectors
    t_max: float = np.inf


Look = Callable[[Batch], Hits]


def batches(scene: Scene | Mesh, width: int, height: int, workload: Workload, look: Look) -> Iterator[Batch]:
    """Make a workload's rays, batch by batch; ends where no ray is left.

    Parameters
    ----------
    scene : Scene or Mesh
        Seen from its default camera.
    width, height : int
        Pixels: one primary ray each.
    workload : Workload
        Which rays.
    look : callable
        Casts a batch, for the hits from which the next ones start.

    Raises
    ------
    InputError
        If there are too many pixels.
    """
    if width * height > _MOST_PIXELS:
        raise InputError(f"workload: size {width}x{height}; give at most {_MOST_PIXELS:,} pixels")
    mesh = scene.mesh if isinstance(scene, Scene) else scene
    rays = camera_rays(scene, width, height)
    if workload.name == "primary" or not mesh.triangle_count:
        yield from [rays] if workload.name != "shadow" else []
        return
    light, lift = light_position(mesh), _LIFT * _longest_side(mesh)
    if workload.name == "shadow":
        points, _ = leave(rays, look(rays), lift)
        yield from _not_empty(shadow_rays(points, light))
        return
    random = np.random.default_rng([workload.seed, 0])
    yield rays
    for bounce in range(1, workload.bounces + 1):
        points, normals = leave(rays, look(rays), lift)
        yield from _not_empty(shadow_rays(points, light))
        rays = diffuse_rays(points, normals, random, bounce)
        yield from _not_empty(rays)
    yield from _not_empty(shadow_rays(leave(rays, look(rays), lift)[0], light))


def _not_empty(batch: Batch) -> list[Batch]:
    return [batch] if len(batch.origins) else []


def _longest_side(mesh: Mesh) -> float:
    return float(np.max(mesh.bounds[1] - mesh.bounds[0]))


def light_position(mesh: Mesh) -> Vectors:
    """(3,) float64: the point light, beyond the highest corner by half the longest side on each axis."""
    return np.asarray(mesh.bounds[1] + _LIGHT * _longest_side(mesh), np.float64)


def camera_rays(scene: Scene | Mesh, width: int, height: int) -> Batch:
    """Rays of the default camera through all pixels, in tiles of 8 x 8 as a picture is rendered."""
    origins, directions = default_camera(scene, width / height).rays(width, height)
    y, x = np.divmod(np.arange(width * height), width)
    order = np.lexsort((x, y, x // _TILE, y // _TILE))
    # Real copies, so that none is made while the clock runs.
    return Batch("primary", origins.reshape(-1, 3)[order], directions.reshape(-1, 3)[order])


def leave(rays: Batch, hits: Hits, lift: float) -> tuple[Vectors, Vectors]:
    """Where paths go on: for each ray that hit, a point just off the surface on the side it came from.

    Parameters
    ----------
    lift : float
        Height above the surface, scene units.

    Returns
    -------
    points, normals : (H, 3) float64
        In the order of the rays; unit normals against the rays.
    """
    hit = hits.mask
    normals = hits.primitive_normals[hit]
    along = np.einsum("ij,ij->i", normals, rays.directions[hit])
    normals[along > 0] *= -1.0
    return hits.points[hit] + lift * normals, normals


def shadow_rays(points: Vectors, light: Vectors) -> Batch:
    """Rays from the points that end at the light: it is at t = 1."""
    return Batch("shadow", points, light - points, t_max=1.0)


def diffuse_rays(points: Vectors, normals: Vectors, random: np.random.Generator, bounce: int) -> Batch:
    """Rays with directions spread as the cosine to the normal.

    The sum of the normal and a point of the unit sphere has that density, without a frame on the surface.
    """
    u, v = random.random((2, len(points)))
    z, angle = 2.0 * u - 1.0, 2.0 * np.pi * v
    radius = np.sqrt(np.maximum(0.0, 1.0 - z * z))
    sphere = np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=-1)
    return Batch(f"bounce {bounce}", points, normals + sphere)
