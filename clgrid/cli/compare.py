"""``clgrid compare``: the same work on several devices, and where their answers differ."""

from __future__ import annotations

import sys
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Annotated

import typer

from clgrid import units
from clgrid.cli import cameras, options, output, report_files

if TYPE_CHECKING:
    from rich.table import Table

    from clgrid.compare_record import CompareDevice, ComparePair, CompareRecord, CompareRow
    from clgrid.driver_record import ArithmeticRecord

RAYS, RUN = "Rays", "Run"

Devices = Annotated[
    str,
    typer.Option(
        "--devices",
        metavar="all|LIST",
        help="OpenCL devices, as --device of other verbs takes them, separated by commas; with /N behind,"
        " N of its compute units, which is threads on a CPU: intel,pocl-3.0,pocl-3.0/1. all: every device"
        " but simulators and Mesa's; where that is but one, it and one of its units.",
        rich_help_panel=options.GRID,
    ),
]
Accuracies = Annotated[
    str,
    typer.Option(
        "--accuracy",
        metavar="NAMES",
        help="Rungs of the accuracy ladder: fast,robust,precise,exact or some of them. Default: all.",
        rich_help_panel=options.GRID,
        show_default=False,
    ),
]
Rays = Annotated[
    int,
    typer.Option(
        min=1,
        help="At vertices, edges and faces; along edges, planes and cells; from afar; at random. The others"
        " follow from --size.",
        rich_help_panel=RAYS,
    ),
]
Seed = Annotated[int, typer.Option(min=0, help="Of the rays.", rich_help_panel=RAYS)]
Repetitions = Annotated[
    int,
    typer.Option(
        "--reps", min=1, help="Timed turns of all that is measured, after one untimed.", rich_help_panel=RUN
    ),
]
TimeLimit = Annotated[
    float,
    typer.Option(
        metavar="SECONDS", help="For each device, compiling included; then it is ended.", rich_help_panel=RUN
    ),
]
ReproFolder = Annotated[
    str,
    typer.Option(
        "--repro",
        metavar="FOLDER",
        help="Where the first ray is written on which a strict rung differs, for clgrid repro.",
        rich_help_panel=options.OUTPUT,
    ),
]


def compare(
    scenes: options.SceneNames,
    devices: Devices = "all",
    accuracy: Accuracies = "",
    size: options.Size = "512x512",
    rays: Rays = 65536,
    seed: Seed = 0,
    camera: cameras.CameraName = "",
    eye: cameras.Eye = "",
    look_at: cameras.LookAt = "",
    up: cameras.Up = "auto",
    fov: cameras.Fov = None,
    reps: Repetitions = 3,
    time_limit: TimeLimit = 900.0,
    layout: options.Layout = "compact",
    density: options.Density = "auto",
    resolution: options.Resolution = "",
    max_memory: options.MaxMemory = "",
    skipping: options.Skipping = False,
    repro: ReproFolder = ".",
    html: report_files.Html = None,
    csv: report_files.Csv = None,
    plot: report_files.Plot = None,
    json: options.Json = False,
    quiet: options.Quiet = False,
) -> int:
    """Build, cast and draw scenes on several devices: how fast each is, and where their answers differ.

    Each device runs in a process of its own: that it crashes, hangs or refuses is a result. Exit code 2: a
    rung that promises the same bits differs, or a device did not complete.
    """
    width, height = options.parse_size(size)
    cells_per_triangle, cells = options.parse_density(density), options.parse_resolution(resolution)
    memory = options.parse_bytes(max_memory)
    files = report_files.Files(html, csv, plot)
    files.check()

    from clgrid import record
    from clgrid.compare import Plan, broken_promises, unfinished
    from clgrid.compare import compare as run
    from clgrid.compare.locating import Replays
    from clgrid.errors import InputError
    from clgrid.rungs import ACCURACIES

    if not Path(repro).is_dir():
        raise InputError(f"--repro {repro}: no such folder; create it or choose another")
    plan = Plan(
        accuracies=tuple(dict.fromkeys(name.strip() for name in accuracy.split(",") if name.strip()))
        or ACCURACIES,
        width=width,
        height=height,
        rays=rays,
        repetitions=reps,
        layout=layout,
        density=cells_per_triangle,
        resolution=cells,
        max_memory=memory,
        skipping=skipping,
        seed=seed,
        time_limit=time_limit,
        view=cameras.view_of(camera, eye, look_at, up, fov),
    )
    selectors = [name for name in devices.split(",") if name.strip()]
    with output.progress(quiet=quiet) as show:
        result = run(
            scenes,
            selectors,
            plan,
            lambda step: None if show is None else show(step, None),
            replays=Replays(Path(repro)),
            words=("clgrid", *sys.argv[1:]),
        )
    files.write(result)
    if json:
        output.emit(record.encode(result))
    elif result.devices and not quiet:
        _emit(result)
    for each in result.devices:
        output.warn([line for row in each.rows for line in _self_test(each, row)], quiet=quiet)
    broken, left = broken_promises(result), unfinished(result)
    for message in [*(failure.error for failure in result.failures), *left, *broken]:
        typer.echo(f"clgrid: error: {message}", err=True)
    if result.devices and not any(each.rows for each in result.devices):
        return 3
    # A wrong answer is worse than a scene that could not be measured.
    return 2 if broken or left else 1 if result.failures else 0


