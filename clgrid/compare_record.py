"""The JSON record of ``clgrid compare``."""

from __future__ import annotations

import msgspec

from clgrid.driver_record import ArithmeticRecord, DriverRecord, SpeedRecord
from clgrid.record import DeviceRecord, Failure, Header, HostRecord

COMPLETED, REFUSED, CRASHED, HUNG, OUT_OF_MEMORY = "completed", "refused", "crashed", "hung", "out of memory"
STATUSES = (COMPLETED, REFUSED, CRASHED, HUNG, OUT_OF_MEMORY)


class CompareRays(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The rays of one kind on one device.

    Attributes
    ----------
    kind : str
        ``primary``; ``shadow``: from their hits to a light; ``incoherent``: from there anywhere, as light is
        spread; ``structured``: at vertices, along edges, in planes, from afar.
    hits : int
    cast_s : list of float
        Seconds of the casts from host arrays to host arrays, one entry a repetition.
    mrays_per_s : float
        Millions a second, by the median.
    digest : str
        Of every bit of t, id, u and v.
    """

    kind: str
    rays: int
    hits: int
    cast_s: list[float]
    mrays_per_s: float
    digest: str


class CompareRow(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One scene on one rung on one device: seconds, one entry a repetition; sizes in bytes.

    Attributes
    ----------
    density : float
        Cells per triangle, as built.
    parts : int
        Grids that the mesh was split over for the sake of the device's largest buffer.
    nbytes : dict of str to int
        Of the grid by array.
    peak_bytes : int
        Most device bytes that the build held at once.
    first_compile_s : list of float
        What the first kernels took: from the driver's or clgrid's cache, if they are there.
    build_s, build_stages_s
        Wall time from host arrays to the finished grid, and its parts by name.
    grid_digests : dict of str to str
        Of every byte, by array; of further parts ``NAME/PART``.
    image_hits : int
        Pixels that show the mesh.
    image_digest : str
        Of every bit of colours and ids.
    self_test : str
        What the device fails in the self-test of the rung, which other verbs therefore refuse; empty if
        nothing.
    """

    scene: str
    triangles: int
    accuracy: str
    layout: str
    skipping: bool
    density: float
    resolution: tuple[int, int, int]
    cells: int
    references: int
    parts: int
    nbytes: dict[str, int]
    grid_bytes: int
    bytes_per_triangle: float
    peak_bytes: int
    load_s: list[float]
    first_compile_s: list[float]
    build_s: list[float]
    build_stages_s: dict[str, list[float]]
    grid_digests: dict[str, str]
    kinds: list[CompareRays]
    render_s: list[float]
    image_hits: int
    image_digest: str
    self_test: str
    warnings: tuple[str, ...] = ()


class RungFailure(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A scene that a device could not do on a rung, and why; the device went on."""

    scene: str
    accuracy: str
    error: str


class CompareDevice(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One device, in a process of its own.

    Attributes
    ----------
    label : str
        Unique in the record, and its selector: ``intel``; with a number of compute units ``pocl-3.0/1``.
    units : int
        Compute units used.
    limited_by : str
        How, where those are not all: ``fission`` (a sub-device) or ``affinity`` (of the process).
    status : str
        ``completed``; ``refused``: the device or its compiler say that they cannot; ``crashed``, ``hung``
        (beyond the time limit), ``out of memory``.
    reason : str
        How it ended, in words; empty if it completed.
    last_words : str
        The last line that the process wrote to stderr; empty if it completed or said nothing.
    step : str
        What it was doing then: ``load SCENE``, ``build robust of SCENE``; empty if it completed.
    seconds : list of float
        Of the whole process.
    driver, speed : None
        Where it ended before that was known.
    arithmetic : list of ArithmeticRecord
        Empty likewise.
    compiled : tuple of str
        Every kernel file built, with its ``-D`` options.
    process_peak_bytes : int or None
        Most memory that the process held at once.
    rows : list of CompareRow
        Scenes, rungs in each.
    failures : list of RungFailure
    """

    label: str
    device: DeviceRecord
    units: int
    limited_by: str
    status: str
    reason: str
    last_words: str
    step: str
    seconds: list[float]
    driver: DriverRecord | None
    arithmetic: list[ArithmeticRecord]
    speed: SpeedRecord | None
    compiled: tuple[str, ...]
    process_peak_bytes: int | None
    rows: list[CompareRow]
    failures: list[RungFailure]


class RayDifferences(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How the hits of one kind of rays differ between two devices; numbers of rays.

    Attributes
    ----------
    differing : int
        In any bit of t, id, u or v.
    id, t, u, v : int
        In that; a ray may count in several.
    only_first, only_second : int
        Hits of one device that are misses of the other.
    t_ulps, u_ulps, v_ulps : float
        The largest difference where both hit the same triangle, in last places of the rung's arithmetic:
        float32 on fast and robust, else float64.
    """

    kind: str
    rays: int
    differing: int
    id: int
    t: int
    u: int
    v: int
    only_first: int
    only_second: int
    t_ulps: float
    u_ulps: float
    v_ulps: float


class ImageDifferences(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How two pictures differ.

    Attributes
    ----------
    pixels : int
        Of the picture.
    differing : int
        Pixels that differ in a bit of colour or coverage.
    ids : int
        Pixels that show another triangle.
    largest, mean : float
        Of the absolute differences of linear colour, over all channels.
    psnr : float or None
        Decibels to a signal of 1; None for equal pictures.
    perceptual, largest_perceptual : float or None
        Mean and maximum of ``measure``; None where it could not be computed.
    measure : str
        ``FLIP`` (of OpenImageIO, 0 to 1, for 67 pixels a degree).
    """

    pixels: int
    differing: int
    ids: int
    largest: float
    mean: float
    psnr: float | None
    perceptual: float | None
    largest_perceptual: float | None
    measure: str


class HeatMap(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Where in the picture two devices differ, coarsely: row by row from the top left.

    Attributes
    ----------
    width, height : int
        Blocks; at most 128 each.
    block : int
        Pixels along a side of a block; those at the right and at the bottom may have fewer.
    rays : list of int
        Primary rays that differ, by block.
    image : list of float
        The largest difference of linear colour, by block.
    """

    width: int
    height: int
    block: int
    rays: list[int]
    image: list[float]


class DifferingRay(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The first ray that differs.

    Attributes
    ----------
    kind : str
    index : int
        Among the rays of the kind.
    origin, direction : (str, str, str)
        Scene units, float64 in hexadecimal: ``float.fromhex`` gives every bit.
    t_min, t_max : str
        Likewise; ``inf`` without an end.
    differs : tuple of str
        Of ``id``, ``t``, ``u``, ``v``.
    first, second : str
        What the two devices answer.
    where : str
        Cell, triangle and operation in which they part; empty where that was not looked for.
    replay : str
        File that ``clgrid repro`` runs; empty without one.
    """

    kind: str
    index: int
    origin: tuple[str, str, str]
    direction: tuple[str, str, str]
    t_min: str
    t_max: str
    differs: tuple[str, ...]
    first: str
    second: str
    where: str = ""
    replay: str = ""


class ComparePair(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Two devices on one scene and rung.

    Attributes
    ----------
    first, second : str
        Labels of devices.
    promised : bool
        Whether the rung promises the same bits on both.
    grids : bool
        Whether the grids have the same bytes.
    arrays : tuple of str
        Arrays of the grids that differ.
    references : (int, int)
        Of the two grids.
    rays : list of RayDifferences
        By kind.
    image : ImageDifferences
    heat_map : HeatMap or None
        None where no primary ray and no pixel differs.
    ray : DifferingRay or None
        The first that differs; None if none does.
    equal : bool
        Whether grids, rays and pictures are the same, bit for bit.
    """

    scene: str
    accuracy: str
    first: str
    second: str
    promised: bool
    equal: bool
    grids: bool
    arrays: tuple[str, ...]
    references: tuple[int, int]
    rays: list[RayDifferences]
    image: ImageDifferences
    heat_map: HeatMap | None
    ray: DifferingRay | None


class CompareRecord(Header, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """``clgrid compare --json``; its ``device`` and ``compiled`` are those of the first that completed.

    Attributes
    ----------
    width, height : int
        Of the picture: a primary ray for each pixel.
    rays : int
        Of the kind ``structured``.
    time_limit : float
        Seconds for a device.
    devices : list of CompareDevice
        In the order in which they ran.
    pairs : list of ComparePair
        Of each scene and rung, every two devices that completed it.
    failures : list of Failure
        Scenes that could not be loaded, on any device.
    """

    host: HostRecord
    accuracies: tuple[str, ...]
    width: int
    height: int
    rays: int
    time_limit: float
    devices: list[CompareDevice]
    pairs: list[ComparePair]
    failures: list[Failure]
