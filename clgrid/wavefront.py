"""Rays as renderers cast them: of a camera, towards a light, of a small path tracer; and rays at random.

A workload is a list of batches; the next ones start where earlier ones hit. Everything is seeded: the same
scene, size and seed give the same rays, whatever the layout.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgrid.camera import Camera
from clgrid.errors import InputError
from clgrid.hits import Hits
from clgrid.mesh import Mesh

Vectors = npt.NDArray[np.float64]

NAMES = ("primary", "shadow", "diffuse", "random")
DEFAULT_BOUNCES, MOST_BOUNCES = 4, 64
DEFAULT_CHECK = 4096

_TILE = 8
_MOST_RAYS = 1 << 24
_MOST_TESTS = 4_000_000_000
# Paths leave a surface from this share of the longest side of the bounds above it: 256 roundings of
# float32, which is more than a hit point may be off, and less than the edges of scanned triangles.
_LIFT = 2.0**-16
# Seen from outside, the light stands beyond the highest corner of the bounds, by this share of their longest
# side along each axis: outside of every mesh, and on the side from which the default camera looks down.
_LIGHT = 0.5
# Seen from inside, it stands this share of the longest side from the eye, or nearer if a surface is near.
_LIGHT_INSIDE = 2.0**-4


@dataclass(frozen=True)
class Workload:
    """Which rays are cast, besides the camera and the size of the picture.

    Attributes
    ----------
    name : {"primary", "shadow", "diffuse", "random"}
        The camera's rays; one ray from each of their hits towards the light; a path tracer's: primary
        rays, ``bounces`` diffuse ones, and a shadow ray from each vertex of the path; or rays without any
        order, from a sphere around the scene to anywhere in its bounds.
    bounces : int
        Diffuse rays of a path that never leaves the scene.
    seed : int
        Of directions and samples.
    check : int
        Rays of a scene to compare with brute force, all batches together; fewer where the triangles
        are so many that this would take more than 4e9 tests.
    rays : int, optional
        Of ``random``; by default as many as the picture has pixels.

    Raises
    ------
    InputError
        If the name is unknown or a number is out of range.
    """

    name: str
    bounces: int = DEFAULT_BOUNCES
    seed: int = 0
    check: int = DEFAULT_CHECK
    rays: int | None = None

    def __post_init__(self) -> None:
        if self.name not in NAMES:
            raise InputError(f"workload is {self.name!r}; choose one of {', '.join(NAMES)}")
        if not 1 <= self.bounces <= MOST_BOUNCES:
            raise InputError(f"workload: {self.bounces} bounces; give 1 to {MOST_BOUNCES}")
        if self.seed < 0 or self.check < 0:
            raise InputError(f"workload: seed {self.seed}, check {self.check}; give none below 0")
        if self.rays is not None and not 1 <= self.rays <= _MOST_RAYS:
            raise InputError(f"workload: {self.rays} rays; give 1 to {_MOST_RAYS:,}")

    def sample_size(self, triangles: int) -> int:
        """Rays to compare with brute force, so many that it ends."""
        return min(self.check, _MOST_TESTS // max(triangles, 1))


@dataclass(frozen=True)
class Batch:
    """Rays of one kind, cast at once.

    Attributes
    ----------
    kind : str
        ``primary``, ``shadow``, ``bounce K`` or ``random``.
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


def batches(
    mesh: Mesh, view: Camera, width: int, height: int, workload: Workload, look: Look
) -> Iterator[Batch]:
    """Make a workload's rays, batch by batch; ends where no ray is left.

    Parameters
    ----------
    mesh : Mesh
    view : Camera
        From where primary rays start.
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
    if width * height > _MOST_RAYS:
        raise InputError(f"workload: size {width}x{height}; give at most {_MOST_RAYS:,} pixels")
    if workload.name == "random":
        if mesh.triangle_count:
            yield random_rays(mesh, workload.rays or width * height, workload.seed)
        return
    rays = camera_rays(view, width, height)
    if workload.name == "primary" or not mesh.triangle_count:
        yield from [rays] if workload.name != "shadow" else []
        return
    light, lift = light_position(mesh, view, look), _LIFT * _longest_side(mesh)
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


def light_position(mesh: Mesh, view: Camera, look: Look) -> Vectors:
    """(3,) float64: where the point light stands.

    For an eye outside of the bounds, beyond their highest corner by half their longest side along each axis.
    For one inside, near the eye, so that the walls do not shut the light out: towards the picture's upper
    right corner, by 1/16 of the longest side, or half way to the first surface if that is nearer.
    """
    low, high = np.asarray(mesh.bounds, np.float64)
    if (view.eye < low).any() or (view.eye > high).any():
        return np.asarray(high + _LIGHT * _longest_side(mesh), np.float64)
    step = _LIGHT_INSIDE * _longest_side(mesh) * np.sqrt(0.5) * (view.right + view.up)
    way = Batch("light", view.eye[None], step[None], t_max=2.0)
    return np.asarray(view.eye + min(2.0, float(look(way).t_hit[0])) / 2.0 * step, np.float64)


def random_rays(mesh: Mesh, count: int, seed: int) -> Batch:
    """Rays without order: from a sphere of one diagonal around the centre, through points of the bounds.

    Origins are uniform on the sphere, whose radius is the diagonal; the points, at t = 1, in the box.
    """
    random = np.random.default_rng([seed, 2])
    low, high = np.asarray(mesh.bounds, np.float64)
    centre, diagonal = low + (high - low) / 2.0, _length(high - low)
    origins = centre + diagonal * _on_sphere(random, count)
    return Batch("random", origins, low + (high - low) * random.random((count, 3)) - origins)


def _length(vector: Vectors) -> float:
    """Length, of any magnitude."""
    largest = float(np.max(np.abs(vector)))
    return largest * float(np.linalg.norm(vector / largest)) if largest > 0 else 0.0


def _on_sphere(random: np.random.Generator, count: int) -> Vectors:
    """(N, 3) float64: uniform on the unit sphere."""
    u, v = random.random((2, count))
    z, angle = 2.0 * u - 1.0, 2.0 * np.pi * v
    radius = np.sqrt(np.maximum(0.0, 1.0 - z * z))
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=-1)


def camera_rays(view: Camera, width: int, height: int) -> Batch:
    """Rays of the camera through all pixels, in tiles of 8 x 8 as a picture is rendered."""
    origins, directions = view.rays(width, height)
    order = pixel_order(width, height)
    # Real copies, so that none is made while the clock runs.
    return Batch("primary", origins.reshape(-1, 3)[order], directions.reshape(-1, 3)[order])


def pixel_order(width: int, height: int) -> npt.NDArray[np.int64]:
    """(width * height,): the pixels, numbered row by row, in the order of ``camera_rays``."""
    y, x = np.divmod(np.arange(width * height), width)
    return np.lexsort((x, y, x // _TILE, y // _TILE))


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
    return Batch(f"bounce {bounce}", points, normals + _on_sphere(random, len(points)))
