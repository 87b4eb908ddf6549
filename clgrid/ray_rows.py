"""Rays as rows of numbers: the arguments of trimesh's queries."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from clgrid.errors import InputError

# Squared lengths beyond which directions are scaled: kernels take no ray whose t might lose digits.
_LEAST_SQUARE, _LARGEST_SQUARE = 2.0**-900, 2.0**900


class RayRows(NamedTuple):
    """As many origins as directions, (n, 3) float32 or float64 each."""

    origins: npt.NDArray[Any]
    directions: npt.NDArray[Any]


def ray_rows(origins: npt.ArrayLike, directions: npt.ArrayLike) -> RayRows:
    """Both as (n, 3); directions whose squares no double holds are scaled by powers of two.

    Raises
    ------
    InputError
        If they are not numbers, of another shape, or not equally many.
    """
    rays = RayRows(rows("ray_origins", origins), rows("ray_directions", directions))
    if len(rays.origins) != len(rays.directions):
        raise InputError(
            f"{len(rays.origins)} ray_origins for {len(rays.directions)} ray_directions; give as many of both"
        )
    return RayRows(rays.origins, _tame(rays.directions))


def rows(name: str, values: npt.ArrayLike) -> npt.NDArray[Any]:
    """(n, 3) real numbers; none of an empty list.

    Raises
    ------
    InputError
        If they are not numbers, or of another shape.
    """
    try:
        rows = np.asarray(values)
    except ValueError as error:
        raise InputError(f"{name}: no array of numbers: {error}") from None
    if rows.dtype.kind not in "fiub":
        raise InputError(f"{name} has dtype {rows.dtype}; give real numbers")
    if rows.shape == (0,):
        rows = rows.reshape(0, 3)
    if rows.ndim != 2 or rows.shape[1] != 3:
        raise InputError(f"{name} has shape {rows.shape}; give (n, 3)")
    return rows if rows.dtype == np.float32 else rows.astype(np.float64, copy=False)


def _tame(directions: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """The directions, those of hardly any or hardly a finite length brought to one near 1, exactly."""
    if directions.dtype == np.float32:
        return directions
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        square = np.einsum("ij,ij->i", directions, directions)
    wild = np.flatnonzero((square < _LEAST_SQUARE) | (square > _LARGEST_SQUARE))
    if not len(wild):
        return directions
    tamed = directions.copy()
    _, exponents = np.frexp(np.abs(directions[wild]).max(axis=1))
    tamed[wild] = np.ldexp(directions[wild], -exponents[:, None])
    return tamed


__all__ = ["RayRows", "ray_rows", "rows"]
