"""``clgrid bench``: what scenes cost, in time and bytes."""

from __future__ import annotations

from statistics import median
from typing import TYPE_CHECKING, Annotated

import typer

from clgrid.cli import options, output

if TYPE_CHECKING:
    from clgrid.record import BenchRecord

Repetitions = Annotated[
    int, typer.Option("--reps", min=1, help="Timed turns of build and render, after one untimed.")
]


def bench(
    scenes: options.SceneNames,
    size: options.Size = "1024x1024",
    reps: Repetitions = 5,
    layout: options.Layout = "compact",
    density: options.Density = "auto",
    resolution: options.Resolution = "",
    accuracy: options.Accuracy = "robust",
    device: options.DeviceName = None,
    max_memory: options.MaxMemory = "",
    skipping: options.Skipping = False,
    json: options.Json = False,
    quiet: options.Quiet = False,
) -> int:
    """Measure build, render, time to image and bytes of scenes; medians in a table.

    A scene that fails is reported and does not stop the others; the exit code is then 1.
    """
    width, height = options.parse_size(size)
    cells_per_triangle, cells = options.parse_density(density), options.parse_resolution(resolution)
    memory = options.parse_bytes(max_memory)

    from clgrid import record
    from clgrid.bench import Work
    from clgrid.bench import bench as measure
    from clgrid.device import choose

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
    )
    chosen = choose(device)
    with output.progress(quiet=quiet) as show:
        result = measure(scenes, work, chosen, lambda name: None if show is None else show(name, None))
    if json:
        output.emit(record.encode(result))
    elif not quiet and result.rows:
        _emit_rows(result, chosen.description.line())
    for row in result.rows:
        output.warn(row.warnings, quiet=quiet)
    for failure in result.failures:
        typer.echo(f"clgrid: error: {failure.error}", err=True)
    return 1 if result.failures else 0


def _emit_rows(result: BenchRecord, device: str) -> None:
    from rich.table import Table

    from clgrid.bench import rate

    repetitions = len(result.rows[0].build_s)
    table = Table(title=f"{device}; medians of {repetitions}", title_justify="left", pad_edge=False)
    table.add_column("scene", overflow="fold")
    numbers = ("triangles", "load", "compile", "build", "Mtri/s", "render", "Mrays/s")
    for name in (*numbers, "time to image", "grid", "B/tri"):
        table.add_column(name, justify="right", no_wrap=True)
    for row in result.rows:
        table.add_row(
            row.scene,
            f"{row.triangles:,}",
            output.seconds(median(row.load_s)),
            output.seconds(sum(row.first_compile_s)),
            output.seconds(median(row.build_s)),
            f"{rate(row.triangles, row.build_s):.3g}",
            output.seconds(median(row.render_s)),
            f"{rate(row.rays, row.render_s):.3g}",
            output.seconds(median(row.time_to_image_s)),
            output.size(row.grid_bytes),
            f"{row.bytes_per_triangle:.3g}",
        )
    output.emit_table(table)
