"""``clgrid tradeoff``: what each rung, layout and density takes and gets wrong, and which to take."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from clgrid import units
from clgrid.cli import cameras, options, output, picture_options, report_files
from clgrid.errors import InputError

if TYPE_CHECKING:
    from rich.table import Table

    from clgrid.look import Shading
    from clgrid.tradeoff_record import LeftOut, RayErrors, TradeoffRecord, TradeoffRow

SWEEP, NEED, REFERENCE = "Sweep", "Need", "Reference"


def _sweep(flag: str, metavar: str, text: str) -> typer.models.OptionInfo:
    found: typer.models.OptionInfo = typer.Option(
        flag, metavar=metavar, help=text, rich_help_panel=SWEEP, show_default=False
    )
    return found


Accuracies = Annotated[str, _sweep("--accuracy", "NAMES", "Rungs, separated by commas. Default: all four.")]
Layouts = Annotated[str, _sweep("--layout", "NAMES", "Default: compact, hashed, nested, nested-hashed.")]
Densities = Annotated[
    str,
    _sweep(
        "--density",
        "NUMBERS",
        "Cells per triangle; of nested layouts, cells of subgrids per triangle. Default: 0.25,0.5,1,2,4.",
    ),
]
Samples = Annotated[
    str, _sweep("--samples", "NUMBERS", "Shaded pictures with so many rays a pixel, instead of plain ones.")
]
MaxError = Annotated[
    str,
    typer.Option(
        "--max-error",
        metavar="[MEASURE=]NUMBER",
        help="Largest error. By pixels: share that show another triangle, as exact shows it (the default, and"
        " 0); rays: share of structured rays with a wrong answer; distance: of t along the camera's rays, in"
        " scene units; rms: of colours.",
        rich_help_panel=NEED,
        show_default=False,
    ),
]
MaxTime = Annotated[
    str,
    typer.Option(
        "--max-time",
        metavar="TIME",
        help="Of a picture, its share of the build included: 20ms, 1.5s. Without --max-error, the least error"
        " within it is recommended.",
        rich_help_panel=NEED,
        show_default=False,
    ),
]
MaxMemory = Annotated[
    str,
    typer.Option(metavar="BYTES", help="Leave out larger grids: 500M, 2GiB, or bytes.", rich_help_panel=NEED),
]
Frames = Annotated[
    int, typer.Option("--frames", metavar="N", min=1, help="Pictures of the mesh.", rich_help_panel=NEED)
]
Rebuild = Annotated[
    bool,
    typer.Option(
        "--rebuild/--build-once", help="Whether the mesh moves between frames.", rich_help_panel=NEED
    ),
]
Budget = Annotated[
    float,
    typer.Option(
        "--budget",
        metavar="SECONDS",
        help="For measuring, beside loading and compiling.",
        rich_help_panel=REFERENCE,
    ),
]
Rays = Annotated[
    int,
    typer.Option(
        min=1,
        help="Of each kind, of the camera and structured, to compare with the rung exact.",
        rich_help_panel=REFERENCE,
    ),
]
Exact = Annotated[
    int,
    typer.Option(
        metavar="RAYS",
        min=0,
        help="Of each kind to compare with rational arithmetic, if the budget allows.",
        rich_help_panel=REFERENCE,
    ),
]
Seed = Annotated[int, typer.Option(min=0, help="Of rays, turns and samples.", rich_help_panel=REFERENCE)]
ClockName = Annotated[
    str,
    typer.Option(
        "--clock",
        metavar="wall|cpu",
        help="What time is: cpu is that of all processors together, steadier on a busy machine.",
        rich_help_panel=REFERENCE,
    ),
]


def tradeoff(
    scene: options.SceneName,
    accuracy: Accuracies = "",
    layout: Layouts = "",
    density: Densities = "",
    samples: Samples = "",
    max_error: MaxError = "",
    max_time: MaxTime = "",
    max_memory: MaxMemory = "",
    frames: Frames = 1,
    rebuild: Rebuild = False,
    budget: Budget = 120.0,
    rays: Rays = 100_000,
    exact: Exact = 2000,
    seed: Seed = 0,
    clock: ClockName = "wall",
    size: options.Size = "1024x1024",
    camera: cameras.CameraName = "",
    eye: cameras.Eye = "",
    look_at: cameras.LookAt = "",
    up: cameras.Up = "auto",
    fov: cameras.Fov = None,
    sun: picture_options.Sun = "",
    sun_strength: picture_options.SunStrength = None,
    sky: picture_options.Sky = "",
    occlusion_rays: picture_options.OcclusionRays = None,
    device: options.DeviceName = None,
    html: report_files.Html = None,
    csv: report_files.Csv = None,
    plot: report_files.Plot = None,
    json: options.Json = False,
    quiet: options.Quiet = False,
) -> int:
    """Measure speed against accuracy on a scene, and recommend a rung, layout and density.

    Each point is built and drawn in turns with the others; its pictures and answers are compared with those
    of the rung exact, and that with rational arithmetic. Exit code 2: a rung broke its promise.
    """
    width, height = options.parse_size(size)
    several = tuple(int(n) for n in options.parse_numbers(samples, "--samples", "1,4", whole=True))
    swept: dict[str, Any] = {
        "accuracies": _words(accuracy),
        "layouts": _words(layout),
        "densities": tuple(options.parse_numbers(density, "--density", "0.5,1,2")),
        "samples": several,
    }
    light = _shading(samples, seed, sun, sun_strength, sky, occlusion_rays)
    measure, error = _max_error(max_error)
    files = report_files.Files(html, csv, plot)
    files.check()

    from clgrid import record
    from clgrid.bench import load_timed
    from clgrid.device import choose
    from clgrid.tradeoff import Plan, Wish
    from clgrid.tradeoff import tradeoff as sweep

    wish = Wish(
        measure=measure or ("rms" if len(several) > 1 else "pixels"),
        max_error=error,
        max_time_s=options.parse_seconds(max_time, "--max-time"),
        max_memory=options.parse_bytes(max_memory),
        frames=frames,
        rebuild=rebuild,
    )
    plan = Plan(
        **{name: given for name, given in swept.items() if given},
        shading=light,
        wish=wish,
        width=width,
        height=height,
        view=lambda seen, aspect: cameras.choose_camera(seen, aspect, camera, eye, look_at, up, fov),
        rays=rays,
        exact=exact,
        seed=seed,
        budget_s=budget,
        clock=clock,
    )
    chosen = choose(device)
    with output.progress(quiet=quiet) as show:
        say = show or (lambda step, share: None)
        say(f"load {scene}", None)
        loaded, load_s = load_timed(scene)
        output.warn(loaded.mesh.warnings, quiet=quiet)
        result = output.signed(sweep(loaded, plan, chosen, say, source=scene, load_s=load_s))
    files.write(result)
    if json:
        output.emit(record.encode(result))
    elif not quiet:
        output.emit_table(_table(result, chosen.description.line()))
        output.emit("".join(f"{line}\n" for line in _lines(result)))
    for message in result.broken:
        typer.echo(f"clgrid: error: {message}", err=True)
    return 2 if result.broken else 0


def _words(text: str) -> tuple[str, ...]:
    return tuple(dict.fromkeys(word for word in text.split(",") if word))


def _shading(
    samples: str, seed: int, sun: str, sun_strength: float | None, sky: str, occlusion_rays: int | None
) -> Shading:
    """How shaded pictures are lit.

    Raises
    ------
    InputError
        If a number cannot be, or pictures are not shaded.
    """
    from clgrid.cli.render_many import shading_of
    from clgrid.look import Shading
    from clgrid.shading.order import check_shading

    given = {"sun": sun, "sun_strength": sun_strength, "sky": sky, "occlusion_rays": occlusion_rays}
    light = shading_of(given)
    if light and not samples:
        raise InputError(
            f"--{next(iter(light)).replace('_', '-')} lights shaded pictures; give --samples too"
        )
    shading = Shading(seed=seed, **light)
    check_shading(shading)
    return shading


def _max_error(text: str) -> tuple[str, float | None]:
    """Read ``[MEASURE=]NUMBER``; the empty text is no measure and no number.

    Raises
    ------
    InputError
        If it is not that.
    """
    if not text:
        return "", None
    measure, _, number = text.rpartition("=")
    try:
        return measure, float(number)
    except ValueError:
        raise InputError(f"--max-error {text!r}: give a number, or MEASURE=NUMBER as rays=1e-4") from None


_NUMBERS = ("build", "render", "time to image", "grid", "pixels", "PSNR")
_WRONG = ("missed", "false", "other", "of rays", "t off by")


def _table(result: TradeoffRecord, device: str) -> Table:
    from rich.table import Table

    title = (
        f"{result.scene}, {result.triangles:,} triangles, {result.width}x{result.height}; {device}\n"
        f"{len(result.rows)} points measured; of these the Pareto front of seconds, {result.need.measure} and"
        " bytes, and the fastest of each rung"
    )
    table = Table(title=title, title_justify="left", pad_edge=False)
    table.add_column("", no_wrap=True)
    table.add_column("point", no_wrap=True)
    numbers = (
        "build",
        "render",
        "time to image",
        "grid",
        "pixels",
        "PSNR",
        "missed",
        "false",
        "other",
        "t off by",
    )
    for name in numbers:
        table.add_column(name, justify="right", no_wrap=True)
    shown = sorted(_shown(result), key=lambda number: result.rows[number].cost_s.median)
    for number in shown:
        row = result.rows[number]
        table.add_row(_mark(result, number), *_cells(result, row))
    return table


def _shown(result: TradeoffRecord) -> set[int]:
    chosen = result.recommendation
    numbers = set(result.front) | ({chosen.row} if chosen else set())
    for accuracy in {row.accuracy for row in result.rows}:
        of_rung = [k for k, row in enumerate(result.rows) if row.accuracy == accuracy]
        numbers.add(min(of_rung, key=lambda k: result.rows[k].cost_s.median))
    return numbers


def _mark(result: TradeoffRecord, number: int) -> str:
    if result.recommendation is not None and number == result.recommendation.row:
        return ">"
    return "*" if number in result.front else ""


def _cells(result: TradeoffRecord, row: TradeoffRow) -> list[str]:
    from clgrid.tradeoff.words import named

    answers = next(each for each in row.errors if each.kind == "structured")
    return [
        named(row),
        units.seconds(_evened(result, row, row.build_s)),
        units.seconds(_evened(result, row, row.render_s)),
        f"{units.seconds(row.cost_s.median)} ({_interval(row)})",
        units.bytes_text(row.grid_bytes),
        f"{row.picture.other_triangles:,}",
        "same" if row.picture.psnr is None else f"{row.picture.psnr:.0f} dB",
        f"{answers.missed:,}",
        f"{answers.false_hits:,}",
        f"{answers.wrong_triangles:,}",
        f"{answers.rays:,}",
        _distance(row.errors),
    ]


def _evened(result: TradeoffRecord, row: TradeoffRow, seconds: list[float]) -> float:
    """The median, once slow turns are taken out."""
    from statistics import median

    return median(s / result.slowness[turn] for s, turn in zip(seconds, row.turns, strict=True))


def _interval(row: TradeoffRow) -> str:
    low, high = (f"{1e3 * value:.3g}" for value in (row.cost_s.low, row.cost_s.high))
    return f"{low} to {high}"


def _distance(errors: list[RayErrors]) -> str:
    """The worst error of t along the camera's rays, by rational arithmetic where the other cannot tell."""
    found = [each for each in errors if each.kind == "camera" and each.distance is not None]
    for each in found:
        assert each.distance is not None
        if each.distance.worst > each.distance.floor:
            return f"{each.distance.worst:.2g} ({each.distance.worst_ulps:.2g} ulp)"
    return "-" if not found or found[0].distance is None else f"< {found[0].distance.floor:.2g}"


