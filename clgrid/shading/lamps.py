"""The lights of a picture, as kernels read them (cl/light_rays.cl)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgrid import structs
from clgrid.errors import InputError
from clgrid.look import Light, Look, Shading

_KINDS = {"directional": 0, "point": 1, "spot": 2}
# The least difference of a spot's cosines, as glTF has it.
_NARROWEST = 0.001


@dataclass(frozen=True)
class Lamp:
    """A light on its way to the device.

    Attributes
    ----------
    params : LightParams
    colour : 3 floats
        Linear, times intensity, over pi: what a surface of albedo 1 sends back of it.
    t_max : float
        Where a ray to it ends.
    """

    params: npt.NDArray[np.void]
    colour: tuple[float, float, float]
    t_max: float


def lamps_of(look: Look | None, shading: Shading) -> list[Lamp]:
    """All lights that are lit, in the order of the file, then the sun.

    Raises
    ------
    InputError
        If a light or the sun has no direction, or a number is not finite or negative.
    """
    lights = list(look.lights) if look is not None and shading.lights else []
    if shading.sun is not None:
        toward = tuple(-float(x) for x in shading.sun)
        lights.append(Light("directional", intensity=shading.sun_strength, direction=toward, name="sun"))  # type: ignore[arg-type]
    return [_lamp(light) for light in lights]


def _lamp(light: Light) -> Lamp:
    what = f"light {light.name!r}"
    colour = [float(c) * float(light.intensity) / math.pi for c in light.colour]
    if len(colour) != 3 or not all(0.0 <= c < math.inf for c in colour):
        raise InputError(f"{what}: colour times intensity is no three finite numbers from 0 on; correct it")
    direction = np.asarray(light.direction, np.float64)
    length = float(np.sqrt((direction * direction).sum()))
    if light.kind != "point" and not 0.0 < length < math.inf:
        raise InputError(f"{what}: direction {light.direction} has no length; give one")
    if light.kind != "directional" and not np.isfinite(light.position).all():
        raise InputError(f"{what}: position {light.position} is not finite; correct it")
    if not light.reach > 0.0:
        raise InputError(f"{what}: reach {light.reach} is not above 0; give inf for none")
    outer, inner = math.cos(light.outer_cone), math.cos(light.inner_cone)
    scale = 1.0 / max(_NARROWEST, inner - outer)
    params = structs.LIGHT.pack(
        position=light.position,
        direction=direction / length if light.kind != "point" else (0.0, 0.0, 0.0),
        reach=light.reach,
        spot_scale=scale,
        spot_offset=-outer * scale,
        kind=_KINDS[light.kind],
    )
    return Lamp(params, (colour[0], colour[1], colour[2]), math.inf if light.kind == "directional" else 1.0)
