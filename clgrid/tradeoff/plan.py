"""What a trade-off sweeps, and what the point that it recommends is to keep to."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from clgrid.camera import Camera
from clgrid.errors import InputError
from clgrid.layouts import ALL_LAYOUTS
from clgrid.look import Shading
from clgrid.rungs import ACCURACIES
from clgrid.scene import Scene, default_camera

LAYOUTS = ("compact", "hashed", "nested", "nested-hashed")
"""What is swept if nothing else is asked for: the historical layouts are slower and larger."""
DENSITIES = (0.25, 0.5, 1.0, 2.0, 4.0)
SIMPLICITY = ("compact", "hashed", "nested", "nested-hashed", "linked-list", "dynamic-array")
"""All layouts, the simplest first; those kept for comparison last."""
MEASURES = ("pixels", "rays", "distance", "rms")
CLOCKS = ("wall", "cpu")

_MOST_POINTS = 1000
_MOST_RAYS = 1 << 22
_SHARES = ("pixels", "rays")


class Point(NamedTuple):
    """One way to draw the picture; ``samples`` is None for a plain one."""

    accuracy: str
    layout: str
    density: float
    samples: int | None

    def words(self) -> str:
        """``robust, compact, density 1``."""
        drawn = "" if self.samples is None else f", {self.samples} samples"
        return f"{self.accuracy}, {self.layout}, density {self.density:g}{drawn}"


@dataclass(frozen=True)
class Wish:
    """What the recommended point is to keep to; attributes as of ``tradeoff_record.Need``.

    Raises
    ------
    InputError
        If a number is out of range or a measure unknown.
    """

    measure: str = "pixels"
    max_error: float | None = None
    max_time_s: float | None = None
    max_memory: int | None = None
    frames: int = 1
    rebuild: bool = False

    def __post_init__(self) -> None:
        if self.measure not in MEASURES:
            raise InputError(f"max_error: unknown measure {self.measure!r}; choose of {', '.join(MEASURES)}")
        error, seconds = self.max_error, self.max_time_s
        if error is not None and not 0 <= error < math.inf:
            raise InputError(f"max_error is {error:g}; give a number of at least 0")
        if error is not None and error > 1 and self.measure in _SHARES:
            raise InputError(f"max_error is {error:g}, but {self.measure} is a share; give at most 1")
        if seconds is not None and not 0 < seconds < math.inf:
            raise InputError(f"max_time is {seconds:g} s; give more than 0")
        if self.frames < 1:
            raise InputError(f"frames is {self.frames}; give at least 1")

    @property
    def least_error(self) -> bool:
        """Whether error is what is to be least: a time was asked for and no error."""
        return self.max_time_s is not None and self.max_error is None

    @property
    def allowed_error(self) -> float | None:
        """Largest error; 0 where nothing is asked of error or time."""
        return 0.0 if self.max_error is None and not self.least_error else self.max_error

    def cost_s(self, build_s: float, render_s: float) -> float:
        """Seconds of a picture, its share of the build included."""
        return render_s + (build_s if self.rebuild else build_s / self.frames)


@dataclass(frozen=True)
class Plan:
    """What is swept, and how long that may take.

    Attributes
    ----------
    accuracies, layouts : tuple of str
    densities : tuple of float
        Cells per triangle; of nested layouts, cells of subgrids per triangle in them.
    samples : tuple of int
        Rays a pixel of shaded pictures; none for plain ones.
    shading : Shading
        How shaded pictures are lit.
    wish : Wish
    width, height : int
    view : callable, optional
        Makes the camera for a scene and the picture's width over its height.
    rays : int
        Of each kind, whose answers are compared with those of the rung ``exact``.
    exact : int
        How many of each kind are compared with rational arithmetic, if the budget allows.
    seed : int
        Of rays and turns.
    budget_s : float
        Seconds for measuring, beside loading and compiling.
    clock : {"wall", "cpu"}
        By which time is measured: ``cpu`` is that of the process on all processors, steadier on a machine
        that is busy with other things.

    Raises
    ------
    InputError
        If a name is unknown, a number out of range, or the points are too many.
    """

    accuracies: tuple[str, ...] = ACCURACIES
    layouts: tuple[str, ...] = LAYOUTS
    densities: tuple[float, ...] = DENSITIES
    samples: tuple[int, ...] = ()
    shading: Shading = field(default_factory=Shading)
    wish: Wish = field(default_factory=Wish)
    width: int = 1024
    height: int = 1024
    view: Callable[[Scene, float], Camera] | None = None
    rays: int = 100_000
    exact: int = 2000
    seed: int = 0
    budget_s: float = 120.0
    clock: str = "wall"

    def __post_init__(self) -> None:
        _check_names("accuracy", self.accuracies, ACCURACIES)
        _check_names("layout", self.layouts, ALL_LAYOUTS)
        _check_names("clock", (self.clock,), CLOCKS)
        if not self.densities or not all(0 < each < math.inf for each in self.densities):
            raise InputError("tradeoff: give densities above 0, cells per triangle")
        if not all(each >= 1 for each in self.samples):
            raise InputError("tradeoff: give samples of at least 1")
        if not 1 <= self.rays <= _MOST_RAYS:
            raise InputError(f"tradeoff: {self.rays} rays; give 1 to {_MOST_RAYS:,}")
        if min(self.exact, self.seed) < 0 or not 0 < self.budget_s < math.inf:
            raise InputError("tradeoff: give no exact or seed below 0, and a budget above 0 s")
        count = len(list(self.points()))
        if count > _MOST_POINTS:
            raise InputError(f"tradeoff: {count:,} points; leave some out, at most {_MOST_POINTS:,} go")
        wish = self.wish
        if len(self.samples) > 1 and (wish.measure != "rms" or not (wish.max_error or wish.max_time_s)):
            raise InputError(
                "tradeoff: several samples differ in the noise of the picture; say how much is allowed,"
                " --max-error rms=0.01, with or without --max-time"
            )

    def points(self) -> Iterator[Point]:
        """All points, in order of rung, layout, density and samples."""
        for accuracy in ACCURACIES:
            for layout in SIMPLICITY:
                if accuracy in self.accuracies and layout in self.layouts:
                    for density in sorted(set(self.densities)):
                        for samples in sorted(set(self.samples)) or (None,):
                            yield Point(accuracy, layout, float(density), samples)

    def camera(self, scene: Scene) -> Camera:
        """The camera that looks at the scene.

        Raises
        ------
        InputError
            If the scene has no such camera.
        """
        return (self.view or default_camera)(scene, self.width / self.height)


def _check_names(what: str, given: Sequence[str], known: Sequence[str]) -> None:
    unknown = [name for name in given if name not in known]
    if unknown or not given:
        wrong = repr(unknown[0]) if unknown else "none"
        raise InputError(f"tradeoff: {what} is {wrong}; choose of {', '.join(known)}")
