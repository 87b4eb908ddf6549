"""Casts rays against every triangle, without a grid: the oracle that users can call."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from clgrid.cast import Defines, blank, field_defines, hits_of, no_hits, run
from clgrid.device import Device, choose
from clgrid.errors import InputError
from clgrid.frame import LocalFrame
from clgrid.hits import COUNTERS, FIELDS, Hits, checked_fields
from clgrid.memory import Allocator
from clgrid.mesh import Mesh
from clgrid.program import kernel
from clgrid.rays import Rays, as_bounded_rays
from clgrid.rungs import ACCURACIES, RUNGS
from clgrid.target import DeviceMesh
from clgrid.tiles import Division

# There are no cells to count.
_FIELDS = tuple(name for name in FIELDS if name not in COUNTERS)
_RAYS_PER_ITEM = 16  # RAYS of cl/brute_force.cl


def brute_force(
    mesh: Mesh,
    origins: npt.ArrayLike,
    directions: npt.ArrayLike | None = None,
    t_min: npt.ArrayLike = 0.0,
    t_max: npt.ArrayLike = np.inf,
    device: Device | str | None = None,
    accuracy: str = "robust",
    fields: Sequence[str] | None = None,
) -> Hits:
    """Closest hits by testing every triangle: the oracle that ``Grid.cast`` equals bit for bit.

    Parameters
    ----------
    mesh : Mesh
    origins, directions, t_min, t_max, fields
        As for ``Grid.cast``.
    device, accuracy
        As for ``build``.
    """
    rays = as_bounded_rays(origins, directions, t_min, t_max)
    wanted = checked_fields(fields, _checked(accuracy), _FIELDS)
    if mesh.triangle_count == 0:
        return no_hits(mesh, rays, wanted, RUNGS[accuracy].real)
    results = blank(len(rays.origins.reshape(-1, 3)), wanted, RUNGS[accuracy].real)
    invalid = _run(mesh, rays, device, accuracy, field_defines(wanted), list(results.values()))
    return hits_of(mesh, rays, results, invalid)


def brute_force_count(
    mesh: Mesh,
    origins: npt.ArrayLike,
    directions: npt.ArrayLike | None = None,
    t_min: npt.ArrayLike = 0.0,
    t_max: npt.ArrayLike = np.inf,
    device: Device | str | None = None,
    accuracy: str = "robust",
) -> npt.NDArray[np.uint32]:
    """(...) uint32: ``Grid.count`` by testing every triangle; parameters as of ``brute_force``."""
    rays = as_bounded_rays(origins, directions, t_min, t_max)
    counts = np.zeros(len(rays.origins.reshape(-1, 3)), np.uint32)
    _checked(accuracy)
    if mesh.triangle_count:
        _run(mesh, rays, device, accuracy, {"QUERY_COUNT": 1}, [counts])
    return counts.reshape(rays.origins.shape[:-1])


def _checked(accuracy: str) -> str:
    if accuracy not in RUNGS:
        raise InputError(f"accuracy is {accuracy!r}; choose one of {', '.join(ACCURACIES)}")
    return accuracy


def _run(
    mesh: Mesh,
    rays: Rays,
    device: Device | str | None,
    accuracy: str,
    options: Defines,
    results: Sequence[npt.NDArray[Any]],
) -> int:
    chosen = device if isinstance(device, Device) else choose(device)
    allocator = Allocator(chosen)
    target = DeviceMesh(mesh, chosen, allocator, RUNGS[accuracy])
    whole = target.whole
    soup = _soup(mesh, target.frame)
    soup_buffer = allocator.share(soup)

    def launch(inputs: list[Any], count: int, outputs: list[Any], defines: Defines) -> None:
        every = {**defines, **options, **whole.defines, **target.rung.defines}
        kernel(chosen, "brute_force.cl", "brute_force", **every)(
            chosen.queue, (-(-count // _RAYS_PER_ITEM),), (1,), target.frame_params,
            np.uint32(mesh.triangle_count), np.uint32(soup.shape[1]), soup_buffer,
            *whole.arguments, *inputs, np.uint32(count), *outputs,
        )  # fmt: skip

    return run(target, launch, Division(size=_RAYS_PER_ITEM), rays, results)


def _soup(mesh: Mesh, frame: LocalFrame) -> npt.NDArray[np.float32]:
    """(9, N) float32 local coordinates, 3 * corner + axis; N is rounded up to a multiple of 8."""
    padded = np.zeros((9, -(-mesh.triangle_count // 8) * 8), np.float32)
    corners = frame.to_local(mesh.vertices)[mesh.faces]
    padded[:, : mesh.triangle_count] = corners.reshape(-1, 9).T
    return padded
