"""A drop-in for the ray queries of trimesh: ``mesh.ray = clgrid.trimesh.RayMeshIntersector(mesh)``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, NamedTuple, overload

import numpy as np
import numpy.typing as npt

from clgrid.device import Device
from clgrid.errors import InputError
from clgrid.grid import Grid, build
from clgrid.mesh import Mesh
from clgrid.places import first_of_place
from clgrid.queries import PARITY_DIRECTION
from clgrid.ray_rows import RayRows, ray_rows, rows
from clgrid.rungs import LOSSLESS

if TYPE_CHECKING:
    from trimesh import Trimesh

Ids = npt.NDArray[np.int64]
Points = npt.NDArray[np.float64]

# Lines by which points are told inside an open mesh; the second where halves of the first disagree.
_OPEN_DIRECTIONS = (np.array(PARITY_DIRECTION), np.array([-0.33195958, 0.76822128, 0.54741135]))


class RayMeshIntersector:
    """Ray queries of a ``trimesh.Trimesh``, with the methods of trimesh's own intersectors.

    The grid is built at the first query, and again at the first after the mesh has changed; where only
    vertices moved, in place.

    A ray that meets an edge or a vertex meets it once, in the triangle of least t, then least index; so it is
    with triangles in one place. On the accuracy ``exact``, hits are crossings instead: triangles that share
    an edge or a vertex agree on which of them is crossed, a ray that grazes a closed mesh there crosses it
    twice or not at all, and of triangles in one place each is crossed. Triangles seen edge-on and triangles
    without area are never hit. A ray that starts on a triangle hits it, at its origin.

    Parameters
    ----------
    mesh : trimesh.Trimesh
    scale_to_box : bool
        For trimesh's sake; grids need no scaling, so it changes nothing.
    accuracy : {"precise", "exact", "robust"}
        A rung of the accuracy ladder: "precise" takes vertices in float64, as they are, "robust" in float32.
        Whatever is named here, points are told inside on "exact", with a grid for that alone.
    layout, density, device
        As of ``clgrid.build``.
    geometry : trimesh.Trimesh
        Another name of ``mesh``, as trimesh's Embree has it.

    Raises
    ------
    InputError
        If there is no mesh, the accuracy is none of these, or at the first query, another option is unknown.
    MeshError
        At queries: if a vertex in use is not finite, or a triangle names a missing vertex.
    DeviceError
        At the first query, if there is no usable device.
    """

    def __init__(
        self,
        mesh: Trimesh | None = None,
        scale_to_box: bool = True,
        *,
        accuracy: str = "precise",
        layout: str = "compact",
        density: float | str = "auto",
        device: Device | str | None = None,
        geometry: Trimesh | None = None,
    ) -> None:
        if (mesh is None) == (geometry is None):
            raise InputError("RayMeshIntersector: give one trimesh.Trimesh")
        if accuracy not in LOSSLESS:
            raise InputError(f"accuracy is {accuracy!r}; choose one of {', '.join(LOSSLESS)}")
        self.mesh = geometry if mesh is None else mesh
        self._scale_to_box = scale_to_box
        self._accuracy = accuracy
        self._options: dict[str, Any] = {"layout": layout, "density": density, "device": device}
        self._grids: dict[str, _Standing] = {}

    def intersects_any(
        self, ray_origins: npt.ArrayLike, ray_directions: npt.ArrayLike
    ) -> npt.NDArray[np.bool_]:
        """Whether each ray hits the mesh.

        Parameters
        ----------
        ray_origins, ray_directions : (n, 3) float
            In units of the mesh; directions of any length but zero. A ray with NaN, infinite values or no
            direction hits nothing.

        Returns
        -------
        (n,) bool

        Raises
        ------
        InputError
            If they are not numbers of that shape. It is a ValueError too.
        """
        return self.grid.occluded(*ray_rows(ray_origins, ray_directions))

    def intersects_first(self, ray_origins: npt.ArrayLike, ray_directions: npt.ArrayLike) -> Ids:
        """The nearest triangle of each ray.

        Parameters, errors
            As of ``intersects_any``.

        Returns
        -------
        (n,) int64
            Indexes of mesh.faces, -1 where nothing is hit.
        """
        return self.grid.cast(*ray_rows(ray_origins, ray_directions), fields=()).primitive_ids

    @overload
    def intersects_id(
        self,
        ray_origins: npt.ArrayLike,
        ray_directions: npt.ArrayLike,
        multiple_hits: bool = True,
        max_hits: int | None = 100,
        return_locations: Literal[False] = False,
    ) -> tuple[Ids, Ids]: ...

    @overload
    def intersects_id(
        self,
        ray_origins: npt.ArrayLike,
        ray_directions: npt.ArrayLike,
        multiple_hits: bool = True,
        max_hits: int | None = 100,
        *,
        return_locations: Literal[True],
    ) -> tuple[Ids, Ids, Points]: ...

    @overload
    def intersects_id(
        self,
        ray_origins: npt.ArrayLike,
        ray_directions: npt.ArrayLike,
        multiple_hits: bool = True,
        max_hits: int | None = 100,
        return_locations: bool = False,
    ) -> tuple[Ids, Ids] | tuple[Ids, Ids, Points]: ...

    def intersects_id(
        self,
        ray_origins: npt.ArrayLike,
        ray_directions: npt.ArrayLike,
        multiple_hits: bool = True,
        max_hits: int | None = 100,
        return_locations: bool = False,
    ) -> tuple[Ids, Ids] | tuple[Ids, Ids, Points]:
        """The triangles that rays hit: the nearest of every ray, then the second of every ray, and so on.

        Parameters
        ----------
        ray_origins, ray_directions
            As of ``intersects_any``.
        multiple_hits : bool
            Whether to find all hits of a ray, or the nearest.
        max_hits : int or None
            So many of each ray at most, the nearest; None for all.
        return_locations : bool
            Whether to say where they are hit.

        Returns
        -------
        index_tri : (m,) int64
            Indexes of mesh.faces.
        index_ray : (m,) int64
            Indexes of rays; ascending among the nearest, the second and so on.
        locations : (m, 3) float64
            In units of the mesh, origin + t * direction; only if ``return_locations``.

        Raises
        ------
        InputError
            As ``intersects_any``; if ``max_hits`` is negative; or if there are more hits than a buffer of the
            device holds.
        """
        rays = ray_rows(ray_origins, ray_directions)
        if max_hits is not None and max_hits < 0:
            raise InputError(f"max_hits is {max_hits}; give at least 0, or None for all")
        found = self._all(rays, max_hits) if multiple_hits else self._nearest(rays, max_hits)
        if not return_locations:
            return found.triangles, found.rays
        return found.triangles, found.rays, found.points_on(*rays)

    def intersects_location(
        self,
        ray_origins: npt.ArrayLike,
        ray_directions: npt.ArrayLike,
        multiple_hits: bool = True,
        max_hits: int | None = 100,
    ) -> tuple[Points, Ids, Ids]:
        """Where rays hit the mesh, in the order of ``intersects_id``.

        Parameters, errors
            As of ``intersects_id``.

        Returns
        -------
        locations : (m, 3) float64
            In units of the mesh.
        index_ray : (m,) int64
            Indexes of rays.
        index_tri : (m,) int64
            Indexes of mesh.faces.
        """
        triangles, rays, points = self.intersects_id(
            ray_origins, ray_directions, multiple_hits, max_hits, return_locations=True
        )
        return points, rays, triangles

    def contains_points(self, points: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        """Whether the mesh contains points: exact for a closed mesh.

        A point of the surface counts as the point beside it, an infinitesimal farther along x (then y, z). An
        open mesh has no inside; a point then is inside where both halves of a line cross the mesh an odd
        number of times. Where one is odd, it is outside if the other crosses nothing, and else a second line
        is asked. The answer is the same in every run.

        Parameters
        ----------
        points : (n, 3) float
            In units of the mesh. One that is not finite is not inside.

        Returns
        -------
        (n,) bool

        Raises
        ------
        InputError
            If they are not numbers of that shape. It is a ValueError too.
        """
        grid, checked = self._grid("exact"), rows("points", points)
        if grid.empty or not grid.open_edges:
            return grid.contains(checked)
        return _within_open(grid, checked)

    @property
    def grid(self) -> Grid:
        """The grid over the mesh as it is now, built or updated if it has changed."""
        return self._grid(self._accuracy)

    def _grid(self, accuracy: str) -> Grid:
        """The grid of a rung over the mesh as it is now."""
        now = self.mesh.__hash__()
        held = self._grids.get(accuracy)
        if held is not None and held.content == now:
            return held.grid
        # Taken away first: no grid of another shape is left behind if this one is refused.
        self._grids.pop(accuracy, None)
        grid = _rebuilt(held.grid if held else None, Mesh.from_trimesh(self.mesh), accuracy, self._options)
        self._grids[accuracy] = _Standing(now, grid)
        return grid

    def _all(self, rays: RayRows, most: int | None) -> _Found:
        """All hits of each ray, those in one place once; the nearest of each first."""
        merging = self._accuracy != "exact"  # whose triangles agree which of them is crossed
        grid = self.grid
        every = grid.cast_all(*rays, fields=("t_err",) if merging else ())
        kept = (
            first_of_place(every, grid.mesh, rays.directions)
            if merging
            else np.ones(len(every.t_hit), np.bool_)
        )
        of_ray = every.ray_ids[kept]
        starts = np.searchsorted(of_ray, np.arange(len(every.ray_splits) - 1))
        depth = np.arange(len(of_ray)) - starts[of_ray]
        order = np.argsort(depth, kind="stable")
        if most is not None:
            order = order[: int(np.count_nonzero(depth < most))]
        return _Found(every.primitive_ids[kept][order], of_ray[order], every.t_hit[kept][order])

    def _nearest(self, rays: RayRows, most: int | None) -> _Found:
        hits = self.grid.cast(*rays, fields=())
        of_ray = np.flatnonzero(hits.mask)[: 0 if most == 0 else None]
        return _Found(hits.primitive_ids[of_ray], of_ray, hits.t_hit[of_ray])

    def __getstate__(self) -> dict[str, Any]:
        device = self._options["device"]
        label = device.description.label if isinstance(device, Device) else device
        return {**self.__dict__, "_grids": {}, "_options": {**self._options, "device": label}}

    def __copy__(self) -> RayMeshIntersector:
        return RayMeshIntersector(self.mesh, self._scale_to_box, accuracy=self._accuracy, **self._options)

    def __deepcopy__(self, memo: dict[int, Any]) -> RayMeshIntersector:
        return self.__copy__()


class _Standing(NamedTuple):
    """A grid, and trimesh's hash of the mesh that it was built over."""

    content: int
    grid: Grid


