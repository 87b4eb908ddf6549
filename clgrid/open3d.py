"""Open3D's ``RaycastingScene`` on numpy arrays and a grid; Open3D itself is not needed.

``from clgrid.open3d import RaycastingScene`` in place of ``open3d.t.geometry.RaycastingScene``. Methods,
arguments, keys, dtypes and INVALID_ID are Open3D's; what differs:

- Arrays in, numpy arrays out; tensors and whatever else has a method ``numpy`` are taken as arrays. Rays,
  points and vertices may be float64, and are then not rounded; triangles may be of any integer dtype.
- On the rung ``exact``, the default, hits are those of rational arithmetic, then rounded to float32. Of
  triangles hit at the same t, the one added first is named. A ray through an edge or a vertex of a closed
  mesh crosses it once. One that touches it there, or passes through the rim of an open mesh, is answered as
  the same ray moved by an infinitesimal; of Open3D's rays, most of those hit.
- Hits of ``list_intersections`` ascend by t within a ray, and triangles that coincide are listed and counted
  one by one. Open3D lists hits as it comes upon them, and of those of a geometry that follow each other with
  the same t only the first.
- Distances and closest points are computed in float64 by libigl, the extra ``distances``, then rounded. Of
  triangles equally near, any may be named, always the same. Inside is told by exact crossings.

Source of the behaviour: Open3D 0.20, cpp/open3d/t/geometry/RaycastingScene.cpp, and its tests.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, overload

import numpy as np
import numpy.typing as npt

from clgrid.device import Device
from clgrid.errors import InputError, MeshError
from clgrid.foreign import Ids, joined, mesh_of, mesh_of_arrays, on_host
from clgrid.grid import Grid, build
from clgrid.hits import unit_normals
from clgrid.mesh import Mesh
from clgrid.pinhole import Singles, rays_of_matrices, rays_of_view

if TYPE_CHECKING:
    from clgrid.nearest import Nearest

_INVALID_ID = 0xFFFFFFFF


class RaycastingScene:
    """Triangle meshes to cast rays at, in the manner of Open3D.

    One grid over all geometries is built at the first query, and again at the first after ``add_triangles``;
    so is a tree of boxes at the first question of distance.

    Parameters
    ----------
    nthreads : int
        For Open3D's sake, here and in the queries: the device has its own number of threads.
    device, accuracy, layout, density
        As of ``clgrid.build``, which refuses bad ones at the first query. On other rungs than ``exact``, a
        ray through an edge may count, and list, both of its triangles.

    Attributes
    ----------
    INVALID_ID : int
        Id of a geometry or triangle where a ray misses: 4294967295.
    """

    INVALID_ID: ClassVar[int] = _INVALID_ID

    def __init__(
        self,
        nthreads: int = 0,
        device: Device | str | None = None,
        *,
        accuracy: str = "exact",
        layout: str = "compact",
        density: float | str = "auto",
    ) -> None:
        self._device = device
        self._accuracy, self._layout, self._density = accuracy, layout, density
        self._joined = joined([])
        self._added: list[Mesh] = []
        self._grid: Grid | None = None
        self._nearest: Nearest | None = None

    def __repr__(self) -> str:
        triangles = self._joined.triangle_count + sum(mesh.triangle_count for mesh in self._added)
        return f"RaycastingScene({self._geometry_count} geometries, {triangles:,} triangles)"

    @property
    def _geometry_count(self) -> int:
        return len(self._joined.geometry_names) + len(self._added)

    @property
    def grid(self) -> Grid:
        """The grid over all geometries; built here if there are new ones."""
        mesh = self._mesh()
        if self._grid is None:
            self._grid = build(
                mesh, self._layout, self._density, accuracy=self._accuracy, device=self._device
            )
        return self._grid

    def _mesh(self) -> Mesh:
        """All geometries as one mesh; what was built over fewer is gone."""
        if self._added:
            self._joined, self._added = joined([self._joined, *self._added]), []
            self._grid = self._nearest = None
        return self._joined

    def _tree(self) -> Nearest:
        """The tree over all geometries; built here if there are new ones."""
        from clgrid.nearest import Nearest

        mesh = self._mesh()
        if self._nearest is None:
            self._nearest = Nearest(mesh)
        return self._nearest

    def add_triangles(
        self,
        vertex_positions: Any = None,
        triangle_indices: npt.ArrayLike | None = None,
        *,
        mesh: Any = None,
    ) -> int:
        """Add a geometry; its arrays are copied.

        Parameters
        ----------
        vertex_positions : (V, 3) float32 or float64, or a mesh alone
            Scene units. A mesh is anything with ``vertex["positions"]`` and ``triangle["indices"]`` (Open3D's
            tensor mesh), or with ``vertices`` and ``faces`` or ``triangles`` (``clgrid.Mesh``,
            ``trimesh.Trimesh``, Open3D's legacy mesh).
        triangle_indices : (M, 3) integer
            Vertices of each triangle.
        mesh
            The mesh, by Open3D's name.

        Returns
        -------
        int
            The id of the geometry: 0, 1, 2...

        Raises
        ------
        MeshError
            If it is no such mesh, shapes or dtypes do not fit, a triangle names a vertex that is not there,
            or a vertex that one uses is not finite. The scene stays as it was.
        """
        number = self._geometry_count
        source = f"geometry {number}"
        if mesh is not None and (vertex_positions is not None or triangle_indices is not None):
            raise MeshError(f"{source}: given as a mesh and as arrays; give one of them")
        if triangle_indices is None:
            self._added.append(mesh_of(vertex_positions if mesh is None else mesh, source))
        else:
            self._added.append(mesh_of_arrays(vertex_positions, triangle_indices, source))
        return number

    def cast_rays(self, rays: npt.ArrayLike, nthreads: int = 0) -> dict[str, npt.NDArray[Any]]:
        """First hit of each ray.

        Parameters
        ----------
        rays : (..., 6) float32 or float64
            Origin in scene units, and direction of any length but zero.
        nthreads : int
            Not used.

        Returns
        -------
        dict
            t_hit : (...) float32
                In lengths of the direction; inf on a miss, and only there.
            geometry_ids, primitive_ids : (...) uint32
                As ``add_triangles`` returned, and the triangle of that geometry; INVALID_ID on a miss.
            primitive_uvs : (..., 2) float32
                Barycentric weights of the triangle's second and third vertex; 0 on a miss.
            primitive_normals : (..., 3) float32
                Unit normals of the triangles by their winding; 0 on a miss.

        Raises
        ------
        InputError
            If shape or dtype do not fit.
        """
        hits = self.grid.cast(on_host(rays))
        geometry_ids, primitive_ids = self._ids(hits.primitive_ids)
        return {
            "t_hit": _as_singles(hits.t_hit),
            "geometry_ids": geometry_ids,
            "primitive_ids": primitive_ids,
            "primitive_uvs": hits.primitive_uvs.astype(np.float32),
            "primitive_normals": hits.primitive_normals.astype(np.float32),
        }

    def test_occlusions(
        self, rays: npt.ArrayLike, tnear: float = 0.0, tfar: float = np.inf, nthreads: int = 0
    ) -> npt.NDArray[np.bool_]:
        """(...) bool: whether each ray meets a triangle.

        Parameters, errors
            As of ``cast_rays``.
        tnear, tfar : float
            Closed interval of the ray parameter, in lengths of the direction.
        """
        return self.grid.occluded(on_host(rays), t_min=tnear, t_max=tfar)

    def count_intersections(self, rays: npt.ArrayLike, nthreads: int = 0) -> npt.NDArray[np.int32]:
        """(...) int32: how many triangles each ray meets; parameters and errors as of ``cast_rays``."""
        return self.grid.count(on_host(rays)).astype(np.int32)

    def list_intersections(self, rays: npt.ArrayLike, nthreads: int = 0) -> dict[str, npt.NDArray[Any]]:
        """Every hit of each ray: those of ray i are ray_splits[i] to ray_splits[i + 1] - 1.

        Parameters, errors
            As of ``cast_rays``, and InputError if there are more hits than a buffer of the device holds.

        Returns
        -------
        dict
            ray_splits : (N + 1,) uint32
                Of N rays, in C order of their leading shape.
            ray_ids, geometry_ids, primitive_ids : (H,) uint32
                The ray, the geometry and its triangle.
            t_hit : (H,) float32
                In lengths of the direction; ascending within a ray, equal ones in the order of adding.
            primitive_uvs : (H, 2) float32
                As of ``cast_rays``.
        """
        every = self.grid.cast_all(on_host(rays))
        geometry_ids, primitive_ids = self._ids(every.primitive_ids)
        return {
            "ray_splits": every.ray_splits.astype(np.uint32),
            "ray_ids": every.ray_ids.astype(np.uint32),
            "geometry_ids": geometry_ids,
            "primitive_ids": primitive_ids,
            "t_hit": _as_singles(every.t_hit),
            "primitive_uvs": every.primitive_uvs.astype(np.float32),
        }

    def compute_occupancy(self, query_points: npt.ArrayLike, nthreads: int = 0, nsamples: int = 1) -> Singles:
        """(...) float32: 1 for points inside, from which a ray leaves an odd number of times, 0 for others.

        Of a scene that is not closed, as of geometries that overlap, this is that parity and no more;
        ``grid.contains`` refuses what is not closed.

        Parameters
        ----------
        query_points : (..., 3) float32 or float64
            Scene units.
        nthreads, nsamples : int
            Not used: one ray is right on the rung ``exact``. The samples must be odd, as for Open3D.

        Raises
        ------
        InputError
            If shape or dtype do not fit, or there is an even number of samples.
        """
        if nsamples < 1 or nsamples % 2 != 1:
            raise InputError(f"nsamples is {nsamples}; give an odd number, at least 1")
        return self.grid.contains(on_host(query_points), require_closed=False).astype(np.float32)

    def compute_closest_points(
        self, query_points: npt.ArrayLike, nthreads: int = 0
    ) -> dict[str, npt.NDArray[Any]]:
        """The point of the surface that is nearest to each point.

        Parameters
        ----------
        query_points : (..., 3) float32 or float64
            Scene units.
        nthreads : int
            Not used, here and below: libigl takes all cores.

        Returns
        -------
        dict
            points : (..., 3) float32
                On the surface, in scene units; NaN where there is no triangle, or for a point that is not
                finite.
            geometry_ids, primitive_ids : (...) uint32
                The triangle, as of ``cast_rays``; INVALID_ID where there is none.
            primitive_uvs : (..., 2) float32
                Barycentric weights of the triangle's second and third vertex; 0 if it has no area.
            primitive_normals : (..., 3) float32
                As of ``cast_rays``.

        Raises
        ------
        InputError
            If shape or dtype do not fit.
        UnsupportedError
            If libigl is not installed; says how to.
        """
        from clgrid.nearest import weights

        found, mesh = self._tree().of(on_host(query_points)), self._joined
        geometry_ids, primitive_ids = self._ids(found.primitive_ids)
        return {
            "points": _as_singles(found.points),
            "geometry_ids": geometry_ids,
            "primitive_ids": primitive_ids,
            "primitive_uvs": weights(mesh, found).astype(np.float32),
            "primitive_normals": unit_normals(mesh, found.primitive_ids).astype(np.float32),
        }

    def compute_distance(self, query_points: npt.ArrayLike, nthreads: int = 0) -> Singles:
        """(...) float32: distance of each point from the surface, in scene units.

        inf where there is no triangle, NaN for a point that is not finite.

        Parameters, errors
            As of ``compute_closest_points``.
        """
        return _as_singles(self._tree().of(on_host(query_points)).distances)

    def compute_signed_distance(
        self, query_points: npt.ArrayLike, nthreads: int = 0, nsamples: int = 1
    ) -> Singles:
        """(...) float32: ``compute_distance``, negative where ``compute_occupancy`` says inside.

        Parameters, errors
            As of those two.
        """
        points = on_host(query_points)
        inside = self.compute_occupancy(points, nsamples=nsamples) > 0
        distances = self.compute_distance(points)
        return np.where(inside, -distances, distances)

    @overload
    @staticmethod
    def create_rays_pinhole(
        intrinsic_matrix: npt.ArrayLike, extrinsic_matrix: npt.ArrayLike, width_px: int, height_px: int
    ) -> Singles: ...

    @overload
    @staticmethod
    def create_rays_pinhole(
        fov_deg: float,
        center: npt.ArrayLike,
        eye: npt.ArrayLike,
        up: npt.ArrayLike,
        width_px: int,
        height_px: int,
    ) -> Singles: ...

    @staticmethod
    def create_rays_pinhole(*args: Any, **kwargs: Any) -> Singles:
        """Rays through the centres of the pixels of a pinhole camera.

        Computed in float64, then rounded. Directions have length 1 along the view axis, so t_hit is depth.

        Parameters
        ----------
        intrinsic_matrix : (3, 3)
            Upper triangular, from camera coordinates to pixels; pixel centres are at halves.
        extrinsic_matrix : (4, 4)
            Rigid, from scene to camera coordinates.
        fov_deg : float
            Horizontal field of view in degrees, in the place of the matrices together with what follows.
        center, eye, up : (3,)
            What is looked at, from where, and which way is up, in scene units. As from Open3D, the picture is
            turned by 180 degrees: the first row is the lowest, the first column the rightmost. Turn it by
            ``[::-1, ::-1]``, or give -up.
        width_px, height_px : int
            Size of the picture in pixels.

        Returns
        -------
        (height_px, width_px, 6) float32

        Raises
        ------
        InputError
            If shapes do not fit, numbers are not finite, a matrix has no inverse, or the view no direction.
        """
        by_view = "fov_deg" in kwargs or (len(args) > 0 and np.ndim(on_host(args[0])) == 0)
        return rays_of_view(*args, **kwargs) if by_view else rays_of_matrices(*args, **kwargs)

    def _ids(self, triangles: npt.NDArray[np.int64]) -> tuple[Ids, Ids]:
        """Geometries, and triangles within them, of triangles of the joined mesh."""
        geometries = self._joined.geometry_ids(triangles)
        within = triangles - self._joined.geometry_starts[geometries]
        hit = triangles >= 0
        ids, own = (np.where(hit, each, _INVALID_ID).astype(np.uint32) for each in (geometries, within))
        return ids, own


def _as_singles(t: npt.NDArray[np.float64]) -> Singles:
    """Rounded to float32; only what is infinite becomes so."""
    largest = np.finfo(np.float32).max
    return np.where(np.isinf(t), t, np.clip(t, -largest, largest)).astype(np.float32)


__all__ = ["RaycastingScene"]
