"""Rays given as arrays, checked and brought to the shape that kernels take."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from clgrid.errors import InputError


@dataclass(frozen=True)
class Rays:
    """Rays as kernels take them.

    Attributes
    ----------
    origins, directions : (..., 3) C-contiguous, both float32 or both float64
    bounds : (1, 2) or (N, 2) float64
        t_min and t_max, for all or by ray.
    """

    origins: npt.NDArray[Any]
    directions: npt.NDArray[Any]
    bounds: npt.NDArray[np.float64]


def as_bounded_rays(
    origins: npt.ArrayLike, directions: npt.ArrayLike | None, t_min: npt.ArrayLike, t_max: npt.ArrayLike
) -> Rays:
    """Rays with their interval; raises InputError as ``as_rays``."""
    o, d = as_rays(origins, directions)
    return Rays(o, d, as_bounds(t_min, t_max, o.shape[:-1]))


def as_rays(
    origins: npt.ArrayLike, directions: npt.ArrayLike | None
) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Broadcast, C-contiguous (..., 3) arrays of one dtype: float32 if both are, else float64.

    Raises
    ------
    InputError
        If the arrays are not numbers, or not of shape (..., 3), or (..., 6) alone.
    """
    try:
        o = np.asarray(origins)
        d = o[..., 3:] if directions is None else np.asarray(directions)
    except (ValueError, IndexError) as error:
        raise InputError(f"rays are not arrays of numbers: {error}") from None
    if directions is None:
        if o.ndim == 0 or o.shape[-1] != 6:
            raise InputError(f"rays have shape {o.shape}; give (..., 6), or origins and directions")
        o = o[..., :3]
    for name, array in (("origins", o), ("directions", d)):
        if array.ndim == 0 or array.shape[-1] != 3:
            raise InputError(f"{name} have shape {array.shape}; give (..., 3)")
        if array.dtype.kind not in "fiu":
            raise InputError(f"{name} have dtype {array.dtype}; give real numbers")
    real = np.float32 if o.dtype == np.float32 and d.dtype == np.float32 else np.float64
    try:
        shape = np.broadcast_shapes(o.shape, d.shape)
    except ValueError:
        raise InputError(f"origins {o.shape} and directions {d.shape} do not broadcast") from None
    # Only what is not of that shape: a broadcast array is not to be written, so devices would copy it.
    o, d = (a if a.shape == shape else np.broadcast_to(a, shape) for a in (o, d))
    return np.ascontiguousarray(o, real), np.ascontiguousarray(d, real)


def as_bounds(t_min: npt.ArrayLike, t_max: npt.ArrayLike, shape: tuple[int, ...]) -> npt.NDArray[np.float64]:
    """(1, 2) float64 if both are scalars, else (N, 2).

    Raises
    ------
    InputError
        If they are not numbers, or do not broadcast to the rays.
    """
    try:
        low, high = np.asarray(t_min, np.float64), np.asarray(t_max, np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"t_min and t_max are not arrays of numbers: {error}") from None
    if low.ndim == 0 and high.ndim == 0:
        return np.array([[low, high]])
    try:
        both = [np.broadcast_to(side, shape).reshape(-1) for side in (low, high)]
    except ValueError:
        raise InputError(
            f"t_min {low.shape} and t_max {high.shape} do not broadcast to rays {shape}"
        ) from None
    return np.ascontiguousarray(np.stack(both, axis=-1))


def invalid_count(rays: Rays) -> int:
    """How many rays are misses whatever the mesh: not finite, or without a direction."""
    o, d = rays.origins.reshape(-1, 3), rays.directions.reshape(-1, 3)
    sound = np.isfinite(o).all(-1) & np.isfinite(d).all(-1) & (d != 0).any(-1)
    return int(np.sum(~sound | np.isnan(rays.bounds).any(-1)))
