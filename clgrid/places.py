"""Hits of a ray in one place: at an edge or a vertex, several triangles are met at once."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from clgrid.hits import AllHits
from clgrid.mesh import Mesh

# Hits whose errors are smaller, in sizes of the mesh, are in one place wherever those overlap.
_PLACE = 2.0**-30


def first_of_place(every: AllHits, mesh: Mesh, directions: npt.NDArray[Any]) -> npt.NDArray[np.bool_]:
    """(H,) bool: all hits but those in the place of the one before: as near as their errors can tell.

    The error of a triangle seen all but edge-on is no place, so that then has to have a corner of the other.
    """
    t, of_ray = every.t_hit, every.ray_ids
    doubt = every.t_err[1:] + every.t_err[:-1]
    again = (of_ray[1:] == of_ray[:-1]) & (t[1:] - t[:-1] <= doubt)
    pairs = np.flatnonzero(again)
    if len(pairs):
        length = np.linalg.norm(directions[of_ray[pairs]].astype(np.float64), axis=1)
        vague = pairs[doubt[pairs] * length > _PLACE * np.ptp(mesh.bounds, axis=0).max()]
        ids = every.primitive_ids
        again[vague] = _have_common_corner(mesh, ids[vague], ids[vague + 1])
    return np.concatenate([np.ones(min(1, len(t)), np.bool_), ~again])


def _have_common_corner(
    mesh: Mesh, ones: npt.NDArray[np.int64], others: npt.NDArray[np.int64]
) -> npt.NDArray[np.bool_]:
    """(n,) bool: whether two triangles have a corner in the same position."""
    of_ones, of_others = (mesh.vertices[mesh.faces[ids]] for ids in (ones, others))
    same = (of_ones[:, :, None] == of_others[:, None]).all(axis=-1)
    common: npt.NDArray[np.bool_] = same.any(axis=(1, 2))
    return common


__all__ = ["first_of_place"]
