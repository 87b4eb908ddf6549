"""The JSON record of ``clgrid tradeoff``."""

from __future__ import annotations

import msgspec

from clgrid.record import Header


class Spread(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A median and where it lies, in seconds.

    Attributes
    ----------
    low, high : float
        Ends of the interval of the median by order statistics: between them it lies with at least the
        record's ``confidence``, or as surely as so few repetitions allow.
    """

    median: float
    low: float
    high: float


class DistanceErrors(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Errors of t, over the rays whose hit is on the triangle of the reference.

    Attributes
    ----------
    hits : int
        So many rays.
    median_ulps, p999_ulps, worst_ulps : float
        Median, 99.9 % and worst, in units in the last place, as ``clgrid verify`` counts them: of float32 on
        the rungs fast and robust and else of float64; of the way through the mesh, if that is longer than t.
    median, p999, worst : float
        The same as distances along the ray, in scene units.
    floor : float
        What the reference may itself be off, in scene units, at worst: 0 for rational arithmetic. An error
        that is no larger says only that it is no larger.
    """

    hits: int
    median_ulps: float
    p999_ulps: float
    worst_ulps: float
    median: float
    p999: float
    worst: float
    floor: float


class RayErrors(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The answers of a point to rays of one kind, against one reference.

    Attributes
    ----------
    kind : str
        ``camera``: rays of the picture, chosen at random; ``structured``: those of ``clgrid verify``.
    reference : str
        ``exact rung`` or ``rational``.
    rays, hits : int
        Of them, so many hit by the reference.
    missed, false_hits, wrong_triangles : int
        Hits of the reference that are misses here; misses there that are hits here; other nearest triangles.
    missed_most, false_hits_most, wrong_triangles_most : float
        Upper bounds of their rates among rays of this kind, at the record's ``confidence``.
    distance : DistanceErrors or None
        None without a hit to compare.
    """

    kind: str
    reference: str
    rays: int
    hits: int
    missed: int
    false_hits: int
    wrong_triangles: int
    missed_most: float
    false_hits_most: float
    wrong_triangles_most: float
    distance: DistanceErrors | None


class PictureErrors(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A picture beside the reference: of the rung ``exact``, with the most samples of all points.

    Attributes
    ----------
    pixels : int
        Of the whole picture; each is compared.
    other_triangles : int
        Pixels that show another triangle, or one where the reference shows none, or none where it shows one.
    other_share, other_share_most : float
        Their share; its upper bound for other pictures like this one, at the record's ``confidence``.
    largest, rms : float
        Largest and root mean square difference of a linear colour channel.
    psnr : float or None
        Decibels below a white of 1; None where no channel differs.
    """

    pixels: int
    other_triangles: int
    other_share: float
    other_share_most: float
    largest: float
    rms: float
    psnr: float | None


class TradeoffRow(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One point of the sweep: seconds, one entry a repetition; sizes in bytes.

    Attributes
    ----------
    density : float
        As asked for: cells per triangle; of a nested layout, cells of subgrids per triangle in them.
    samples : int or None
        Rays a pixel of a shaded picture; None for a plain picture.
    peak_bytes : int
        Most device bytes that the build held at once.
    turns : list of int
        The turn of each repetition, a number in the record's ``slowness``: points of one turn were measured
        one after another.
    cost_s : Spread
        Seconds of a picture in the need's number of frames, once slow turns are taken out.
    errors : list of RayErrors
        Those of a rung whose answers no grid changes were measured once, through the grid of the reference.
    errors_of : int
        Number of the first row that has them.
    error, error_most : float or None
        By the need's measure, and its upper bound; None where it was not measured.
    refused : list of str
        Of ``error``, ``time``, ``memory``, what the point does not keep to; empty where it meets the need.
    on_front : bool
        No other point is as good in time, error and bytes and better in one of them.
    verify : str
        The command that counts the wrong answers to the structured rays anew.
    """

    accuracy: str
    layout: str
    density: float
    samples: int | None
    resolution: tuple[int, int, int]
    references: int
    grid_bytes: int
    bytes_per_triangle: float
    peak_bytes: int
    turns: list[int]
    build_s: list[float]
    render_s: list[float]
    time_to_image_s: list[float]
    cost_s: Spread
    picture: PictureErrors
    errors: list[RayErrors]
    errors_of: int
    error: float | None
    error_most: float | None
    refused: list[str]
    on_front: bool
    verify: str


class LeftOut(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A point that could not be built or drawn, and why."""

    accuracy: str
    layout: str
    density: float
    samples: int | None
    reason: str


class Need(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What the recommended point is to keep to.

    Attributes
    ----------
    measure : str
        What ``error`` means: ``pixels``, the share of pixels that show another triangle; ``rays``, the share
        of structured rays with a wrong answer; ``distance``, the worst error of t along the camera's rays, in
        scene units; ``rms``, of the picture's colours.
    max_error : float or None
        By that measure. None where only a time was asked for: the least error is then recommended.
    max_time_s : float or None
        Of a picture, its share of the build included.
    max_memory : int or None
        Bytes that the finished grid may have.
    frames : int
        Pictures of the mesh.
    rebuild : bool
        Whether the grid is rebuilt for each of them; else it is built once.
    stated : bool
        Whether any of it was asked for.
    """

    measure: str
    max_error: float | None
    max_time_s: float | None
    max_memory: int | None
    frames: int
    rebuild: bool
    stated: bool


class Recommendation(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The point to take.

    Attributes
    ----------
    row : int
        Its number among the rows.
    support : float
        Share of the resampled measurements (bootstrap over turns) from which the same point follows.
    rival : int or None
        The row that follows from most of the others.
    sentence : str
        What it is and why, in words.
    proven : bool
        Whether the upper bound of its error, too, keeps to ``max_error``.
    """

    row: int
    support: float
    rival: int | None
    sentence: str
    proven: bool


class ReferenceCheck(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The rung ``exact`` itself against rational arithmetic on the host.

    Attributes
    ----------
    rays : int
        Of both kinds together; as many as the budget allowed of ``asked``.
    wrong : int
        Other hits or triangles. Anything but 0 breaks the promise of the rung.
    wrong_most : float
        Upper bound of their rate, at the record's ``confidence``.
    late : int
        Hits whose t is farther from the exact one than t_err. Anything but 0 breaks the promise.
    rational_s : list of float
    """

    asked: int
    rays: int
    wrong: int
    wrong_most: float
    late: int
    rational_s: list[float]


class TradeoffRecord(Header, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """``clgrid tradeoff --json``.

    Attributes
    ----------
    size : float
        Longest side of the mesh's bounds, scene units.
    max_rounding : float
        The largest change of a coordinate by its one rounding to local float32, scene units.
    clock : str
        ``wall``, or ``cpu``: of the process on all processors.
    auto_layout, auto_density
        What "auto" would build for this picture.
    aim : (int, int, int)
        Resolution of the grid at whose planes and corners the structured rays are aimed.
    rays : int
        Of each kind.
    confidence : float
        Of intervals and upper bounds.
    margin : float
        Times of two points that differ by no more than this share count as equal.
    fast_pays : float
        The least share of the time that ``fast`` must save to be recommended.
    methods : dict of str to str
        How intervals, bounds, front and choice are made, a sentence each.
    budget_s : float
        Seconds that measuring may take, beside loading and compiling.
    spent_s : dict of str to list of float
        Seconds of each part of the run.
    left_out : list of LeftOut
    slowness : list of float
        By which factor each turn was slower than the middle one: a repetition's seconds over that of its turn
        are as if all turns had been alike.
    front : list of int
        Numbers of rows, by cost.
    recommendation : Recommendation or None
        None where no point meets the need; ``nearest`` then says what would.
    nearest : str
        Empty where there is a recommendation.
    broken : list of str
        Promises of rungs that the run saw broken, a line each.
    """

    scene: str
    source: str
    triangles: int
    size: float
    max_rounding: float
    width: int
    height: int
    eye: tuple[float, float, float]
    clock: str
    auto_layout: str
    auto_density: float
    aim: tuple[int, int, int]
    rays: int
    confidence: float
    margin: float
    fast_pays: float
    methods: dict[str, str]
    budget_s: float
    load_s: list[float]
    first_compile_s: list[float]
    spent_s: dict[str, list[float]]
    need: Need
    rows: list[TradeoffRow]
    left_out: list[LeftOut]
    reference: ReferenceCheck
    slowness: list[float]
    front: list[int]
    recommendation: Recommendation | None
    nearest: str
    broken: list[str]
    process_peak_bytes: int | None
    warnings: tuple[str, ...] = ()