def _self_test(device: CompareDevice, row: CompareRow) -> list[str]:
    return [f"{device.label}: {row.self_test}"] if row.self_test else []


def _emit(result: CompareRecord) -> None:
    output.emit_table(_device_table(result))
    scenes = dict.fromkeys(row.scene for each in result.devices for row in each.rows)
    for scene in scenes:
        output.emit("\n")
        output.emit_table(_scene_table(result, scene))
    for scene in scenes:
        pairs = [pair for pair in result.pairs if pair.scene == scene]
        if pairs:
            output.emit("\n")
            output.emit_table(_pair_table(scene, pairs))


def _table(title: str, first: str, numbers: tuple[str, ...]) -> Table:
    from rich.table import Table

    table = Table(title=title, title_justify="left", pad_edge=False)
    table.add_column(first, overflow="fold")
    for number in numbers:
        table.add_column(number, justify="right", overflow="fold")
    return table


def _device_table(result: CompareRecord) -> Table:
    from rich.text import Text

    table = _table(
        f"devices; {result.host.processor}, {result.host.cores} cores",
        "",
        tuple(each.label for each in result.devices),
    )
    for name, told in _OF_DEVICES:
        table.add_row(name, *(Text(told(each)) for each in result.devices))
    return table


def _driver(device: CompareDevice) -> str:
    return f"{device.device.platform}: {device.device.name}, {device.device.driver}"


def _units(device: CompareDevice) -> str:
    whole = device.driver.compute_units if device.driver else device.units
    return f"{device.units} of {whole} by {device.limited_by}" if device.limited_by else str(device.units)


def _memory(device: CompareDevice) -> str:
    if device.driver is None:
        return "-"
    return (
        f"{units.bytes_text(device.driver.global_memory)}, {units.bytes_text(device.driver.max_allocation)}"
    )


def _widths(device: CompareDevice) -> str:
    if device.driver is None:
        return "-"
    preferred, native = device.driver.preferred_widths, device.driver.native_widths
    return ", ".join(f"{preferred[name]} ({native[name]})" for name in ("float", "double"))


def _rounding(device: CompareDevice) -> str:
    if not device.arithmetic:
        return "-"
    wrong = [
        f"{each.type}: {each.wrong_quotients + each.wrong_roots:,} wrong, up to"
        f" {max(each.quotient_ulps, each.root_ulps)} ulp"
        for each in device.arithmetic
        if each.wrong_quotients or each.wrong_roots
    ]
    return "; ".join(wrong) or "correct"


def _of_all(device: CompareDevice, name: str) -> str:
    """What a probe says, once if it is the same of all types."""
    return _once([(each.type, getattr(each, name)) for each in device.arithmetic])


def _once(found: list[tuple[str, str]]) -> str:
    values = {value for _, value in found}
    if len(values) <= 1:
        return next(iter(values), "-")
    return ", ".join(f"{name} {value}" for name, value in found)


def _contraction(device: CompareDevice) -> str:
    free, forbidden = (_of_all(device, f"contracted{name}") for name in ("", "_when_forbidden"))
    return f"{free}, {forbidden}" if device.arithmetic else "-"


def _functions(device: CompareDevice) -> str:
    return f"{_of_all(device, 'mad')}, {_of_all(device, 'fma')}" if device.arithmetic else "-"


