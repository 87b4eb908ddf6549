"""Which grid suits rays that go alone, and what they gain by it: estimated, before it is built.

A tile's rays share cells and lists, so that a coarse grid draws as fast as a fine one and is built sooner. A
ray that goes alone takes ``ray + cell * steps + batch * batches``: steps grow with the density, or hardly do
where empty space is leapt over, and batches fall with it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from clgrid import calibrate, cost
from clgrid.device import Device
from clgrid.errors import GridTooLargeError
from clgrid.estimate import Sample, Work, estimates, leaping, sample
from clgrid.layouts.lists import NESTED
from clgrid.mesh import Mesh
from clgrid.recipe import AUTO, Recipe, kinds
from clgrid.resolution import by_density

LADDER = (0.5, 0.71, 1.0, 1.26, 1.59, 2.0, 2.52, 3.17, 4.0, 5.04, 6.35, 8.0)
"""Densities of the grids in question: near the bound of bytes, small steps count."""

MOST_BYTES = 20
"""Bytes of the finer grid by estimate, for each triangle: a quarter of what a fast hierarchy takes."""

# Share of the time of a ray on the grid that stands, below which another is worth its build: estimates of two
# grids differ by up to a tenth more or less than measured ones do.
_WORTH = 0.85

# Seconds of a ray that goes alone, on a device on which a reference costs a tile what it typically does: in
# any case, a cell looked at, a batch of eight triangles. Fitted to random rays through six scenes on a device
# 2.5 times as slow (docs/performance.md, "Rays that pay for a finer grid").
_RAY_S, _BATCH_S = 7.6e-8, 1.8e-8
_STEP_S = {
    ("compact", False): 2e-9,
    ("compact", True): 2e-9,
    ("hashed", False): 3.2e-9,
    ("hashed", True): 4e-9,
    ("nested", False): 3.2e-9,
}
# Batches in a nested grid, of those in a uniform one of a cell a triangle: counted 0.39 to 0.78.
_NESTED_BATCHES = 0.55


@dataclass(frozen=True)
class Plan:
    """A grid that suits rays that go alone.

    Attributes
    ----------
    recipe : Recipe
    build_s : float
        Seconds that it takes to build.
    saved_s : float
        Seconds that a ray takes less in it.
    """

    recipe: Recipe
    build_s: float
    saved_s: float


def plan(mesh: Mesh, device: Device, standing: Recipe, nbytes: int) -> Plan | None:
    """The best grid for rays that go alone, or None if the one that stands is nearly as good.

    A nested one is: it was chosen for a crowd, and has cells as small as the triangles in them.

    Parameters
    ----------
    mesh : Mesh
        With triangles.
    device : Device
    standing : Recipe
    nbytes : int
        Of the grid that stands, beside which the other is built.
    """
    if standing.layout in NESTED:
        return None
    constants = calibrate.constants(device, kinds(AUTO, AUTO))
    most = MOST_BYTES * mesh.triangle_count
    if standing.max_memory is not None:
        most = min(most, standing.max_memory - nbytes)
    asked = cost.Question(
        # Hashed ones of three times the density serve such rays as well, but pictures by a quarter worse.
        kinds=tuple(kind for kind in kinds(AUTO, AUTO) if kind[0] == "compact"),
        densities=LADDER,
        resolution=None,
        rays=0,
        max_memory=most,
        device_memory=device.description.global_memory - nbytes,
        nested=True,
    )
    seen = sample(mesh)
    speed = _speed(constants)
    before = ray_s(_work(seen, standing), standing.layout, standing.skipping, speed)
    try:
        found = cost.candidates(seen, asked, constants)
    except GridTooLargeError:
        return None  # a mesh of so many triangles that no finer grid's cells can be numbered
    return best(found, standing, before, speed)


def best(found: Sequence[cost.Candidate], standing: Recipe, before: float, speed: float) -> Plan | None:
    """The plan by which a ray takes least, of those that fit; None if none is worth it.

    Parameters
    ----------
    found : sequence of Candidate
    standing : Recipe
    before : float
        Seconds of a ray on the grid that stands.
    speed : float
        Of the device, as ``ray_s`` takes it.
    """
    plans = [
        Plan(
            replace(standing, layout=one.layout, density=one.density, skipping=one.skipping, adapts=False),
            one.build_s,
            before - ray_s(one.work, one.layout, one.skipping, speed),
        )
        for one in found
        if one.fits
    ]
    chosen = max(plans, key=lambda one: one.saved_s, default=None)
    return None if chosen is None or before - chosen.saved_s > _WORTH * before else chosen


def ray_s(work: Work, layout: str, skipping: bool, speed: float) -> float:
    """Seconds of a ray that goes alone, on a device so many times as slow as a typical one."""
    batches = _NESTED_BATCHES * work.batches if layout in NESTED else work.batches
    return speed * (_RAY_S + _STEP_S[layout, skipping] * work.steps + _BATCH_S * batches)


def _speed(constants: dict[calibrate.Kind, cost.Constants]) -> float:
    """How many times as slow as a typical device one of these constants is."""
    ratios = [found.cast[2] / calibrate.typical(kind).cast[2] for kind, found in constants.items()]
    return math.exp(float(np.mean(np.log(ratios))))


def _work(seen: Sample, standing: Recipe) -> Work:
    """Of the uniform grid that stands."""
    extents: npt.NDArray[np.float64] = seen.bounds[1] - seen.bounds[0]
    work = estimates(seen, [by_density(extents, seen.triangles, standing.density)])[0]
    return leaping(work) if standing.skipping else work