class _Found(NamedTuple):
    """Hits: triangle, ray and t of each."""

    triangles: Ids
    rays: Ids
    t: Points

    def points_on(self, origins: npt.NDArray[Any], directions: npt.NDArray[Any]) -> Points:
        """(m, 3) float64: where the hits are."""
        along = self.t[:, None] * directions[self.rays].astype(np.float64)
        points: Points = origins[self.rays] + along
        return points


def _rebuilt(grid: Grid | None, mesh: Mesh, accuracy: str, options: dict[str, Any]) -> Grid:
    """A grid over the mesh: the one given, updated, where only vertices moved."""
    if grid is not None and not grid.empty and _same_triangles(grid.mesh, mesh):
        grid.update(mesh.vertices)
        return grid
    return build(mesh, accuracy=accuracy, **options)


def _same_triangles(one: Mesh, other: Mesh) -> bool:
    return one.vertices.shape == other.vertices.shape and np.array_equal(one.faces, other.faces)


def _within_open(grid: Grid, points: npt.NDArray[Any]) -> npt.NDArray[np.bool_]:
    """(n,) bool: what both halves of a line through each point agree on."""
    within = np.zeros(len(points), np.bool_)
    low, high = grid.mesh.bounds
    unsure = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))
    for direction in _OPEN_DIRECTIONS:
        ahead, behind = (grid.count(points[unsure], way) for way in (direction, -direction))
        agreed = ahead % 2 == behind % 2
        within[unsure[agreed]] = ahead[agreed] % 2 == 1
        unsure = unsure[~agreed & (ahead > 0) & (behind > 0)]
    return within


__all__ = ["RayMeshIntersector"]
