"""What the strict rungs promise of any mesh and rays, checked at once."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
import numpy.typing as npt
from agreement import RUNGS, Answers, Query, assert_lossless, query

from clgrid.device import Device
from clgrid.hits import AllHits, Hits
from clgrid.mesh import Mesh
from clgrid.rational import Triangles, crossings

Bool = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Kept:
    """Answers that keep the promises, by rung."""

    answers: dict[str, Answers]

    @property
    def hits(self) -> dict[str, Hits]:
        return {rung: each.hits for rung, each in self.answers.items()}

    @property
    def every(self) -> dict[str, AllHits]:
        return {rung: each.every for rung, each in self.answers.items()}

    @property
    def counts(self) -> npt.NDArray[np.int64]:
        """Crossings of each ray, on the rung ``exact``."""
        return self.answers["exact"].counts.astype(np.int64)

    def all_hit(self) -> bool:
        return all(bool(hits.mask.all()) for hits in self.hits.values())

    def none_hit(self) -> bool:
        return not any(bool(hits.mask.any()) for hits in self.hits.values())

    def ids(self, rung: str = "exact") -> list[int]:
        ids: list[int] = self.hits[rung].primitive_ids.tolist()
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

    For ``sample`` rays at most, rational arithmetic says what ``exact`` must answer, and that no t of any
    rung is off by more than its t_err. ``options`` are those of ``build``. Rays are flattened to rows; a
    single one becomes two, as one row would need kernels of its own.
    """
    o, d = np.broadcast_arrays(np.asarray(origins, np.float64), np.asarray(directions, np.float64))
    o, d = o.reshape(-1, 3), d.reshape(-1, 3)
    if len(o) == 1:
        o, d = np.repeat(o, 2, axis=0), np.repeat(d, 2, axis=0)
    rays = query(o, d, t_min, t_max)
    grids = [{"density": 4, **options}]
    found = Kept({rung: assert_lossless(mesh, device, rung, rays, grids) for rung in RUNGS})
    triangles = Triangles.of_mesh(mesh)
    for row in np.unique(np.linspace(0, len(o) - 1, min(sample, len(o))).astype(int)):
        _check_exactly(triangles, found, rays, int(row))
    return found


def _check_exactly(triangles: Triangles, found: Kept, rays: Query, row: int) -> None:
    o, d, low, high = (side[row] for side in rays)
    met = crossings(triangles, o, d)
    within = [crossing for crossing in met if low <= crossing.t <= high]
    assert found.counts[row] == len(within), (
        f"ray {row}: {len(within)} crossings, {found.counts[row]} counted"
    )
    nearest = within[0].id if within else -1
    assert found.hits["exact"].primitive_ids[row] == nearest, (
        f"ray {row}: not the nearest triangle, {nearest}"
    )
    for rung, hits in found.hits.items():
        truth = next((crossing.t for crossing in met if crossing.id == hits.primitive_ids[row]), None)
        if truth is not None:
            error, bound = abs(Fraction(float(hits.t_hit[row])) - truth), float(hits.t_err[row])
            assert np.isfinite(bound)
            assert error <= bound, f"{rung}: t of ray {row} is off by {float(error)}, t_err is {bound}"
