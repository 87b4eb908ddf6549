"""Where two devices part on a ray: the cell, the triangle and the operation."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from clgrid.compare.files import Recipe
from clgrid.wavefront import Batch


@dataclass(frozen=True)
class Suspect:
    """A ray that two devices answer differently.

    Attributes
    ----------
    scene : str
        File or built-in scene.
    accuracy : str
        The rung.
    recipe : Recipe
        Of the grid.
    ray : Batch
        Of one ray: origin and direction (3,).
    devices : (str, str)
        Selectors.
    """

    scene: str
    accuracy: str
    recipe: Recipe
    ray: Batch
    devices: tuple[str, str]


def locate(suspect: Suspect, replays: Path) -> tuple[str, str]:
    """Where the two part, in words, and the file that replays it."""
    return "", ""
