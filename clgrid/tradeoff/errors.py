"""How the answers of a point differ from those of a reference, ray by ray."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import numpy.typing as npt

from clgrid.hits import Hits
from clgrid.rational import Crossing
from clgrid.tradeoff.intervals import rate_most
from clgrid.tradeoff_record import DistanceErrors, RayErrors

F64 = npt.NDArray[np.float64]
EXACT_RUNG, RATIONAL = "exact rung", "rational"


@dataclass(frozen=True)
class Rays:
    """Rays of one kind.

    Attributes
    ----------
    kind : {"camera", "structured"}
    origins, directions : (N, 3) float64
    sample : (M,) int64
        Numbers of some of them, for what is slow.
    """

    kind: str
    origins: F64
    directions: F64
    sample: npt.NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.origins)

    def first(self, count: int) -> Rays:
        """The first of them, and what is among them of the sample."""
        sample = self.sample[self.sample < count]
        return Rays(self.kind, self.origins[:count], self.directions[:count], sample)


@dataclass(frozen=True)
class Answers:
    """Nearest hits of rays: what a point says, or a reference.

    Attributes
    ----------
    t : (N,) float64
        inf on a miss.
    ids : (N,) int64
        -1 on a miss.
    """

    t: F64
    ids: npt.NDArray[np.int64]

    @classmethod
    def of_hits(cls, hits: Hits) -> Answers:
        """Of a cast."""
        return cls(hits.t_hit, hits.primitive_ids)

    def at(self, rows: npt.NDArray[np.int64] | slice) -> Answers:
        """Of some of the rays."""
        return Answers(self.t[rows], self.ids[rows])


def against_exact_rung(
    kind: str, found: Answers, truth: Answers, t_err: F64, last: F64, lengths: F64
) -> RayErrors:
    """Compare with the hits of the rung ``exact``, which may themselves be off by ``t_err``.

    Parameters
    ----------
    kind : str
    found, truth : Answers
        To the same rays.
    t_err, last, lengths : (N,) float64
        Of the truth's t; a unit in the last place of t; lengths of the directions, scene units.
    """
    same = (found.ids == truth.ids) & (truth.ids >= 0)
    off = np.abs(found.t[same] - truth.t[same])
    floor = float((t_err[same] * lengths[same]).max(initial=0.0))
    return _errors(kind, EXACT_RUNG, found, truth.ids, off / last[same], off * lengths[same], floor)


def against_rational(
    kind: str, found: Answers, lines: Sequence[list[Crossing]], last: F64, lengths: F64
) -> RayErrors:
    """Compare with rational arithmetic: all crossings of each line, as ``clgrid verify`` does.

    Parameters
    ----------
    kind, found, last, lengths
        As of ``against_exact_rung``.
    lines : sequence of list of Crossing
        One a ray.
    """
    nearest = nearest_ids(lines)
    same = np.flatnonzero((found.ids == nearest) & (nearest >= 0))
    off = np.array(
        [
            float(abs(Fraction(found.t.item(row)) - crossing_of(lines[row], nearest.item(row))))
            for row in same.tolist()
        ]
    )
    return _errors(kind, RATIONAL, found, nearest, off / last[same], off * lengths[same], 0.0)


def nearest_ids(lines: Sequence[list[Crossing]]) -> npt.NDArray[np.int64]:
    """(N,) the first triangle that each line crosses from its origin on, -1 for none."""
    ahead = ([crossing.id for crossing in line if crossing.t >= 0] for line in lines)
    return np.array([ids[0] if ids else -1 for ids in ahead], np.int64)


def crossing_of(line: list[Crossing], id_: int) -> Fraction:
    """Exact t at which a line crosses one of its triangles."""
    return next(crossing.t for crossing in line if crossing.id == id_)


def _errors(
    kind: str,
    reference: str,
    found: Answers,
    truth: npt.NDArray[np.int64],
    ulps: F64,
    distances: F64,
    floor: float,
) -> RayErrors:
    rays = len(truth)
    missed = int(np.count_nonzero((found.ids < 0) & (truth >= 0)))
    false_hits = int(np.count_nonzero((found.ids >= 0) & (truth < 0)))
    wrong = int(np.count_nonzero((found.ids >= 0) & (truth >= 0) & (found.ids != truth)))
    return RayErrors(
        kind=kind,
        reference=reference,
        rays=rays,
        hits=int(np.count_nonzero(truth >= 0)),
        missed=missed,
        false_hits=false_hits,
        wrong_triangles=wrong,
        missed_most=rate_most(missed, rays),
        false_hits_most=rate_most(false_hits, rays),
        wrong_triangles_most=rate_most(wrong, rays),
        distance=_distance_errors(ulps, distances, floor) if len(ulps) else None,
    )


def _distance_errors(ulps: F64, distances: F64, floor: float) -> DistanceErrors:
    return DistanceErrors(
        hits=len(ulps),
        **dict(zip(("median_ulps", "p999_ulps", "worst_ulps"), _ranked(ulps), strict=True)),
        **dict(zip(("median", "p999", "worst"), _ranked(distances), strict=True)),
        floor=floor,
    )


def _ranked(values: F64) -> list[float]:
    """Median, 99.9 % and worst: values that occur, never between two."""
    found: list[float] = np.quantile(values, (0.5, 0.999, 1.0), method="higher").tolist()
    return found
