"""What rays hit: the results of casting, as arrays of the rays' shape."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from clgrid.errors import InputError
from clgrid.mesh import Mesh
from clgrid.shown import Facts, Shown, counted, shape_text

Floats = npt.NDArray[np.float32] | npt.NDArray[np.float64]

COUNTERS = ("steps", "tests", "batches")
FIELDS = ("primitive_uvs", "t_err", "certain", *COUNTERS)
"""What is computed where it is asked for, beside t_hit and primitive_ids."""
ALL_FIELDS = ("primitive_uvs", "t_err")
"""The same for ``AllHits``."""
DEFAULT_FIELDS = ("primitive_uvs",)
DERIVED = ("mask", "geometry_ids", "primitive_normals", "points")
ALL_DERIVED = ("geometry_ids", "primitive_normals", "points")
ALWAYS = ("t_hit", "primitive_ids")


def checked_fields(
    fields: Sequence[str] | None, accuracy: str, known: Sequence[str] = FIELDS
) -> tuple[str, ...]:
    """The fields to compute of those known, in that order.

    Raises
    ------
    InputError
        If one is unknown, or not of this rung.
    """
    if fields is None:
        return DEFAULT_FIELDS
    if isinstance(fields, str):
        raise InputError(f"fields is {fields!r}; give a sequence of names, ({fields!r},)")
    for name in fields:
        if name not in (*known, *ALWAYS, *DERIVED):
            raise InputError(f"fields: unknown {name!r}; choose of {', '.join((*ALWAYS, *known))}")
    if "certain" in fields and accuracy != "exact":
        raise InputError(
            f"fields: 'certain' is of the rung exact, not of {accuracy}; build with accuracy='exact'"
        )
    if "t_err" in fields and accuracy == "fast":
        raise InputError(
            "fields: 't_err' is of the strict rungs, not of fast; name one of those in accuracy="
        )
    counting = bool(set(COUNTERS) & set(fields))
    return tuple(name for name in known if name in fields or (name in COUNTERS and counting))


def _range_text(t: npt.NDArray[np.float64]) -> str:
    return f"{t.min():g} to {t.max():g}" if t.size else "none"


def unit_normals(mesh: Mesh, primitive_ids: npt.NDArray[np.int64]) -> npt.NDArray[np.float64]:
    """(..., 3) float64: unit normals of triangles by their winding; 0 for -1 and for those without area."""
    mask = primitive_ids >= 0
    corners = mesh.vertices[mesh.faces[primitive_ids[mask]]].astype(np.float64)
    # To unit size first, so that no product over- or underflows.
    edges = corners[:, 1:] - corners[:, :1]
    size = np.max(np.abs(edges), axis=(1, 2), keepdims=True, initial=0.0)
    edges /= np.where(size > 0, size, 1.0)
    normal = np.cross(edges[:, 0], edges[:, 1])
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    normals = np.zeros((*mask.shape, 3))
    normals[mask] = normal / np.where(length > 0, length, 1.0)
    return normals


class _Computed:
    """Results that were asked for by name."""

    computed: dict[str, npt.NDArray[Any]]

    def _asked_for(self, name: str) -> Any:
        if name not in self.computed:
            raise InputError(f"{name} was not computed; ask for it: cast(..., fields=({name!r},))")
        return self.computed[name]

    @property
    def primitive_uvs(self) -> Floats:
        """(..., 2): barycentric weights of the triangle's second and third vertex; 0 on a miss.

        float32, or float64 on the rungs ``precise`` and ``exact``.
        """
        uvs: Floats = self._asked_for("primitive_uvs")
        return uvs

    @property
    def t_err(self) -> npt.NDArray[np.float64]:
        """(...) float64: a bound on the error of t_hit, in its unit; 0 on a miss.

        Where the ray as given meets the triangle as given, it does so within t_hit +- t_err.
        """
        errors: npt.NDArray[np.float64] = self._asked_for("t_err")
        return errors

    @property
    def certain(self) -> npt.NDArray[np.bool_]:
        """(...) bool: whether the floating-point filter decided that the ray crosses the triangle.

        False where that took integers: the ray meets an edge or a vertex, or as good as. True on a miss.
        """
        certain: npt.NDArray[np.bool_] = self._asked_for("certain")
        return certain

    @property
    def steps(self) -> npt.NDArray[np.uint32]:
        """(...) uint32: cells that the ray looked at, and empty bricks that it left without a look inside."""
        steps: npt.NDArray[np.uint32] = self._asked_for("steps")
        return steps

    @property
    def tests(self) -> npt.NDArray[np.uint32]:
        """(...) uint32: triangles of the cells' lists, each tested."""
        tests: npt.NDArray[np.uint32] = self._asked_for("tests")
        return tests

    @property
    def batches(self) -> npt.NDArray[np.uint32]:
        """(...) uint32: of up to eight triangles each, in which they were tested."""
        batches: npt.NDArray[np.uint32] = self._asked_for("batches")
        return batches


