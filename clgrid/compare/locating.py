"""Where two devices part on the first ray that they answer differently, and a file that replays it."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from clgrid.errors import ClgridError
from clgrid.locate import Side, locate, write_repro
from clgrid.repro_record import NONE, ReproGrid, ReproRay
from clgrid.scene import load_scene
from clgrid.wavefront import Batch

Sides = Callable[[str], Side]


@dataclass(frozen=True)
class Replays:
    """How differing rays are looked into.

    Attributes
    ----------
    folder : Path
        For the files that replay them.
    side : callable
        Of a selector: the device as it was compared.
    """

    folder: Path
    side: Sides = Side.here

    def of(self, scene: str, grid: ReproGrid, ray: Batch, labels: tuple[str, str]) -> tuple[str, str]:
        """Where two devices part on a ray, in words, and the file that replays it.

        Why that could not be told, with no file, where it could not.

        Parameters
        ----------
        scene : str
            File or built-in scene.
        grid : ReproGrid
            Of a strict rung.
        ray : Batch
            Of one ray: origin and direction (3,).
        labels : (str, str)
            Selectors of the devices.
        """
        first, second = labels
        path = self.folder / f"{_plain(scene)}.{grid.accuracy}.{_plain(first)}.{_plain(second)}.repro.json"
        try:
            finding = locate(
                load_scene(scene).mesh,
                grid,
                ReproRay.of(ray.origins, ray.directions, 0.0, ray.t_max),
                (self.side(first), self.side(second)),
            )
            if finding.located.kind == NONE:
                return "alone, the ray is answered alike", ""
            write_repro(path, finding)
        except ClgridError as error:
            return f"not located: {error}", ""
        return finding.located.where, str(path)


def _plain(name: str) -> str:
    """A name for a file: of a path its last part, without the endings of mesh files."""
    last = name.replace("\\", "/").rsplit("/", 1)[-1] if "." in name else name
    return re.sub(r"[^\w.-]+", "-", re.sub(r"(\.gz|\.[A-Za-z]+)+$", "", last))
