"""The JSON records: what every verb prints with ``--json``.

Each record names its schema, clgrid's version, the device, the options compiled in and the seeds;
whatever was timed is a list with one entry a repetition.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TypeVar

import msgspec

import clgrid
from clgrid.device import Device
from clgrid.program import builds

Record = TypeVar("Record", bound=msgspec.Struct)


class DeviceRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The OpenCL device, as its driver reports it."""

    name: str
    driver: str
    platform: str


class HostRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The machine, and what runs on it beside the drivers.

    Attributes
    ----------
    processor : str
        Its model.
    cores : int
        Hardware threads that this process may use.
    system : str
        The operating system.
    memory : int or None
        Bytes; None where the system does not say.
    versions : dict of str to str
        Of Python, numpy, pyopencl and OpenImageIO.
    """

    processor: str
    cores: int
    system: str
    memory: int | None
    versions: dict[str, str]


class Header(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What every record begins with.

    Attributes
    ----------
    schema : str
        ``clgrid.VERB/N``; N grows when a field changes its meaning or goes.
    clgrid : str
        Version.
    device : DeviceRecord
        Where the kernels ran.
    compiled : tuple of str
        Every kernel file built in the process, with its ``-D`` options.
    seeds : dict
        Of every random choice; empty where nothing is random.
    command : tuple of str
        The words of the command line that repeats it; empty for a record made in Python.
    host : HostRecord or None
        The machine; None for a record made in Python.
    """

    schema: str
    clgrid: str
    device: DeviceRecord
    compiled: tuple[str, ...]
    seeds: dict[str, int] = {}
    command: tuple[str, ...] = ()
    host: HostRecord | None = None


