"""Arrays on their way between processes: files in one folder, each under its name only when complete."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt

from clgrid.grid import Grid
from clgrid.hits import Hits
from clgrid.image import Image
from clgrid.wavefront import Batch

Arrays = dict[str, npt.NDArray[Any]]

KINDS = ("primary", "shadow", "incoherent", "structured")


class Recipe(msgspec.Struct, frozen=True):
    """The grid that all devices build."""

    layout: str
    density: float
    resolution: tuple[int, int, int] | None
    skipping: bool


@dataclass(frozen=True)
class Answers:
    """What a device answers on a rung of a scene.

    Attributes
    ----------
    t : dict of str to (N,) float64
        By kind of rays.
    ids : dict of str to (N,) uint32
        All bits set on a miss.
    uvs : dict of str to (N, 2) float32 or float64
    rgba : (h, w, 4) float32
    primitive_id : (h, w) uint32
    """

    t: Arrays
    ids: Arrays
    uvs: Arrays
    rgba: npt.NDArray[np.float32]
    primitive_id: npt.NDArray[np.uint32]

    @classmethod
    def of(cls, hits: dict[str, Hits], image: Image) -> Answers:
        """Of hits by kind, and a picture with its ids."""
        assert image.primitive_id is not None
        return cls(
            {kind: found.t_hit for kind, found in hits.items()},
            {kind: found.primitive_ids.astype(np.uint32) for kind, found in hits.items()},
            {kind: found.primitive_uvs for kind, found in hits.items()},
            image.rgba,
            image.primitive_id,
        )


@dataclass(frozen=True)
class Folder:
    """Where the arrays of a comparison are.

    Attributes
    ----------
    path : Path
    """

    path: Path

    def save_rays(self, scene: int, grid: Grid, batches: dict[str, Batch]) -> None:
        """Keep a scene's rays by kind, and how its grid is built."""
        arrays: Arrays = {}
        for kind, batch in batches.items():
            arrays |= {f"{kind}.o": batch.origins, f"{kind}.d": batch.directions}
            arrays[f"{kind}.t_max"] = np.array(batch.t_max)
        own = grid.recipe
        recipe = Recipe(own.layout, own.density, own.resolution, own.skipping)
        arrays["recipe"] = np.frombuffer(msgspec.json.encode(recipe), np.uint8)
        self._save(f"rays-{scene}", arrays)

    def rays(self, scene: int) -> tuple[Recipe, dict[str, Batch]] | None:
        """What ``save_rays`` kept; None if it did not yet."""
        arrays = self._load(f"rays-{scene}")
        if arrays is None:
            return None
        recipe = msgspec.json.decode(arrays["recipe"].tobytes(), type=Recipe)
        return recipe, {
            kind: Batch(kind, arrays[f"{kind}.o"], arrays[f"{kind}.d"], float(arrays[f"{kind}.t_max"]))
            for kind in KINDS
            if f"{kind}.o" in arrays
        }

    def save_answers(self, scene: int, accuracy: str, device: int, answers: Answers) -> None:
        """Keep what a device answers."""
        arrays: Arrays = {"rgba": answers.rgba, "primitive_id": answers.primitive_id}
        for name, by_kind in (("t", answers.t), ("id", answers.ids), ("uv", answers.uvs)):
            arrays |= {f"{kind}.{name}": array for kind, array in by_kind.items()}
        self._save(f"answers-{scene}-{accuracy}-{device}", arrays)

    def answers(self, scene: int, accuracy: str, device: int) -> Answers:
        """What ``save_answers`` kept."""
        arrays = self._load(f"answers-{scene}-{accuracy}-{device}")
        assert arrays is not None
        t, ids, uvs = (
            {kind: arrays[f"{kind}.{name}"] for kind in KINDS if f"{kind}.{name}" in arrays}
            for name in ("t", "id", "uv")
        )
        return Answers(t, ids, uvs, arrays["rgba"], arrays["primitive_id"])

    def _save(self, name: str, arrays: Arrays) -> None:
        partial = self.path / f"{name}.partial.npz"
        np.savez(partial, **arrays)  # type: ignore[arg-type]
        os.replace(partial, self.path / f"{name}.npz")

    def _load(self, name: str) -> Arrays | None:
        path = self.path / f"{name}.npz"
        if not path.is_file():
            return None
        with np.load(path) as stored:
            return dict(stored)
