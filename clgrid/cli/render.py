"""``clgrid render``: one picture of one scene."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from clgrid.cli import cameras, options, output
from clgrid.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable

    from clgrid.bench import Measurement
    from clgrid.grid import Grid
    from clgrid.image import Image
    from clgrid.record import Row

    Show = Callable[[str, float | None], None] | None

Outputs = Annotated[
    list[str],
    typer.Option(
        "--output",
        "-o",
        metavar="FILE",
        help="Picture to write, .exr or .png; may be given several times.",
        rich_help_panel=options.OUTPUT,
        show_default=False,
    ),
]
Aov = Annotated[
    str,
    typer.Option(
        metavar="NAMES",
        help="Further parts of the .exr: depth,normal,id,steps,t_err.",
        rich_help_panel=options.PICTURE,
        show_default=False,
    ),
]
Background = Annotated[
    str,
    typer.Option(
        metavar="COLOUR", help="Linear R,G,B, one grey, or #rrggbb.", rich_help_panel=options.PICTURE
    ),
]


def render(
    scene: options.SceneName,
    outputs: Outputs,
    size: options.Size = "1024x1024",
    aov: Aov = "",
    background: Background = "0.9",
    camera: cameras.CameraName = "",
    eye: cameras.Eye = "",
    look_at: cameras.LookAt = "",
    up: cameras.Up = "auto",
    fov: cameras.Fov = None,
    layout: options.Layout = "compact",
    density: options.Density = "auto",
    resolution: options.Resolution = "",
    accuracy: options.Accuracy = "robust",
    device: options.DeviceName = None,
    max_memory: options.MaxMemory = "",
    skipping: options.Skipping = False,
    json: options.Json = False,
    quiet: options.Quiet = False,
) -> None:
    """Render a picture of a scene."""
    width, height = options.parse_size(size)
    colour = options.parse_colour(background)
    memory = options.parse_bytes(max_memory)
    cells_per_triangle, cells = options.parse_density(density), options.parse_resolution(resolution)
    aovs = tuple(name for name in aov.split(",") if name)
    paths = [Path(name) for name in outputs]
    _check_outputs(paths, aovs)

    from clgrid.bench import Measurement, Work, load_timed
    from clgrid.device import choose
    from clgrid.renderer import render as draw

    chosen = choose(device)
    work = Work(
        width=width,
        height=height,
        layout=layout,
        density=cells_per_triangle,
        resolution=cells,
        accuracy=accuracy,
        max_memory=memory,
        skipping=skipping,
    )
    with output.progress(quiet=quiet) as show:
        _say(show, f"load {scene}")
        loaded, load_s = load_timed(scene)
        output.warn(loaded.mesh.warnings, quiet=quiet)
        view = cameras.choose_camera(loaded, width / height, camera, eye, look_at, up, fov)
        seen = Measurement(loaded, load_s, chosen)
        if loaded.mesh.triangle_count:
            _say(show, "compile")
            smooth = loaded.mesh.vertex_normals is not None
            seen.first_compile_s.append(work.warm_up(chosen, aovs, smooth=smooth))
        _say(show, "build")
        grid = seen.build(work, view)
        image = seen.render(
            lambda: draw(
                loaded,
                view,
                width,
                height,
                aovs,
                grid=grid,
                background=colour,
                progress=None if show is None else lambda share: show("render", share),
            )
        )
        row = seen.row(grid, image)
        save_s = _save(image, paths, row, show)
    _report(row, seen, grid, paths, save_s, json=json, quiet=quiet)


def _check_outputs(paths: list[Path], aovs: tuple[str, ...]) -> None:
    """Find out before any work what would fail after it."""
    from clgrid.image import check_output

    for path in paths:
        check_output(path)
    if aovs and not any(path.suffix.lower() == ".exr" for path in paths):
        raise InputError(f"--aov {','.join(aovs)}: only an .exr holds them; add -o NAME.exr")


def _say(show: Show, step: str) -> None:
    if show is not None:
        show(step, None)


def _save(image: Image, paths: list[Path], row: Row, show: Show) -> dict[str, float]:
    """Write the picture with its timings; return the seconds by file."""
    import time

    image.metadata["clgrid:load_s"] = row.load_s[0]
    image.metadata["clgrid:first_compile_s"] = sum(row.first_compile_s)
    image.metadata["clgrid:build_s"] = row.build_s[0]
    image.metadata["clgrid:time_to_image_s"] = row.time_to_image_s[0]
    taken = {}
    for path in paths:
        _say(show, f"write {path}")
        start = time.perf_counter()
        image.save(path)
        taken[str(path)] = time.perf_counter() - start
    return taken


def _report(
    row: Row,
    seen: Measurement,
    grid: Grid,
    paths: list[Path],
    save_s: dict[str, float],
    *,
    json: bool,
    quiet: bool,
) -> None:
    from clgrid import record

    device = seen.device
    if json:
        output.emit(
            record.encode(
                record.RenderRecord(
                    schema=record.schema("render"),
                    clgrid=record.version(),
                    device=record.describe_device(device),
                    compiled=record.describe_builds(device),
                    row=row,
                    outputs=tuple(map(str, paths)),
                    save_s=save_s,
                )
            )
        )
    elif not quiet:
        output.emit_pairs(_lines(row, grid, save_s))


def _lines(row: Row, grid: Grid, save_s: dict[str, float]) -> list[tuple[str, str]]:
    from clgrid.bench import rate

    build_s, render_s = row.build_s[0], row.render_s[0]
    stages = ", ".join(f"{name} {output.seconds(values[0])}" for name, values in row.build_stages_s.items())
    return [
        ("scene", f"{row.scene}, {row.triangles:,} triangles"),
        ("device", grid.device.description.line()),
        ("load", output.seconds(row.load_s[0])),
        ("first compile", output.seconds(sum(row.first_compile_s))),
        ("build", f"{output.seconds(build_s)}, {rate(row.triangles, [build_s]):.3g} Mtri/s ({stages})"),
        (
            "render",
            f"{output.seconds(render_s)}, {rate(row.rays, [render_s]):.3g} Mrays/s"
            f" ({row.width}x{row.height}, {row.hits:,} hits)",
        ),
        ("time to image", output.seconds(row.time_to_image_s[0])),
        (
            "grid",
            f"{output.size(row.grid_bytes)}, {row.bytes_per_triangle:.3g} bytes per triangle"
            f" ({'x'.join(map(str, row.resolution))} cells, {row.references:,} references,"
            f" {row.layout}, {row.accuracy}; peak {output.size(row.peak_bytes)})",
        ),
        *(("written", f"{path} in {output.seconds(taken)}") for path, taken in save_s.items()),
    ]
