"""What the strict rungs promise of any mesh and rays, checked at once."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
import numpy.typing as npt

from clgrid import rational
from clgrid.brute import brute_force, brute_force_count
from clgrid.device import Device
from clgrid.grid import Grid, build
from clgrid.hits import Hits
from clgrid.mesh import Mesh
from clgrid.rungs import LOSSLESS

FIELDS = ("primitive_uvs", "t_err")


@dataclass(frozen=True)
class Kept:
    """Answers that keep the promises."""

    hits: dict[str, Hits]
    """By rung."""
    counts: npt.NDArray[np.uint32]
    """Of the rung exact."""
    exact: Grid

    def all_hit(self) -> bool:
        return all(bool(hits.mask.all()) for hits in self.hits.values())

    def none_hit(self) -> bool:
        return not any(bool(hits.mask.any()) for hits in self.hits.values())

    def ids(self, rung: str = "exact") -> list[int]:
        ids: list[int] = self.hits[rung].primitive_ids.reshape(-1).tolist()
        return ids


def kept(
    mesh: Mesh,
    origins: npt.ArrayLike,
    directions: npt.ArrayLike,
    device: Device,
    t_min: npt.ArrayLike = 0.0,
    t_max: npt.ArrayLike = np.inf,
    sample: int = 200,
    **options: Any,
) -> Kept:
    """Cast on every strict rung: grid and brute force agree in every bit, ``exact`` is rational arithmetic.

    Of ``sample`` rays at most, rational arithmetic says what ``exact`` must answer, and that no t of any rung
    is off by more than its t_err. ``options`` are those of ``build``.
    """
    shape = np.broadcast_shapes(np.shape(origins), np.shape(directions))
    o, d = (np.ascontiguousarray(np.broadcast_to(a, shape)).reshape(-1, 3) for a in (origins, directions))
    low, high = (np.broadcast_to(np.asarray(a, np.float64), shape[:-1]).reshape(-1) for a in (t_min, t_max))
    options = {"density": 4, **options}
    hits, grids = {}, {}
    for rung in LOSSLESS:
        grids[rung] = build(mesh, accuracy=rung, device=device, **options)
        hits[rung] = grids[rung].cast(o, d, low, high, fields=FIELDS)
        oracle = brute_force(mesh, o, d, low, high, device=device, accuracy=rung, fields=FIELDS)
        for name in ("primitive_ids", "t_hit", *FIELDS):
            found, expected = hits[rung][name], oracle[name]
            assert found.tobytes() == expected.tobytes(), f"{rung}: {name} differs from brute force"
    counts = grids["exact"].count(o, d, low, high)
    expected = brute_force_count(mesh, o, d, low, high, device=device, accuracy="exact")
    np.testing.assert_array_equal(counts, expected)
    triangles = rational.Triangles.of_mesh(mesh)
    for row in np.unique(np.linspace(0, len(o) - 1, min(sample, len(o))).astype(int)):
        _check_exactly(mesh, triangles, hits, counts, o, d, low, high, int(row))
    return Kept(hits, counts, grids["exact"])


def _check_exactly(
    mesh: Mesh,
    triangles: rational.Triangles,
    hits: dict[str, Hits],
    counts: npt.NDArray[np.uint32],
    o: npt.NDArray[Any],
    d: npt.NDArray[Any],
    low: npt.NDArray[np.float64],
    high: npt.NDArray[np.float64],
    row: int,
) -> None:
    met = rational.crossings(triangles, o[row], d[row])
    within = [c for c in met if low[row] <= c.t <= high[row]]
    assert counts[row] == len(within), f"ray {row}: {counts[row]} crossings, exactly {len(within)}"
    nearest = within[0].id if within else -1
    assert hits["exact"].primitive_ids[row] == nearest, f"ray {row}: not the nearest triangle, {nearest}"
    for rung, found in hits.items():
        truth = next((c.t for c in met if c.id == found.primitive_ids[row]), None)
        if truth is not None:
            error = abs(Fraction(float(found.t_hit[row])) - truth)
            assert np.isfinite(found.t_err[row])
            assert error <= found.t_err[row], f"{rung}: t of ray {row} is off by {float(error)}"
