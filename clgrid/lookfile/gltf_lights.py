"""Lights of glTF files (KHR_lights_punctual)."""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np

from clgrid.look import Light, LightKind
from clgrid.lookfile.gltf_materials import extension
from clgrid.meshfile.gltf_accessors import at
from clgrid.meshfile.gltf_nodes import Matrix, Placed
from clgrid.meshfile.gltf_schema import Gltf, Index, Lights, Record, Spot
from clgrid.meshfile.gltf_schema import Light as LightRecord

NAME = "KHR_lights_punctual"
_KINDS: dict[str, LightKind] = {"directional": "directional", "point": "point", "spot": "spot"}


class _Use(Record):
    light: Index


class Notes(Protocol):
    """Where warnings go."""

    def warn(self, what: str) -> None:
        """Note something."""


def lights_of(gltf: Gltf, placed: list[Placed], notes: Notes | None = None) -> tuple[Light, ...]:
    """Lights in the order of the nodes that hold them, in scene axes; without ``notes`` none is warned of.

    Raises
    ------
    MeshError
        If the extension is malformed or a node names a missing light.
    """
    table = extension(gltf.extensions, NAME, Lights, "file")
    found = []
    for place in placed:
        where = f"node {place.number}"
        use = extension(place.node.extensions, NAME, _Use, where)
        if use is not None:
            record = at([] if table is None else table.lights, use.light, "light", where)
            light = _light(record, place, notes)
            if light is not None:
                found.append(light)
    return tuple(found)


def _light(record: LightRecord, placed: Placed, notes: Notes | None) -> Light | None:
    """None, and a warning, for a light of which no sense can be made."""
    name = placed.node.name or record.name
    kind = _KINDS.get(record.type)
    direction = _unit(-placed.world[:3, 2])
    position = placed.world[:3, 3].tolist()
    colour = record.color or [1.0, 1.0, 1.0]
    numbers = [*position, *colour, record.intensity]
    if kind is None or not np.isfinite(numbers).all() or min(*colour, record.intensity) < 0:
        _leave_out(notes, f"{name!r} of type {record.type[:20]!r}, which is unknown or not finite")
        return None
    if direction is None and kind != "point":
        _leave_out(notes, f"{name!r}, whose node has no direction")
        return None
    spot = record.spot or Spot()
    outer = _within(spot.outer_cone_angle, math.pi / 2, math.pi / 4)
    reach = record.range if record.range is not None and record.range > 0 else math.inf
    return Light(
        kind=kind,
        colour=(colour[0], colour[1], colour[2]),
        intensity=record.intensity,
        position=(position[0], position[1], position[2]),
        direction=direction or (0.0, 0.0, -1.0),
        reach=reach,
        inner_cone=_within(spot.inner_cone_angle, outer, 0.0),
        outer_cone=outer,
        name=name,
    )


def _leave_out(notes: Notes | None, what: str) -> None:
    if notes is not None:
        notes.warn(f"left out: light {what}")


def _within(angle: float, most: float, usual: float) -> float:
    return min(max(angle, 0.0), most) if math.isfinite(angle) else usual


def _unit(vector: Matrix) -> tuple[float, float, float] | None:
    largest = float(np.abs(vector).max())
    if not 0 < largest < math.inf:
        return None
    scaled = vector / largest
    x, y, z = (scaled / math.sqrt(float((scaled * scaled).sum()))).tolist()
    # no negative zeros: they would differ without a difference
    return (x + 0.0, y + 0.0, z + 0.0)