def _denormals(device: CompareDevice) -> str:
    def both(each: ArithmeticRecord) -> str:
        same = each.denormals_read == each.denormals_made
        return each.denormals_read if same else f"read {each.denormals_read}, made {each.denormals_made}"

    return _once([(each.type, both(each)) for each in device.arithmetic])


def _launch(device: CompareDevice) -> str:
    speed = device.speed
    return "-" if speed is None else units.seconds(median(speed.launch_s) / speed.launches)


def _bandwidth(device: CompareDevice) -> str:
    speed = device.speed
    if speed is None:
        return "-"
    moved = ((2, speed.copy_s), (1, speed.upload_s), (1, speed.download_s))
    return ", ".join(f"{times * speed.copied_bytes / median(taken) / 1e9:.3g}" for times, taken in moved)


def _peak(device: CompareDevice) -> str:
    return "-" if device.process_peak_bytes is None else units.bytes_text(device.process_peak_bytes)


_OF_DEVICES = (
    ("platform, device, driver", _driver),
    ("ended", lambda device: device.status),
    ("compute units", _units),
    ("memory, one buffer", _memory),
    ("lanes of float, double preferred (native)", _widths),
    ("quotients and roots", _rounding),
    ("a*b+c rounded once: allowed, forbidden", _contraction),
    ("rounded once: mad, fma", _functions),
    ("denormals", _denormals),
    ("a launch", _launch),
    ("GB/s: copy, upload, download", _bandwidth),
    ("process memory at most", _peak),
    ("in all", lambda device: units.seconds(device.seconds[0])),
)


def _scene_table(result: CompareRecord, scene: str) -> Table:
    rows = [(each, row) for each in result.devices for row in each.rows if row.scene == scene]
    one = rows[0][1]
    kinds = list(dict.fromkeys(kind.kind for _, row in rows for kind in row.kinds))
    cells = "x".join(map(str, one.resolution))
    title = f"{scene}: {one.triangles:,} triangles, {one.layout} {cells}; medians of {len(one.build_s)}"
    numbers = ("device", "compile", "build", "render", *(f"{kind} Mrays/s" for kind in kinds), "grid", "peak")
    table = _table(title, "accuracy", numbers)
    for accuracy in result.accuracies:
        own = [(each, row) for each, row in rows if row.accuracy == accuracy]
        for number, (each, row) in enumerate(own):
            rates = {kind.kind: f"{kind.mrays_per_s:.3g}" for kind in row.kinds}
            table.add_row(
                "" if number else accuracy,
                each.label,
                units.seconds(sum(row.first_compile_s)),
                units.seconds(median(row.build_s)),
                units.seconds(median(row.render_s)),
                *(rates.get(kind, "-") for kind in kinds),
                units.bytes_text(row.grid_bytes),
                units.bytes_text(row.peak_bytes),
                end_section=number == len(own) - 1,
            )
    return table


def _pair_table(scene: str, pairs: list[ComparePair]) -> Table:
    from rich.text import Text

    # All devices cast the same rays.
    kinds = {kind.kind: kind.rays for kind in pairs[0].rays}
    rays = (f"{kind}\nof {count:,}" for kind, count in kinds.items())
    of_image = (f"pixels\nof {pairs[0].image.pixels:,}", "largest", "PSNR", "FLIP")
    table = _table(
        f"{scene}: what differs", "accuracy", ("devices", "grids", *rays, "flips", "t ulps", *of_image)
    )
    last = None
    for pair in pairs:
        colour = "" if pair.equal else "red" if pair.promised else "yellow"
        of_kind = {each.kind: f"{each.differing:,}" for each in pair.rays}
        image = pair.image
        table.add_row(
            "" if pair.accuracy == last else pair.accuracy,
            Text(f"{pair.first}, {pair.second}", no_wrap=True),
            "same" if pair.grids else f"differ: {', '.join(pair.arrays)}",
            *(Text(of_kind.get(kind, "-"), style=colour) for kind in kinds),
            f"{sum(each.only_first + each.only_second for each in pair.rays):,}",
            f"{max((each.t_ulps for each in pair.rays), default=0.0):.3g}",
            f"{image.differing:,}",
            f"{image.largest:.3g}",
            "-" if image.psnr is None else f"{image.psnr:.1f} dB",
            "-" if image.perceptual is None else f"{image.perceptual:.2g}",
        )
        last = pair.accuracy
    return table