def _lines(result: TradeoffRecord) -> list[str]:
    """What the table does not say: how it is to be read, and which point to take."""
    check = result.reference
    lines = [
        "* on the front; > recommended. Times: median and its interval at"
        f" {100 * result.confidence:.0f} %, ms, once slow turns are taken out.",
        f"pixels: of {result.rows[0].picture.pixels:,}, that show another triangle than exact. missed, false,"
        " other: of structured rays, against exact. t: worst along the camera's rays,"
        f" scene units; the longest side is {result.size:.4g}, and coordinates are rounded by at most"
        f" {result.max_rounding:.2g} once.",
        f"exact by rational arithmetic: {check.wrong:,} wrong of {check.rays:,} rays"
        f" (a rate below {check.wrong_most:.2g}), {check.late:,} t farther off than t_err.",
    ]
    lines += _left_out(result.left_out)
    chosen = result.recommendation
    if chosen is None:
        return [*lines, f"recommended: none; {result.nearest}"]
    lines.append(f"to count its wrong answers anew: {result.rows[chosen.row].verify}")
    return [*lines, f"recommended: {chosen.sentence} (support {100 * chosen.support:.0f} %)"]


def _left_out(left_out: list[LeftOut]) -> list[str]:
    """A line for each reason."""
    reasons: dict[str, list[str]] = {}
    for each in left_out:
        reasons.setdefault(each.reason, []).append(f"{each.accuracy} {each.layout} {each.density:g}")
    return [f"left out: {', '.join(points)}: {reason}" for reason, points in reasons.items()]
