"""Triangles as arrays: what every stage below works on."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from clgrid.errors import MeshError
from clgrid.outermost import FloatArray, Outermost, extent, outermost
from clgrid.shown import Facts, Shown, counted
from clgrid.units import bytes_text

if TYPE_CHECKING:
    import trimesh

MAX_COUNT = 2**32 - 2
"""Most triangles or vertices a mesh may have: 0xffffffff is kept free as "none" in 32-bit indices."""


@dataclass(frozen=True, repr=False)
class Mesh(Shown):
    """A triangle mesh: the arrays, and nothing that a ray does not need.

    Attributes
    ----------
    vertices : (V, 3) float32 or float64
        Positions in scene units, finite wherever a triangle uses them. Doubles are kept where the source
        has them.
    faces : (F, 3) uint32
        Vertex indices of each triangle, each below ``V``. ``F`` may be 0.
    vertex_normals : (V, 3) float32 or None
        Shading normals, where the file has them; not necessarily of unit length. A zero row means that this
        vertex has none: shade it with the normal of the triangle.
    geometry_starts : (G + 1,) int64
        Triangle ``f`` belongs to geometry ``g`` with
        ``geometry_starts[g] <= f < geometry_starts[g + 1]``.
    geometry_names : tuple of str
        One name a geometry, possibly empty.
    source : str
        Where the mesh came from, for messages and records.
    warnings : tuple of str
        What the loader changed or left out, one line each.

    Raises
    ------
    MeshError
        On creation, if `validate` refuses the arrays.
    """

    vertices: FloatArray
    faces: npt.NDArray[np.uint32]
    vertex_normals: npt.NDArray[np.float32] | None = None
    geometry_starts: npt.NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    geometry_names: tuple[str, ...] = ()
    source: str = "<arrays>"
    warnings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.geometry_starts.size == 0:
            object.__setattr__(self, "geometry_starts", np.array([0, len(self.faces)], np.int64))
            object.__setattr__(self, "geometry_names", self.geometry_names or ("",))
        validate(self)

    @classmethod
    def from_arrays(cls, vertices: npt.ArrayLike, faces: npt.ArrayLike, source: str = "<arrays>") -> Mesh:
        """A mesh of whatever numpy takes for arrays: lists, integers of any size, strided ones; copied.

        Parameters
        ----------
        vertices : (V, 3) real
            Scene units; float32 stays that, all else becomes float64.
        faces : (F, 3) integer
            Vertices of each triangle.
        source : str
            What messages call it.

        Raises
        ------
        MeshError
            If shapes or dtypes do not fit, a triangle names a missing vertex, or a vertex in use is not
            finite.
        """
        from clgrid.foreign import mesh_of_arrays

        return mesh_of_arrays(vertices, faces, source)

    @classmethod
    def from_trimesh(cls, source: trimesh.Trimesh | trimesh.Scene) -> Mesh:
        """The triangles of a trimesh.Trimesh or trimesh.Scene, in their order; a copy, without normals.

        Parameters
        ----------
        source : trimesh.Trimesh or trimesh.Scene
            Of a scene, each node that shows triangles becomes a geometry of the node's name, moved to where
            the node has it. Triangles of mirroring nodes are turned, so that normals stay outside.

        Returns
        -------
        Mesh
            With vertices in float64.

        Raises
        ------
        MeshError
            If it is neither, a triangle names a missing vertex, or a vertex in use is not finite.
        """
        from clgrid.foreign import of_trimesh

        return of_trimesh(source)

    def _headline(self) -> str:
        counts = f"{counted(self.triangle_count, 'triangle')}, {len(self.vertices):,} vertices"
        return f"{self.source}: {counts}"

    def _facts(self) -> Facts:
        names = ", ".join(self.geometry_names[:_NAMES_SHOWN])
        more = ", ..." if len(self.geometry_names) > _NAMES_SHOWN else ""
        facts = {
            "vertices": str(self.vertices.dtype),
            "vertex normals": "no" if self.vertex_normals is None else "yes",
            "geometries": f"{len(self.geometry_names):,}" + (f": {names}{more}" if names else ""),
            "bytes": bytes_text(self.nbytes),
        }
        if self.triangle_count:
            facts |= {"lowest corner": _row_text(self.bounds[0]), "highest corner": _row_text(self.bounds[1])}
        return {**facts, **({"warnings": "; ".join(self.warnings)} if self.warnings else {})}

    @property
    def triangle_count(self) -> int:
        """Number of triangles, degenerate ones included."""
        return len(self.faces)

    @property
    def nbytes(self) -> int:
        """Bytes of all arrays."""
        normals = 0 if self.vertex_normals is None else self.vertex_normals.nbytes
        return self.vertices.nbytes + self.faces.nbytes + self.geometry_starts.nbytes + normals

    @cached_property
    def bounds(self) -> npt.NDArray[np.float64]:
        """(2, 3) float64, read-only: lowest and highest corner of the vertices that a triangle uses.

        Computed once: the arrays of a mesh are not to be changed.

        Raises
        ------
        MeshError
            If the mesh has no triangle.
        """
        if not self.triangle_count:
            raise MeshError(
                f"{self.source}: no triangles, so no bounds; give a mesh with at least one triangle"
            )
        bounds = self._bounds_in_use().astype(np.float64)
        bounds.setflags(write=False)
        return bounds

    @cached_property
    def _outermost(self) -> Outermost:
        """Of all vertices, which are at least one, whether a triangle uses them or not."""
        return outermost(self.vertices)

    def _bounds_in_use(self) -> FloatArray:
        points, found, known = self.vertices, self._outermost, set[int]()
        for _ in range(_FEW_STRAYS):
            places = {place for side in found.places for place in side} - known
            strays = [place for place in places if not self._names(place)]
            if not strays:
                return found.bounds
            # A copy with others in their place takes a fifth of a selection's time.
            points = self.vertices.copy() if points is self.vertices else points
            points[strays] = self.vertices[self.faces[0, 0]]
            known |= places
            found = outermost(points)
        points[~used_vertices(self)] = self.vertices[self.faces[0, 0]]
        return extent(points)

    def _names(self, vertex: int) -> bool:
        """Whether a triangle uses the vertex: looked for first where one order of both would have it."""
        middle = vertex * len(self.faces) // len(self.vertices)
        return any(
            (self.faces[max(0, middle - width) : middle + width] == vertex).any()
            for width in (_FEW, _MANY, len(self.faces))
        )

    def moved(self, vertices: FloatArray) -> Mesh:
        """The mesh with other positions, and without its vertex normals, which were of the old shape.

        Parameters
        ----------
        vertices : (V, 3) float32 or float64
            One a vertex, scene units.

        Raises
        ------
        MeshError
            If the shape or dtype is another, or a position that a triangle uses is not finite.
        """
        if np.shape(vertices) != self.vertices.shape:
            raise MeshError(
                f"{self.source}: moved vertices have shape {np.shape(vertices)}; give {self.vertices.shape}"
            )
        # Not by replace: faces and geometries need no second look.
        other = object.__new__(Mesh)
        other.__dict__.update({each.name: getattr(self, each.name) for each in fields(self)})
        other.__dict__.update(vertices=vertices, vertex_normals=None)
        _validate_layout(other)
        _validate_finite(other)
        return other

    def geometry_ids(self, primitive_ids: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
        """Geometry of each triangle id; -1 stays -1.

        Parameters
        ----------
        primitive_ids : (...) int64
            Triangle ids, -1 for a miss.

        Returns
        -------
        (...) int64
            Index into `geometry_names`, or -1.
        """
        found = np.searchsorted(self.geometry_starts, primitive_ids, side="right") - 1
        return np.where(primitive_ids < 0, -1, found).astype(np.int64)


_NAMES_SHOWN = 5
# So often vertices of no triangle are looked past: of those that scans have, few are outermost.
_FEW_STRAYS = 4
_FEW, _MANY = 1 << 10, 1 << 14  # triangles to each side


def used_vertices(mesh: Mesh) -> npt.NDArray[np.bool_]:
    """(V,) bool: whether any triangle uses the vertex."""
    used = np.zeros(len(mesh.vertices), np.bool_)
    used[mesh.faces.reshape(-1).astype(np.intp)] = True  # numpy's own conversion is slower
    return used


def validate(mesh: Mesh) -> None:
    """Raise MeshError unless shapes, dtypes, finiteness and index ranges are as documented.

    Vertices that no triangle uses may be NaN or infinite; a mesh without triangles is valid.

    Raises
    ------
    MeshError
        One line: what is wrong, where (source, geometry, index) and what to do about it.
    """
    _validate_layout(mesh)
    _validate_geometries(mesh)
    _validate_indices(mesh)
    _validate_finite(mesh)


def load(path: str | Path) -> Mesh:
    """Read a mesh file (PLY, OBJ, STL, OFF, GLB, glTF; each also gzipped) without changing it.

    Parameters
    ----------
    path : str or Path
        The file; its suffix names the format.

    Returns
    -------
    Mesh
        Triangles in the order of the file. `Mesh.warnings` says what was left out; a file without triangles
        gives a mesh without triangles and a warning.

    Raises
    ------
    MeshError
        If the file is missing, malformed, truncated, or of an unknown format.
    """
    from clgrid.meshfile import read

    return read(Path(path))


def _validate_layout(mesh: Mesh) -> None:
    """Refuse arrays of another shape or dtype, or with more rows than 32-bit indices can name."""
    _require_rows(mesh, "vertices", mesh.vertices, ("float32", "float64"))
    _require_rows(mesh, "faces", mesh.faces, ("uint32",))
    if mesh.vertex_normals is not None:
        _require_rows(mesh, "vertex_normals", mesh.vertex_normals, ("float32",))
        if len(mesh.vertex_normals) != len(mesh.vertices):
            raise MeshError(
                f"{mesh.source}: {len(mesh.vertex_normals)} normals for {len(mesh.vertices)} vertices; "
                "give one normal a vertex or none"
            )


def _require_rows(mesh: Mesh, name: str, array: object, dtypes: tuple[str, ...]) -> None:
    if not isinstance(array, np.ndarray):
        raise MeshError(f"{mesh.source}: {name} is a {type(array).__name__}; give a numpy array")
    if array.ndim != 2 or array.shape[1] != 3 or array.dtype not in dtypes:
        raise MeshError(
            f"{mesh.source}: {name} has shape {array.shape} and dtype {array.dtype}; "
            f"give shape (N, 3) and dtype {' or '.join(dtypes)}"
        )
    if not array.dtype.isnative or not array.flags.c_contiguous:
        raise MeshError(
            f"{mesh.source}: {name} is strided or byte-swapped; pass it through numpy.require(.., 'C')"
        )
    if len(array) > MAX_COUNT:
        raise MeshError(f"{mesh.source}: {len(array)} {name}, at most {MAX_COUNT} fit; split the mesh")


def _validate_geometries(mesh: Mesh) -> None:
    """Refuse geometry ranges that are not an ascending partition of the triangles."""
    starts, names = mesh.geometry_starts, mesh.geometry_names
    if starts.ndim != 1 or starts.dtype != np.int64 or len(starts) != len(names) + 1:
        raise MeshError(
            f"{mesh.source}: geometry_starts has shape {starts.shape} and dtype {starts.dtype}; "
            f"give int64 and one entry more than the {len(names)} names"
        )
    if starts[0] != 0 or starts[-1] != mesh.triangle_count or (np.diff(starts) < 0).any():
        raise MeshError(
            f"{mesh.source}: geometry_starts does not ascend from 0 to the {mesh.triangle_count} triangles; "
            "give the first triangle of each geometry, then the number of triangles"
        )


def _validate_indices(mesh: Mesh) -> None:
    """Refuse triangles that name a vertex which is not there."""
    if not mesh.triangle_count or int(mesh.faces.max()) < len(mesh.vertices):
        return
    bad = np.flatnonzero((mesh.faces >= len(mesh.vertices)).any(axis=1))
    row = mesh.faces[bad[0]]
    raise MeshError(
        f"{mesh.source}: {len(bad)} of {mesh.triangle_count} triangles name a missing vertex, first triangle "
        f"{bad[0]}{_geometry_of(mesh, int(bad[0]))}: vertex {row.max()} of {len(mesh.vertices)}; "
        "repair or re-export the mesh"
    )


def _validate_finite(mesh: Mesh) -> None:
    """Refuse NaN and infinite coordinates of vertices that a triangle uses."""
    # The outermost carry NaN along, and the bounds need them too.
    if not mesh.vertices.size or np.isfinite(mesh._outermost.bounds).all():
        return
    bad = np.flatnonzero(~np.isfinite(mesh.vertices).all(axis=1) & used_vertices(mesh))
    if len(bad) == 0:
        return
    triangle = int(np.flatnonzero((mesh.faces == bad[0]).any(axis=1))[0])
    raise MeshError(
        f"{mesh.source}: {len(bad)} vertices in use are NaN or infinite, first vertex {bad[0]} "
        f"{_row_text(mesh.vertices[bad[0]])} of triangle {triangle}{_geometry_of(mesh, triangle)}; "
        "remove them or their triangles"
    )


def _row_text(row: FloatArray) -> str:
    return "(" + ", ".join(f"{float(value):g}" for value in row) + ")"


def _geometry_of(mesh: Mesh, triangle: int) -> str:
    """Return `` of geometry NAME`` where there is more than one to choose from."""
    if len(mesh.geometry_names) < 2:
        return ""
    geometry = int(mesh.geometry_ids(np.array([triangle], np.int64))[0])
    return f" of geometry {geometry} {mesh.geometry_names[geometry]!r}"


__all__ = ["MAX_COUNT", "FloatArray", "Mesh", "load", "used_vertices", "validate"]
