"""``clgrid bench``: what scenes cost, in time and bytes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Annotated

import typer

from clgrid import units
from clgrid.cli import cameras, options, output, report_files
from clgrid.errors import InputError

if TYPE_CHECKING:
    from rich.table import Table

    from clgrid.bench import Work
    from clgrid.device import Device
    from clgrid.record import BenchRecord, Failure, FramesRecord, WorkloadRecord

RAYS, MOTION = "Rays of renderers", "Moving meshes"

Repetitions = Annotated[
    int, typer.Option("--reps", min=1, help="Timed turns of all that is measured, after one untimed.")
]
WorkloadName = Annotated[
    str | None,
    typer.Option(
        "--workload",
        metavar="primary|shadow|diffuse|random",
        help="Cast these rays as arrays, and compare a sample with brute force: the camera's, one from each"
        " of their hits to a light, a path tracer's, or from all around to anywhere in the bounds. A"
        " difference is exit code 2.",
        rich_help_panel=RAYS,
        show_default=False,
    ),
]
Bounces = Annotated[
    int | None,
    typer.Option(help="Of each path of --workload diffuse. Default: 4.", rich_help_panel=RAYS),
]
Seed = Annotated[
    int | None, typer.Option(help="Of directions and samples. Default: 0.", rich_help_panel=RAYS)
]
Check = Annotated[
    int | None,
    typer.Option(
        metavar="RAYS", help="Compare so many rays with brute force. Default: 4096.", rich_help_panel=RAYS
    ),
]
Rays = Annotated[
    int | None,
    typer.Option(help="Of --workload random. Default: as many as --size has pixels.", rich_help_panel=RAYS),
]
FramesFile = Annotated[
    Path | None,
    typer.Option(
        "--frames",
        metavar="FILE.npy",
        help="Rebuild and draw the scene's triangles with the vertices of each frame: float32 of shape"
        " (frames, vertices, 3), gzipped or not.",
        rich_help_panel=MOTION,
        show_default=False,
    ),
]


def bench(
    scenes: options.SceneNames,
    workload: WorkloadName = None,
    bounces: Bounces = None,
    seed: Seed = None,
    check: Check = None,
    rays: Rays = None,
    frames: FramesFile = None,
    size: options.Size = "1024x1024",
    camera: cameras.CameraName = "",
    eye: cameras.Eye = "",
    look_at: cameras.LookAt = "",
    up: cameras.Up = "auto",
    fov: cameras.Fov = None,
    reps: Repetitions = 5,
    layout: options.Layout = "compact",
    density: options.Density = "auto",
    resolution: options.Resolution = "",
    accuracy: options.Accuracy = "robust",
    device: options.DeviceName = None,
    max_memory: options.MaxMemory = "",
    skipping: options.Skipping = False,
    html: report_files.Html = None,
    csv: report_files.Csv = None,
    plot: report_files.Plot = None,
    json: options.Json = False,
    quiet: options.Quiet = False,
) -> int:
    """Measure build, render, time to image and bytes of scenes; medians in a table.

    With --workload, the rates of a renderer's rays; with --frames, of a moving mesh. A scene that fails is
    reported and does not stop the others; the exit code is then 1.
    """
    width, height = options.parse_size(size)
    cells_per_triangle, cells = options.parse_density(density), options.parse_resolution(resolution)
    memory = options.parse_bytes(max_memory)
    given = {"--bounces": bounces, "--seed": seed, "--check": check, "--rays": rays}
    numbers = {name[2:]: value for name, value in given.items() if value is not None}
    _check_modes(scenes, workload, frames, numbers)
    written = report_files.Files(html, csv, plot)
    written.check()

    from clgrid.bench import Work

    work = Work(
        width=width,
        height=height,
        repetitions=reps,
        layout=layout,
        density=cells_per_triangle,
        resolution=cells,
        accuracy=accuracy,
        max_memory=memory,
        skipping=skipping,
        view=cameras.view_of(camera, eye, look_at, up, fov),
    )
    show = _Show(json=json, quiet=quiet, files=written)
    if workload is not None:
        return _bench_workload(scenes, workload, numbers, work, device, show)
    if frames is not None:
        return _bench_frames(scenes[0], frames, work, device, show)
    return _bench_scenes(scenes, work, device, show)


def _check_modes(
    scenes: Sequence[str], workload: str | None, frames: Path | None, numbers: dict[str, int]
) -> None:
    """Refuse options that would be ignored."""
    if workload is not None and frames is not None:
        raise InputError("bench: --workload and --frames are two measurements; give one of them")
    if frames is not None and len(scenes) != 1:
        raise InputError(f"bench: --frames moves one mesh; give one scene instead of {len(scenes)}")
    if workload is None and numbers:
        raise InputError(f"bench: --{next(iter(numbers))} belongs to --workload; give that too")
    for option, owner in (("bounces", "diffuse"), ("rays", "random")):
        if workload != owner and option in numbers:
            raise InputError(f"bench: --{option} belongs to --workload {owner}; leave it out")


class _Show:
    """Where results go: a table, one JSON document, or nothing."""

    def __init__(self, *, json: bool, quiet: bool, files: report_files.Files) -> None:
        self.json = json
        self.quiet = quiet
        self.files = files

    def result(self, result: BenchRecord | WorkloadRecord | FramesRecord, table: Callable[[], Table]) -> None:
        from clgrid import record

        result = output.signed(result)
        self.files.write(result)
        if self.json:
            output.emit(record.encode(result))
        elif not self.quiet and result.rows:
            output.emit_table(table())
            if result.process_peak_bytes is not None:
                output.emit(f"process memory at most {units.bytes_text(result.process_peak_bytes)}\n")

    def failures(self, failures: Sequence[Failure]) -> None:
        for failure in failures:
            typer.echo(f"clgrid: error: {failure.error}", err=True)

    def warnings(self, messages: Sequence[str]) -> None:
        output.warn(messages, quiet=self.quiet)


def _bench_scenes(scenes: Sequence[str], work: Work, device: str | None, show: _Show) -> int:
    from clgrid.bench import bench as measure
    from clgrid.device import choose

    chosen = choose(device)
    with output.progress(quiet=show.quiet) as step:
        result = measure(scenes, work, chosen, lambda name: None if step is None else step(name, None))
    show.result(result, lambda: _scene_table(result, chosen))
    for row in result.rows:
        show.warnings(row.warnings)
    show.failures(result.failures)
    return 1 if result.failures else 0


def _bench_workload(
    scenes: Sequence[str], name: str, numbers: dict[str, int], work: Work, device: str | None, show: _Show
) -> int:
    from clgrid.device import choose
    from clgrid.wavefront import Workload
    from clgrid.workload import bench_workloads, broken_promises

    workload = Workload(name, **numbers)
    chosen = choose(device)
    with output.progress(quiet=show.quiet) as step:
        result = bench_workloads(
            scenes, workload, work, chosen, lambda scene: None if step is None else step(scene, None)
        )
    show.result(result, lambda: _workload_table(result, chosen))
    for row in result.rows:
        show.warnings(row.warnings)
    show.failures(result.failures)
    broken = broken_promises(result)
    for message in broken:
        typer.echo(f"clgrid: error: {message}", err=True)
    # A wrong answer is worse than a scene that could not be measured.
    return 2 if broken else 1 if result.failures else 0


def _bench_frames(scene: str, frames: Path, work: Work, device: str | None, show: _Show) -> int:
    from clgrid.device import choose
    from clgrid.frames import bench_frames

    chosen = choose(device)
    with output.progress(quiet=show.quiet) as step:
        result = bench_frames(
            scene, frames, work, chosen, lambda text: None if step is None else step(text, None)
        )
    show.result(result, lambda: _frame_table(result, chosen))
    show.warnings(result.warnings)
    return 0


def _table(device: Device, repetitions: int, name: str, numbers: Sequence[str]) -> Table:
    from rich.table import Table

    title = f"{device.description.line()}; medians of {repetitions}"
    table = Table(title=title, title_justify="left", pad_edge=False)
    table.add_column(name, overflow="fold")
    for number in numbers:
        table.add_column(number, justify="right", no_wrap=True)
    return table


def _scene_table(result: BenchRecord, device: Device) -> Table:
    from clgrid.bench import rate

    times = ("load", "compile", "build", "Mtri/s", "render", "Mrays/s", "time to image")
    table = _table(device, len(result.rows[0].build_s), "scene", ("triangles", *times, "grid", "B/tri"))
    for row in result.rows:
        table.add_row(
            row.scene,
            f"{row.triangles:,}",
            units.seconds(median(row.load_s)),
            units.seconds(sum(row.first_compile_s)),
            units.seconds(median(row.build_s)),
            f"{rate(row.triangles, row.build_s):.3g}",
            units.seconds(median(row.render_s)),
            f"{rate(row.rays, row.render_s):.3g}",
            units.seconds(median(row.time_to_image_s)),
            units.bytes_text(row.grid_bytes),
            f"{row.bytes_per_triangle:.3g}",
        )
    return table


def _workload_table(result: WorkloadRecord, device: Device) -> Table:
    numbers = ("rays of", "rays", "hits", "steps/ray", "cast", "Mrays/s", "grid", "peak", "differ")
    table = _table(device, len(result.rows[0].cast_s), "scene", numbers)
    for row in result.rows:
        for kind in row.kinds:
            table.add_row(
                row.scene,
                kind.kind,
                f"{kind.rays:,}",
                f"{kind.hits:,}",
                f"{kind.steps_per_ray:.1f}",
                units.seconds(median(kind.cast_s)),
                f"{kind.mrays_per_s:.3g}",
            )
        table.add_row(
            row.scene,
            "all",
            f"{row.rays:,}",
            f"{row.hits:,}",
            f"{row.steps_per_ray:.1f}",
            units.seconds(median(row.cast_s)),
            f"{row.mrays_per_s:.3g}",
            units.bytes_text(row.grid_bytes),
            units.bytes_text(row.peak_bytes),
            f"{row.differing} of {row.checked:,}" if row.checked else "not checked",
            end_section=True,
        )
    return table


def _frame_table(result: FramesRecord, device: Device) -> Table:
    numbers = ("build", "render", "time to image", "references", "grid", "hits")
    table = _table(device, len(result.rows[0].build_s), f"frame of {result.scene}", numbers)
    for row in result.rows:
        table.add_row(
            str(row.frame),
            units.seconds(median(row.build_s)),
            units.seconds(median(row.render_s)),
            units.seconds(median(row.time_to_image_s)),
            f"{row.references:,}",
            units.bytes_text(row.grid_bytes),
            f"{row.hits:,}",
            end_section=row is result.rows[-1],
        )
    seen = result.medians
    table.add_row(
        "median of all",
        units.seconds(seen.build_s),
        units.seconds(seen.render_s),
        units.seconds(seen.time_to_image_s),
        f"{median(row.references for row in result.rows):,.0f}",
        units.bytes_text(median(row.grid_bytes for row in result.rows)),
        f"{median(row.hits for row in result.rows):,.0f}",
    )
    return table