@dataclass(frozen=True, repr=False)
class Hits(_Computed, Shown):
    """What rays hit. Arrays have the rays' leading shape; ``hits["t_hit"]`` works too.

    Attributes
    ----------
    t_hit : (...) float64
        Ray parameter of the nearest hit, in lengths of the direction vector; inf on a miss.
    primitive_ids : (...) int64
        Triangle, -1 on a miss.
    invalid_rays : int
        Rays that are misses because they are not finite or have no direction.
    computed : dict of str to array
        What else was asked for, by name; each is an attribute too.
    """

    t_hit: npt.NDArray[np.float64]
    primitive_ids: npt.NDArray[np.int64]
    invalid_rays: int
    mesh: Mesh
    origins: npt.NDArray[Any]
    directions: npt.NDArray[Any]
    computed: dict[str, npt.NDArray[Any]] = field(default_factory=dict)

    def _headline(self) -> str:
        return f"{shape_text(self.t_hit.shape, 'ray')}, {counted(int(np.count_nonzero(self.mask)), 'hit')}"

    def _facts(self) -> Facts:
        return {
            "mesh": self.mesh.source,
            "t_hit": _range_text(self.t_hit[self.mask]),
            "triangles hit": f"{len(np.unique(self.primitive_ids[self.mask])):,}",
            "invalid rays": f"{self.invalid_rays:,}",
            "computed": ", ".join((*ALWAYS, *self.computed)),
        }

    def __getitem__(self, name: str) -> Any:
        if name not in (*ALWAYS, *FIELDS, *DERIVED):
            raise KeyError(name)
        return getattr(self, name)

    @property
    def mask(self) -> npt.NDArray[np.bool_]:
        """(...) bool: where a ray hit."""
        return self.primitive_ids >= 0

    @property
    def geometry_ids(self) -> npt.NDArray[np.int64]:
        """(...) int64: geometry of the triangle, -1 on a miss."""
        return self.mesh.geometry_ids(self.primitive_ids)

    @property
    def primitive_normals(self) -> npt.NDArray[np.float64]:
        """(..., 3) float64: unit normal of the triangle by its winding; 0 on a miss."""
        return unit_normals(self.mesh, self.primitive_ids)

    @property
    def points(self) -> npt.NDArray[np.float64]:
        """(..., 3) float64: origin + t_hit * direction, in scene units; NaN on a miss."""
        t = np.where(self.mask, self.t_hit, np.nan)[..., None]
        points: npt.NDArray[np.float64] = self.origins + t * self.directions.astype(np.float64)
        return points


@dataclass(frozen=True, repr=False)
class AllHits(_Computed, Shown):
    """Every triangle that each ray meets: those of ray i are ray_splits[i] to ray_splits[i + 1] - 1.

    Attributes
    ----------
    ray_splits : (N + 1,) int64
        Rays are counted in C order of their leading shape.
    t_hit : (H,) float64
        Ascending within a ray, equal ones by triangle; in lengths of the direction vector.
    primitive_ids : (H,) int64
        Triangle.
    invalid_rays : int
        Rays that are misses because they are not finite or have no direction.
    mesh : Mesh
    origins, directions : (..., 3)
        As cast.
    computed : dict of str to array
        What else was asked for, by name; each is an attribute too.
    """

    ray_splits: npt.NDArray[np.int64]
    t_hit: npt.NDArray[np.float64]
    primitive_ids: npt.NDArray[np.int64]
    invalid_rays: int
    mesh: Mesh
    origins: npt.NDArray[Any]
    directions: npt.NDArray[Any]
    computed: dict[str, npt.NDArray[Any]] = field(default_factory=dict)

    def _headline(self) -> str:
        rays = counted(len(self.ray_splits) - 1, "ray")
        return f"{rays}, {counted(len(self.t_hit), 'hit')}"

    def _facts(self) -> Facts:
        return {
            "mesh": self.mesh.source,
            "t_hit": _range_text(self.t_hit),
            "most hits of a ray": f"{int(self.counts.max(initial=0)):,}",
            "triangles hit": f"{len(np.unique(self.primitive_ids)):,}",
            "invalid rays": f"{self.invalid_rays:,}",
            "computed": ", ".join((*ALWAYS, *self.computed)),
        }

    def __getitem__(self, name: str) -> Any:
        if name not in ("ray_splits", "counts", "ray_ids", *ALWAYS, *ALL_FIELDS, *ALL_DERIVED):
            raise KeyError(name)
        return getattr(self, name)

    @property
    def counts(self) -> npt.NDArray[np.int64]:
        """(N,) int64: hits of each ray."""
        return np.diff(self.ray_splits)

    @property
    def ray_ids(self) -> npt.NDArray[np.int64]:
        """(H,) int64: the ray of each hit."""
        return np.repeat(np.arange(len(self.ray_splits) - 1), self.counts)

    @property
    def geometry_ids(self) -> npt.NDArray[np.int64]:
        """(H,) int64: geometry of the triangle."""
        return self.mesh.geometry_ids(self.primitive_ids)

    @property
    def primitive_normals(self) -> npt.NDArray[np.float64]:
        """(H, 3) float64: unit normal of the triangle by its winding."""
        return unit_normals(self.mesh, self.primitive_ids)

    @property
    def points(self) -> npt.NDArray[np.float64]:
        """(H, 3) float64: origin + t_hit * direction, in scene units."""
        rays = self.ray_ids
        origins, directions = (array.reshape(-1, 3)[rays] for array in (self.origins, self.directions))
        points: npt.NDArray[np.float64] = origins + self.t_hit[:, None] * directions.astype(np.float64)
        return points