class Row(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One grid over one scene, and what it took: seconds, one entry a repetition; sizes in bytes.

    Attributes
    ----------
    density : float
        Cells per triangle, as built.
    empty_share : float
        Share of cells without a triangle.
    load_factor : float
        Share of the hash table's slots in use; 0 for a layout without one.
    nbytes : dict of str to int
        Bytes of the grid by array.
    parts : int
        Grids that the mesh was split over for the sake of the device's largest buffer.
    peak_bytes : int
        Most device bytes that the build held at once.
    first_compile_s : list of float
        What the first kernels took, before anything else was timed.
    build_s, build_stages_s
        Wall time from host arrays to the finished grid, and its parts by name.
    hits : int
        Rays that hit a triangle.
    """

    scene: str
    triangles: int
    layout: str
    accuracy: str
    density: float
    resolution: tuple[int, int, int]
    references: int
    empty_share: float
    load_factor: float
    nbytes: dict[str, int]
    parts: int
    grid_bytes: int
    bytes_per_triangle: float
    peak_bytes: int
    load_s: list[float]
    first_compile_s: list[float]
    build_s: list[float]
    build_stages_s: dict[str, list[float]]
    render_s: list[float]
    time_to_image_s: list[float]
    width: int
    height: int
    rays: int
    hits: int
    device: str
    warnings: tuple[str, ...] = ()


class Failure(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A scene that could not be measured, and why."""

    scene: str
    error: str


class BenchHeader(Header, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What every record of ``clgrid bench`` begins with.

    Attributes
    ----------
    process_peak_bytes : int or None
        Most memory that the process held at once, from its start to the record: meshes, rays, pictures, the
        interpreter, and on CPU devices the buffers too. None where the system does not say.
    """

    process_peak_bytes: int | None


class BenchRecord(BenchHeader, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """``clgrid bench --json``."""

    rows: list[Row]
    failures: list[Failure]


class RayKind(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The rays of one kind in a workload.

    Attributes
    ----------
    kind : str
        ``primary``, ``shadow``, ``bounce K`` or ``random``.
    steps_per_ray : float
        Mean of ``Hits.steps``: cells, and with skipping empty bricks, that a ray looked at.
    cast_s : list of float
        Seconds of the casts from host arrays to host arrays, one entry a repetition; that the rays were
        made is not in it.
    mrays_per_s : float
        Millions a second, by the median.
    """

    kind: str
    rays: int
    hits: int
    steps_per_ray: float
    cast_s: list[float]
    mrays_per_s: float


class WorkloadRow(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The rays of a workload through one grid, by kind and in all; sizes in bytes.

    Attributes
    ----------
    bounces : int
        Of each path after its primary ray; 0 but for ``diffuse``.
    peak_bytes : int
        Most device bytes that the build held at once.
    skipping : bool
        Whether the grid has distances to leap by; they are in ``grid_bytes``.
    eye : (x, y, z)
        Of the camera, scene units; ``random`` rays do not start there.
    rays, hits, steps_per_ray, cast_s, mrays_per_s
        Of all kinds together, as in ``RayKind``.
    checked : int
        Size of the sample that was compared with brute force.
    differing : int
        How many of them differ in a bit of t, id, u or v.
    differing_share : float or None
        ``differing / checked``; None where nothing was checked.
    """

    scene: str
    triangles: int
    workload: str
    bounces: int
    layout: str
    accuracy: str
    density: float
    resolution: tuple[int, int, int]
    references: int
    grid_bytes: int
    bytes_per_triangle: float
    peak_bytes: int
    width: int
    height: int
    eye: tuple[float, float, float]
    skipping: bool
    kinds: list[RayKind]
    rays: int
    hits: int
    steps_per_ray: float
    cast_s: list[float]
    mrays_per_s: float
    checked: int
    differing: int
    differing_share: float | None
    device: str
    warnings: tuple[str, ...] = ()


class WorkloadRecord(BenchHeader, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """``clgrid bench --workload --json``."""

    rows: list[WorkloadRow]
    failures: list[Failure]


class FrameRow(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One frame of a moving mesh: seconds, one entry a repetition; sizes in bytes.

    Attributes
    ----------
    peak_bytes : int
        Most device bytes that this grid has held at once so far, in this frame or an earlier one.
    build_s : list of float
        Wall time from the frame's vertices on the host to its finished grid.
    """

    frame: int
    resolution: tuple[int, int, int]
    references: int
    grid_bytes: int
    peak_bytes: int
    build_s: list[float]
    render_s: list[float]
    time_to_image_s: list[float]
    hits: int


class FrameMedians(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Medians over all frames and repetitions."""

    build_s: float
    render_s: float
    time_to_image_s: float


class FramesRecord(BenchHeader, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """``clgrid bench --frames --json``.

    Attributes
    ----------
    frames : str
        The file.
    frames_bytes : int
        Of the sequence's host array.
    """

    scene: str
    frames: str
    frames_bytes: int
    triangles: int
    vertices: int
    layout: str
    accuracy: str
    width: int
    height: int
    rays: int
    load_s: list[float]
    first_compile_s: list[float]
    rows: list[FrameRow]
    medians: FrameMedians
    warnings: tuple[str, ...] = ()


class RenderRecord(Header, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """``clgrid render --json``."""

    row: Row
    outputs: tuple[str, ...]
    save_s: dict[str, float]


def schema(verb: str) -> str:
    """Return the schema that ``clgrid VERB --json`` writes; a mode of a verb is ``VERB.MODE``."""
    return f"clgrid.{verb}/1"


def describe_device(device: Device) -> DeviceRecord:
    """Return the record of a device."""
    return DeviceRecord(device.name, device.driver_version, device.platform)


def describe_builds(device: Device) -> tuple[str, ...]:
    """List the kernel files built on the device so far, each with its options.

    Sources that are not clgrid's own are told by their digest: ``CLGRID_KERNELS=1f2e...``.
    """
    return tuple(
        " ".join((built.file, *built.options, *([f"CLGRID_KERNELS={built.kernels}"] * bool(built.kernels))))
        for built in builds(device)
    )


def version() -> str:
    """Return clgrid's version."""
    return clgrid.__version__


def process_peak_bytes() -> int | None:
    """Return the most memory that this process has held at once; None where the system does not say.

    Linux hands ``ru_maxrss`` on from parent to child, so that a small process started by a large one would
    look large; the high-water mark of the address space is the process's own.
    """
    status = Path("/proc/self/status")
    lines = status.read_text().splitlines() if status.is_file() else []
    for line in lines:
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) << 10
    if sys.platform == "win32":
        return None
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak << 10


def encode(record: msgspec.Struct) -> str:
    """Write a record as one JSON document, indented, with a final newline."""
    return msgspec.json.format(msgspec.json.encode(record), indent=2).decode() + "\n"


def decode(text: str | bytes, kind: type[Record]) -> Record:
    """Read a record strictly: unknown or missing fields and wrong types are errors.

    Raises
    ------
    msgspec.ValidationError
        With the path of the field.
    """
    return msgspec.json.decode(text, type=kind)
