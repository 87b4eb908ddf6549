"""The start-up self-test: a thousand rays, most at edges and vertices, before a device's first strict grid.

A driver that contracts products, rounds otherwise or miscompiles is found here, once per device, driver and
kernel sources, and refused for the rungs whose promises it breaks.
"""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Callable
from typing import Protocol

import numpy as np
import numpy.typing as npt

from clgrid import cache, layouts, procedural
from clgrid.description import Description
from clgrid.device import Device
from clgrid.errors import ClgridError, DeviceError
from clgrid.hits import Hits
from clgrid.mesh import Mesh
from clgrid.program import source_digest
from clgrid.rungs import Rung

F64 = npt.NDArray[np.float64]

LAYOUT, DENSITY = "compact", 4.0
"""Of the grid that is built for the test."""

# Of t, ids, u and v of all rays, as tests/test_selftest.py derives them without a device.
EXPECTED = {
    "robust": "e7eafff2e6befe3e",
    "precise": "7dd4d40541c0eda3",
    "exact": "69d82820603ba549",
}

# The ball is sheared by this, so that no coordinate is special; short, so that no product is rounded.
_ASKEW = ((0.75, 0.25, -0.125), (-0.3125, 0.6875, 0.25), (0.125, -0.1875, 0.8125))
# Points within it, in thirty-seconds.
_ORIGINS = ((0, 0, 0), (5, -3, 7), (-9, 4, 1))

_lock = threading.RLock()
_passed: set[tuple[Device, str]] = set()


class Caster(Protocol):
    """What of a grid is tested."""

    def cast(self, origins: npt.ArrayLike, directions: npt.ArrayLike) -> Hits:
        """Closest hits."""

    def count(self, origins: npt.ArrayLike, directions: npt.ArrayLike) -> npt.NDArray[np.uint32]:
        """Numbers of hits."""


def mesh() -> Mesh:
    """A closed, convex mesh of 80 triangles around the origin, the same bits everywhere."""
    ball = procedural.icosphere(1)
    x, y, z = ball.vertices.astype(np.float64).T
    rows = [a * x + b * y + c * z for a, b, c in _ASKEW]
    return Mesh(np.stack(rows, axis=-1).astype(np.float32), ball.faces, source="self-test")


def rays(of: Mesh) -> tuple[F64, F64]:
    """(N, 3) origins and directions: from within, exactly at vertices, points of edges and of faces."""
    corners = of.vertices[of.faces].astype(np.float64)
    a, b = (corners[:, turn].reshape(-1, 3) for turn in ((0, 1, 2), (1, 2, 0)))
    # Each edge twice, from both of its triangles.
    edges = a * 0.75 + b * 0.25
    # On the rung exact, integers decide these; the filter in floating point decides points of faces.
    faces = (corners[:, 0] * 0.5 + corners[:, 1] * 0.25) + corners[:, 2] * 0.25
    targets = np.concatenate([of.vertices.astype(np.float64), edges, faces])
    starts = np.array(_ORIGINS) / 32
    origins = np.repeat(starts, len(targets), axis=0)
    return origins, np.tile(targets, (len(starts), 1)) - origins


def digest(hits: Hits) -> str:
    """Of every bit of t, id, u and v."""
    hashed = hashlib.sha256()
    for array, kind in ((hits.t_hit, "<f8"), (hits.primitive_ids, "<i8"), (hits.primitive_uvs, None)):
        little = array.dtype.newbyteorder("<") if kind is None else np.dtype(kind)
        hashed.update(np.ascontiguousarray(array, little).tobytes())
    return hashed.hexdigest()[:16]


def fault(caster: Caster, of: Mesh, rung: str) -> str:
    """What is wrong with a grid over ``mesh()`` on a rung, in one clause; empty if nothing."""
    origins, directions = rays(of)
    hits = caster.cast(origins, directions)
    escaped = int(np.count_nonzero(~hits.mask))
    if escaped:
        return f"{escaped} of {len(origins)} rays escape from a closed mesh"
    if rung == "exact":
        wrong = int(np.count_nonzero(caster.count(origins, directions) != 1))
        if wrong:
            return f"{wrong} of {len(origins)} rays do not cross a convex mesh once"
    if digest(hits) != EXPECTED[rung]:
        return "hits do not have the bits that exact rules of rounding give"
    return ""


def require(device: Device, rung: Rung, make: Callable[[Mesh], Caster]) -> None:
    """Find out, before a device's first grid on a strict rung, that it keeps the rung's promises.

    A success is remembered on disk.

    Parameters
    ----------
    device : Device
    rung : Rung
        One that promises nothing is not tested.
    make : callable
        Builds a grid of this rung over a mesh on the device.

    Raises
    ------
    DeviceError
        If it does not, saying what is wrong and what to do.
    """
    if not rung.lossless or (device, rung.name) in _passed:
        return
    with _lock:
        name = record_name(device.description, rung.name)
        record = cache.load(name)
        if record is None or record.get("fault") != "":
            _examine(device, rung.name, make, name)
        _passed.add((device, rung.name))


def _examine(device: Device, rung: str, make: Callable[[Mesh], Caster], name: str) -> None:
    # What clgrid doctor finds, should the driver take the process along.
    cache.store(name, {"fault": "it never ended: the driver crashed, hung or was stopped"})
    try:
        of = mesh()
        found = fault(make(of), of, rung)
    except ClgridError as error:
        cache.store(name, {"fault": str(error)})
        raise
    cache.store(name, {"fault": found})
    if found:
        raise DeviceError(
            f"{device.label}: refused for accuracy {rung!r}, whose self-test it fails: {found}; use another"
            " device (clgrid devices) or another version of its driver"
        )


def record_name(seen: Description, rung: str) -> str:
    """Name of the record in ``cache.folder()``: another one for every driver, kernel source and rung."""
    files = (
        *layouts.programs(LAYOUT, skip=False),
        "cast_closest.cl",
        *(("count_hits.cl",) * (rung == "exact")),
    )
    return "selftest-" + cache.key(
        *(rung, EXPECTED[rung], seen.platform_version, seen.name, seen.driver_version),
        *((seen.note,) if seen.note else ()),
        *(source_digest(file) for file in files),
    )


def remembered(seen: Description, rung: str) -> str | None:
    """What the last self-test found: empty if nothing wrong, None if it never ran."""
    record = cache.load(record_name(seen, rung))
    found = None if record is None else record.get("fault")
    return found if isinstance(found, str) else None
