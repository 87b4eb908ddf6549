"""One ray traced on a device: launched, and read back as records of bits."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from clgrid.cast import Defines, GridPart
from clgrid.errors import DeviceError
from clgrid.locate.stages import Stage
from clgrid.memory import Allocator
from clgrid.program import kernel
from clgrid.rays import Rays
from clgrid.target import DeviceMesh

Words = npt.NDArray[np.uint64]

# Words of a first try: a ray past some thousand triangles.
_ROOM = 1 << 16
# More are not read: 1 GiB.
_MOST_ROOM = 1 << 27


@dataclass(frozen=True)
class Record:
    """What a trace says of a cell, of a triangle, or of the ray as a whole.

    Attributes
    ----------
    stage : Stage
    item : int
        Cell or triangle.
    bits : tuple of int
        By value of the stage.
    """

    stage: Stage
    item: int
    bits: tuple[int, ...]


def trace(target: DeviceMesh, part: GridPart, ray: Rays) -> Words:
    """The words that cl/trace_ray.cl writes for one ray.

    Raises
    ------
    DeviceError
        If the ray meets more than is ever read.
    """
    room = _ROOM
    while True:
        words, used = _launch(target, part, ray, room)
        if used <= room:
            return words[:used]
        if used > _MOST_ROOM:
            raise DeviceError(f"{target.device.label}: the trace of this ray takes {used:,} words")
        room = used


def _launch(target: DeviceMesh, part: GridPart, ray: Rays, room: int) -> tuple[Words, int]:
    allocator, device = Allocator(target.device), target.device
    arrays = [ray.origins.reshape(-1, 3), ray.directions.reshape(-1, 3), ray.bounds]
    inputs = [allocator.upload(array) for array in arrays]
    words, used = np.zeros(room, np.uint64), np.zeros(1, np.uint32)
    outputs = [allocator.results(words), allocator.results(used)]
    defines: Defines = {"WITH_UVS": 1, "WITH_T_ERR": 1}
    defines["RAY_REAL"] = "float" if ray.origins.dtype == np.float32 else "double"
    every = {**defines, **part.defines, **target.rung.defines}
    arguments: list[Any] = [*part.arguments, *inputs, outputs[0], np.uint32(room), outputs[1]]
    kernel(device, "trace_ray.cl", "trace_ray", **every)(
        device.queue, (1,), (1,), target.frame_params, *arguments
    )
    allocator.bring_home(words, outputs[0])
    allocator.bring_home(used, outputs[1])
    return words, int(used[0])


def records(words: Words, stages: Mapping[int, Stage]) -> Iterator[Record]:
    """The records of a trace.

    Raises
    ------
    DeviceError
        If they are not such as the table has them.
    """
    flat = words.tolist()
    at = 0
    while at < len(flat):
        number, count = flat[at] & 0xFFFFFFFF, flat[at] >> 32
        stage = stages.get(number)
        if stage is None or count != len(stage.values) or at + 2 + count > len(flat):
            raise DeviceError(f"the trace is no trace: word {at} of {len(flat)} is {flat[at]:#x}")
        yield Record(stage, flat[at + 1], tuple(flat[at + 2 : at + 2 + count]))
        at += 2 + count
