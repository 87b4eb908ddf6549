"""What is tuned by measurement, by kind of device; `scripts/tune` measures it anew.

None of it changes a hit or a byte of a grid.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from clgrid.device import Device


@dataclass(frozen=True)
class Tuning:
    """Numbers that decide how rays are cast.

    Attributes
    ----------
    widest_slice : int
        Cells of a slice that rays of a tile may spread over; else they go one by one.
    fewest_together : int
        Rays of a tile and a major axis that go through the grid together; fewer go one by one.
    remembered : int
        Triangles that a tile remembers not to test again; a power of two.
    herd : int
        Rays of a tile that take turns where they go alone.
    fewest_in_turns : int
        Triangles of a mesh from which on they do: where caches do not hold it.
    """

    widest_slice: int = 128
    fewest_together: int = 12
    remembered: int = 256
    herd: int = 16
    fewest_in_turns: int = 1 << 19

    @property
    def defines(self) -> dict[str, int | str]:
        """The options of kernels that cast tiles of rays: what differs from the numbers in cl/."""
        options: dict[str, int | str] = {
            "WIDEST_SLICE": f"{self.widest_slice}.0f",
            "FEWEST_TOGETHER": self.fewest_together,
            "REMEMBERED": f"{self.remembered}u",
        }
        usual = (_USUAL.widest_slice, _USUAL.fewest_together, _USUAL.remembered)
        own = (self.widest_slice, self.fewest_together, self.remembered)
        return {
            name: value
            for (name, value), mine, theirs in zip(options.items(), own, usual, strict=True)
            if mine != theirs
        }

    def turns(self, triangles: int) -> dict[str, int | str]:
        """The option with which rays that go alone through a mesh of so many triangles take turns."""
        return {"IN_TURNS": self.herd} if triangles >= self.fewest_in_turns else {}


_USUAL = Tuning()
# By the start of a device's label; the first that fits.
_TABLE = (
    ("intel", _USUAL),
    ("pocl", _USUAL),
    ("", _USUAL),
)
_tried: list[Tuning] = []


def tuning_of(device: Device) -> Tuning:
    """The numbers for a device."""
    return (
        _tried[-1] if _tried else next(tuning for start, tuning in _TABLE if device.label.startswith(start))
    )


@contextmanager
def tried(tuning: Tuning) -> Iterator[None]:
    """Within it, these numbers hold for every device."""
    _tried.append(tuning)
    try:
        yield
    finally:
        _tried.pop()
