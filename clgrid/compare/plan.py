"""What is compared: the options, checked, and the devices that a list of selectors means."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from clgrid.camera import Camera
from clgrid.description import Description
from clgrid.device import INSTALL, describe_all, described
from clgrid.errors import DeviceError, InputError
from clgrid.rungs import ACCURACIES
from clgrid.scene import Scene, default_camera

ALL = "all"
DEFAULT_TIME_LIMIT = 900.0


@dataclass(frozen=True)
class Plan:
    """What each device does.

    Attributes
    ----------
    accuracies : tuple of str
        Rungs.
    width, height : int
        Pixels; a primary ray for each.
    rays : int
        Of the kind ``structured``.
    repetitions : int
        Times that everything is timed, after one time that is not.
    layout, density, resolution, max_memory, skipping
        As for ``clgrid.build``. What is "auto" the first device chooses, for all.
    seed : int
        Of the rays.
    time_limit : float
        Seconds for a device.
    view : callable, optional
        Makes the camera for a scene and the picture's width over its height; by default that of
        ``clgrid.render``.

    Raises
    ------
    InputError
        If a rung is unknown or a number is out of range.
    """

    accuracies: tuple[str, ...] = ACCURACIES
    width: int = 512
    height: int = 512
    rays: int = 65536
    repetitions: int = 3
    layout: str = "compact"
    density: float | str = "auto"
    resolution: tuple[int, int, int] | None = None
    max_memory: int | None = None
    skipping: bool = False
    seed: int = 0
    time_limit: float = DEFAULT_TIME_LIMIT
    view: Callable[[Scene, float], Camera] | None = None

    def __post_init__(self) -> None:
        unknown = [name for name in self.accuracies if name not in ACCURACIES]
        if unknown or not self.accuracies:
            wrong = repr(unknown[0]) if unknown else "none"
            raise InputError(f"compare: accuracy is {wrong}; choose of {', '.join(ACCURACIES)}")
        if min(self.rays, self.repetitions) < 1 or self.seed < 0 or not self.time_limit > 0:
            raise InputError(
                "compare: give at least 1 ray and 1 repetition, a time limit above 0 and no seed below 0"
            )

    def camera(self, scene: Scene) -> Camera:
        """The camera that looks at the scene.

        Raises
        ------
        InputError
            If the scene has no such camera.
        """
        return (self.view or default_camera)(scene, self.width / self.height)


@dataclass(frozen=True)
class Part:
    """A device, or some of its compute units.

    Attributes
    ----------
    whole : Description
        The device.
    units : int or None
        Of its compute units; None for all.
    """

    whole: Description
    units: int | None = None

    @property
    def label(self) -> str:
        """A selector."""
        return self.whole.label if self.units is None else f"{self.whole.label}/{self.units}"


def parts_of(selectors: Sequence[str]) -> list[Part]:
    """The devices that are meant, each once: ``all`` are those that need not be named.

    Where that is but one, it is compared with one of its compute units.

    Raises
    ------
    DeviceError
        If there is no such device, or no device at all.
    InputError
        If none is named, or there is but one.
    """
    if not selectors:
        raise InputError("compare: no device is named; give all, or some of clgrid devices")
    found: dict[str, Part] = {}
    for selector in selectors:
        parts = _every() if selector.strip() == ALL else [Part(*described(selector))]
        found |= {part.label: part for part in parts}
    if not found:
        raise DeviceError(f"no OpenCL device for everyday use: {INSTALL}; clgrid doctor says more")
    if len(found) < 2:
        only = next(iter(found))
        raise InputError(f"compare: {only} alone is nothing to compare; name two: --devices {only},{only}/1")
    return list(found.values())


def _every() -> list[Part]:
    every = [Part(each) for each in describe_all() if each.implicit]
    alone = len(every) == 1 and every[0].whole.compute_units > 1
    return [*every, Part(every[0].whole, 1)] if alone else every
