"""What scripts/peers found out: medians over rounds, and whether all saw the same."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

# A ray in so many may meet an edge that others miss.
_EDGE_RAYS, _FEWEST = 16_384, 4
# Shadow rays start next to a surface, at a place that each peer rounds in its own way.
_SHADOW_RAYS = 500
# t agrees to this share of itself, and this share of the longest side.
_OF_T, _OF_SIDE = 1e-3, 1e-5

CLGRID, EMBREE, GRID, PYTHON = "clgrid", "embree", "grid", "python"


@dataclass
class Result:
    """A library, or a variant of one, on one scene.

    Attributes
    ----------
    kind : str
        CLGRID, EMBREE or GRID (both in C++), or PYTHON.
    rounds : list of dict
        Seconds by name, of each round: build, primary, shadow, random, camera_cast.
    raw : list of dict
        Seconds of the repetitions of each round, where the peer tells.
    facts : dict
        Counts and bytes, the same in every round.
    failure : str
        Why there is nothing, in one line.
    differs : dict
        By name, how many rays (or the number of hits) are other than the first clgrid's.
    """

    kind: str
    name: str
    rounds: list[dict[str, float]] = field(default_factory=list)
    raw: list[dict[str, Any]] = field(default_factory=list)
    facts: dict[str, Any] = field(default_factory=dict)
    failure: str = ""
    differs: dict[str, int] = field(default_factory=dict)

    def seconds(self, *names: str) -> float | None:
        """Median over the rounds of the sum of the named; None where one of them was not measured."""
        sums = [sum(each[name] for name in names) for each in self.rounds if all(n in each for n in names)]
        return median(sums) if sums and not self.failure else None

    @property
    def time_to_image(self) -> float | None:
        """Seconds from arrays to a picture."""
        return self.seconds("build", "primary")

    @property
    def bytes_per_triangle(self) -> float | None:
        return self.facts.get("bytes_per_triangle") if not self.failure else None


@dataclass
class SceneResult:
    """All results on one scene."""

    name: str
    triangles: int
    pixels: int
    rays: int
    longest_side: float
    frames: int = 0
    results: list[Result] = field(default_factory=list)
    failure: str = ""

    def of(self, kind: str, part: str = "") -> list[Result]:
        """Results of a kind that have something to say, by part of the name, or start of a Python peer's."""
        return [
            each
            for each in self.results
            if each.kind == kind
            and (each.name.startswith(part) if kind == PYTHON else part in each.name)
            and not each.failure
        ]

    def least(self, results: Iterable[Result], *names: str) -> float | None:
        """The best median of all."""
        values = [each.seconds(*names) for each in results]
        return min((value for value in values if value is not None), default=None)

    @property
    def embrees_best(self) -> float | None:
        """Embree's time to image over all its variants."""
        return self.least(self.of(EMBREE), "build", "primary")

    def compare_counts(self) -> None:
        """Note how far counts are from those of the first clgrid."""
        clgrids = self.of(CLGRID)
        if not clgrids:
            return
        truth = clgrids[0].facts
        for result in self.results:
            for name in ("hits", "occluded", "random_hits"):
                if name in result.facts and name in truth and result is not clgrids[0]:
                    result.differs[name] = _difference(result.facts[name], truth[name])

    def compare_arrays(self, result: Result, path: Path, truth: Path) -> None:
        """Note how many rays have another answer: missed or hit alone, or at another t."""
        with np.load(path) as mine, np.load(truth) as theirs:
            for kind in ("camera", "random"):
                t, ids = mine[f"{kind}_t"].astype(np.float64), mine[f"{kind}_ids"]
                true_t, true_ids = theirs[f"{kind}_t"], theirs[f"{kind}_ids"]
                hit, true_hit = ids >= 0, true_ids >= 0
                both = hit & true_hit
                off = np.zeros(len(t), bool)
                # NaN: a library that does not tell t.
                told = both & ~np.isnan(t)
                slack = _OF_T * np.abs(true_t[told]) + _OF_SIDE * self.longest_side
                off[told] = np.abs(t[told] - true_t[told]) > slack
                result.differs[f"{kind}_rays"] = int(np.count_nonzero((hit != true_hit) | off))
                result.differs[f"{kind}_ids"] = int(np.count_nonzero(both & (ids != true_ids)))

    def disagreements(self) -> list[str]:
        """Counts and rays that differ by more than edges explain; lines to print."""
        camera, random = (max(_FEWEST, rays // _EDGE_RAYS) for rays in (self.pixels, self.rays))
        limits = {
            "hits": camera,
            "camera_rays": camera,
            "random_hits": random,
            "random_rays": random,
            "occluded": max(_FEWEST, self.pixels // _SHADOW_RAYS),
        }
        return [
            f"{self.name}: {result.name}: {name.replace('_', ' ')} differ by {result.differs[name]:,},"
            f" more than {limit:,}"
            for result in self.results
            for name, limit in limits.items()
            if abs(result.differs.get(name, 0)) > limit
        ]

    def record(self) -> dict[str, Any]:
        """Everything, with the medians."""
        record = asdict(self)
        for each, result in zip(record["results"], self.results, strict=True):
            names = {name for taken in result.rounds for name in taken}
            each["median_s"] = {name: result.seconds(name) for name in sorted(names)}
            each["median_s"]["time_to_image"] = result.time_to_image
        return record


def _difference(mine: Any, truth: Any) -> int:
    """Of two counts; of two lists, the largest, with its sign."""
    if isinstance(mine, list):
        return max((a - b for a, b in zip(mine, truth, strict=True)), key=abs, default=0)
    return int(mine - truth)
