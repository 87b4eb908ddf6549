"""How a grid is to be built: the options as checked, and what "auto" becomes on a mesh and a device."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from clgrid import calibrate, cost
from clgrid.camera import Camera
from clgrid.device import Device
from clgrid.errors import SMALLER_GRID, GridTooLargeError, InputError
from clgrid.estimate import sample
from clgrid.layouts import ALL_LAYOUTS
from clgrid.layouts.lists import NESTED
from clgrid.layouts.nested import DEFAULT_DENSITY as NESTED_DENSITY
from clgrid.layouts.nested import top_resolution, within_nest
from clgrid.layouts.planes import plane_params
from clgrid.mesh import Mesh
from clgrid.resolution import DEFAULT_DENSITY, by_density, checked, checked_density
from clgrid.rungs import ACCURACIES
from clgrid.target import MeshPart

AUTO = "auto"

Made = TypeVar("Made")


@dataclass(frozen=True)
class Recipe:
    """How a grid is built: the arguments of ``build`` that outlive it, as checked.

    Attributes
    ----------
    adapts : bool
        Whether rays that have little in common may have a finer grid built in its place (``adapted``).
    """

    layout: str
    density: float
    resolution: tuple[int, int, int] | None
    accuracy: str
    max_memory: int | None
    skipping: bool
    adapts: bool = False

    def params(self, part: MeshPart) -> npt.NDArray[np.void]:
        """The planes of the grid over a part of the mesh."""
        bounds = part.local_bounds
        extents = bounds[1] - bounds[0]
        if self.layout in NESTED:
            cells = within_nest(self.resolution or top_resolution(extents, part.count))
        else:
            cells = self.resolution or by_density(extents, part.count, self.density)
        return plane_params(bounds, cells, part.count, part.first)


def kinds(layout: str, skipping: bool | str) -> list[calibrate.Kind]:
    """What the options may become: one layout with or without skipping, or with "auto" several."""
    layouts = cost.LAYOUTS if layout == AUTO else (layout,)
    return [
        (each, skip)
        for each in layouts
        for skip in ((False, True) if skipping == AUTO else (skipping is True,))
    ]


@dataclass(frozen=True)
class Options:
    """The options of ``build``, checked; those that are "auto" are still open.

    Raises
    ------
    InputError
        Naming the first that is unknown or out of range.
    """

    layout: str
    density: float | str
    resolution: tuple[int, int, int] | None
    accuracy: str
    max_memory: int | None
    skipping: bool | str
    rays: int
    view: Camera | None = None
    adapt: bool = False

    def __post_init__(self) -> None:
        for name, value, known in (
            ("layout", self.layout, (*ALL_LAYOUTS, AUTO)),
            ("accuracy", self.accuracy, ACCURACIES),
            ("skipping", self.skipping, (True, False, AUTO)),
        ):
            if value not in known:
                raise InputError(f"{name} is {value!r}; choose one of {', '.join(map(str, known))}")
        if isinstance(self.density, str) and self.density != AUTO:
            raise InputError(f"density is {self.density!r}; give a number or 'auto'")
        if self.resolution is not None:
            object.__setattr__(self, "resolution", checked(self.resolution))
        if self.layout in NESTED and self.skipping is True:
            raise InputError(
                f"skipping is for grids whose cells are all of one size; {self.layout} needs none"
            )
        if self.rays < 0:
            raise InputError(f"rays is {self.rays}; give how many are expected, at least 0")

    def first_that_fits(
        self, mesh: Mesh, device: Device, attempt: Callable[[Recipe], Made]
    ) -> tuple[Made, cost.Choice | None]:
        """What ``attempt`` makes of the best recipe that it does not refuse, and what that was chosen from.

        Raises
        ------
        GridTooLargeError
            That of the smallest grid, if all are refused; of an open density with what to do then.
        """
        open_density = isinstance(self.density, str) and self.resolution is None
        if self.layout in NESTED:
            return attempt(self._settled()), None
        if not mesh.triangle_count or not (open_density or AUTO in (self.layout, self.skipping)):
            return attempt(self._settled()), None
        constants = calibrate.constants(device, kinds(self.layout, self.skipping))
        try:
            found = self.candidates(mesh, device)
            best, made = cost.first_that_fits(found, lambda one: attempt(self._recipe(one)))
        except GridTooLargeError as error:
            if not open_density:
                raise
            raise type(error)(self._no_density_fits(str(error))) from error
        return made, cost.Choice(tuple(found), best, self.rays, self.max_memory, constants)

    def _no_density_fits(self, refusal: str) -> str:
        """What is told, in place of a refusal, a caller who left the density open."""
        ways = [f"name a density below {cost.LADDER[0]:g}, the least that 'auto' tries"]
        ways += ["layout='hashed'"] if self.layout == "compact" else []
        ways += ["raise max_memory"] if self.max_memory is not None else []
        return f"{refusal.removesuffix(f'; {SMALLER_GRID}')}; {', or '.join(ways)}"

    def candidates(self, mesh: Mesh, device: Device) -> list[cost.Candidate]:
        """What the options may become on a mesh that has triangles, with estimates.

        Raises
        ------
        InputError, GridTooLargeError
            As ``cost.candidates``.
        """
        constants = calibrate.constants(device, kinds(self.layout, self.skipping))
        # Parallel rays are taken for rays from outside, as without a view.
        perspective = self.view is not None and self.view.orthographic_height is None
        seen = sample(mesh, view=self.view if perspective else None)
        return cost.candidates(seen, self._question(device), constants)

    def _settled(self) -> Recipe:
        """The recipe where nothing is left to choose, or nothing depends on it."""
        layout = cost.LAYOUTS[0] if self.layout == AUTO else self.layout
        usual = NESTED_DENSITY if layout in NESTED else DEFAULT_DENSITY
        density = usual if isinstance(self.density, str) else checked_density(self.density)
        skipping = self.skipping is True
        return Recipe(layout, density, self.resolution, self.accuracy, self.max_memory, skipping)

    def _recipe(self, one: cost.Candidate) -> Recipe:
        return Recipe(
            one.layout,
            one.density,
            self.resolution,
            self.accuracy,
            self.max_memory,
            one.skipping,
            self.adapt and self._all_open,
        )

    @property
    def _all_open(self) -> bool:
        """Whether nothing is fixed, and answers cannot tell which grid stands."""
        fixed = self.resolution is not None or not isinstance(self.density, str)
        return self.layout == self.skipping == AUTO and not fixed and self.accuracy != "fast"

    def _question(self, device: Device) -> cost.Question:
        return cost.Question(
            kinds=tuple(kinds(self.layout, self.skipping)),
            densities=cost.LADDER if isinstance(self.density, str) else (self.density,),
            resolution=self.resolution,
            rays=self.rays,
            max_memory=self.max_memory,
            device_memory=device.description.global_memory,
            nested=self.layout == AUTO and isinstance(self.density, str) and self.resolution is None,
        )
