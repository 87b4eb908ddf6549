"""What the process of a device says, JSON, a line each; and its order, a file."""

from __future__ import annotations

import msgspec

from clgrid.compare_record import CompareRow, RungFailure
from clgrid.driver_record import ArithmeticRecord, DriverRecord, SpeedRecord
from clgrid.record import DeviceRecord

Three = tuple[float, float, float]


class View(msgspec.Struct, frozen=True):
    """A ``Camera``."""

    eye: Three
    right: Three
    up: Three
    forward: Three
    fov: float
    fov_axis: str
    orthographic_height: float | None


class Order(msgspec.Struct, frozen=True, kw_only=True):
    """What a process is to do.

    Attributes
    ----------
    selector : str
        Of the whole device.
    units : int or None
        Compute units to use; None for all.
    number : int
        Of the device, for the names of files.
    scenes : list of str
        Files or built-in scenes.
    views : list of View
        One each.
    folder : str
        For arrays; see ``files``.
    accuracies, width, height, rays, repetitions, layout, density, resolution, max_memory, skipping, seed
        As of ``Plan``.
    """

    selector: str
    units: int | None
    number: int
    scenes: list[str]
    views: list[View]
    folder: str
    accuracies: tuple[str, ...]
    width: int
    height: int
    rays: int
    repetitions: int
    layout: str
    density: float | str
    resolution: tuple[int, int, int] | None
    max_memory: int | None
    skipping: bool
    seed: int


class Step(msgspec.Struct, tag="step", frozen=True):
    """What begins."""

    step: str


class Found(msgspec.Struct, tag="found", frozen=True):
    """The device."""

    device: DeviceRecord
    driver: DriverRecord
    units: int
    limited_by: str


class Arithmetic(msgspec.Struct, tag="arithmetic", frozen=True):
    """What it does with numbers."""

    arithmetic: list[ArithmeticRecord]


class Speed(msgspec.Struct, tag="speed", frozen=True):
    """What its smallest kernels reach."""

    speed: SpeedRecord


class Done(msgspec.Struct, tag="done", frozen=True):
    """A scene on a rung, whose arrays are in the folder."""

    scene: int
    row: CompareRow


class Failed(msgspec.Struct, tag="failed", frozen=True):
    """A scene that it could not do on a rung."""

    failure: RungFailure


class Refused(msgspec.Struct, tag="refused", frozen=True):
    """The device cannot be used."""

    error: str


class NoMemory(msgspec.Struct, tag="no memory", frozen=True):
    """There was not enough."""

    error: str


class Finished(msgspec.Struct, tag="finished", frozen=True):
    """All is done that could be."""

    compiled: tuple[str, ...]
    process_peak_bytes: int | None


class Ended(msgspec.Struct, tag="ended", frozen=True):
    """The process is gone; its exit code, negative for a signal."""

    code: int


Event = Step | Found | Arithmetic | Speed | Done | Failed | Refused | NoMemory | Finished | Ended

encode = msgspec.json.Encoder().encode
order_of = msgspec.json.Decoder(Order).decode
event_of = msgspec.json.Decoder(Event).decode
