"""``clgrid render``: one picture of one scene; several of them go the way of ``clgrid batch``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from clgrid import units
from clgrid.cli import batch, cameras, options, output, picture_options, render_many
from clgrid.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable

    from clgrid.bench import Measurement
    from clgrid.grid import Grid
    from clgrid.image import Image
    from clgrid.look import Shading
    from clgrid.record import Row
    from clgrid.scene import Scene

    Show = Callable[[str, float | None], None] | None

Outputs = Annotated[
    list[str],
    typer.Option(
        "--output",
        "-o",
        metavar="FILE",
        help="Picture to write, .exr, .png or .jpg; may be given several times. Of several pictures a"
        " pattern: out/{scene}.{camera}.{frame:04d}.exr; also {folder}, {item}.",
        rich_help_panel=options.OUTPUT,
        show_default=False,
    ),
]
Aov = Annotated[
    str,
    typer.Option(
        metavar="NAMES",
        help="Further parts of the .exr: depth,normal,id,P,uv,albedo,coverage,steps,t_err.",
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


CameraNames = Annotated[
    list[str] | None,
    typer.Option(
        "--camera",
        metavar="NAME|INDEX|FILE.json|all",
        help="A camera of the glTF file, or of a camera file; may be given several times.",
        rich_help_panel=options.CAMERA,
        show_default=False,
    ),
]


def render(
    scenes: options.SceneNames,
    outputs: Outputs,
    size: options.Size = "1024x1024",
    aov: Aov = "",
    background: Background = "0.9",
    crop: picture_options.Crop = "",
    frames: picture_options.Frames = "",
    vertices: picture_options.Vertices = "",
    fps: picture_options.Fps = None,
    animation: picture_options.Animation = "",
    camera: CameraNames = None,
    eye: cameras.Eye = "",
    look_at: cameras.LookAt = "",
    up: cameras.Up = "auto",
    fov: cameras.Fov = None,
    samples: picture_options.Samples = None,
    seed: picture_options.Seed = None,
    lights: picture_options.Lights = None,
    sun: picture_options.Sun = "",
    sun_strength: picture_options.SunStrength = None,
    sky: picture_options.Sky = "",
    occlusion_rays: picture_options.OcclusionRays = None,
    occlusion_distance: picture_options.OcclusionDistance = None,
    layout: options.Layout = "compact",
    density: options.Density = "auto",
    resolution: options.Resolution = "",
    accuracy: options.Accuracy = "robust",
    device: options.DeviceName = None,
    max_memory: options.MaxMemory = "",
    skipping: options.Skipping = False,
    shard: batch.ShardOption = "",
    skip_existing: batch.SkipExisting = False,
    keep_going: batch.KeepGoing = True,
    time_limit: batch.TimeLimit = None,
    retries: batch.Retries = None,
    compression: picture_options.Compression = None,
    half: picture_options.Half = False,
    tile: picture_options.Tile = None,
    quality: picture_options.Quality = None,
    json: options.Json = False,
    quiet: options.Quiet = False,
) -> int:
    """Render a picture of a scene, or many pictures of many scenes, frames and cameras."""
    shading = render_many.shading_of(
        {
            "samples": samples,
            "seed": seed,
            "lights": lights,
            "sun": sun,
            "sun_strength": sun_strength,
            "sky": sky,
            "occlusion_rays": occlusion_rays,
            "occlusion_distance": occlusion_distance,
        }
    )
    files: dict[str, Any] = {
        "compression": compression,
        "half": half or None,
        "tile": tile,
        "quality": quality,
    }
    saving = {name: value for name, value in files.items() if value is not None}
    place = {"eye": eye, "look_at": look_at, "up": up, "fov": fov}
    window = picture_options.parse_crop(crop)
    grid = {
        "layout": layout,
        "density": options.parse_density(density),
        "resolution": options.parse_resolution(resolution),
        "accuracy": accuracy,
        "max_memory": options.parse_bytes(max_memory),
        "skipping": skipping,
    }
    picture: dict[str, Any] = {
        "size": options.parse_size(size),
        "background": options.parse_colour(background),
        "aovs": tuple(name for name in aov.split(",") if name),
    }
    wishes = {
        "frames": frames,
        "vertices": vertices,
        "fps": fps,
        "animation": animation,
        "shard": shard,
        "skip": skip_existing,
        "limit": time_limit,
        "retries": retries,
    }
    if render_many.is_job(scenes, outputs, camera or (), **wishes):
        settings = {**picture, **grid, **shading, **saving, "crop": window}
        moving = {"frames": frames, "vertices": vertices, "fps": fps, "animation": animation}
        job = render_many.job_of(scenes, outputs, camera or (), place, moving, settings)
        from clgrid.batch.spawn import spawned_early

        with spawned_early(wanted=True) as spawned:
            return batch.run_job(
                job,
                Path.cwd(),
                shard=shard,
                skip_existing=skip_existing,
                keep_going=keep_going,
                time_limit=time_limit,
                retries=retries,
                dask="",
                sheet=None,
                device=device,
                json=json,
                quiet=quiet,
                spawned=spawned,
            )
    name = camera[0] if camera else ""
    extra = {"shading": _shading(shading), "crop": window}
    return _one(
        scenes[0], outputs, picture, place | {"camera": name}, grid, extra, saving, device, json, quiet
    )


def _one(
    scene: str, outputs: list[str], picture: dict[str, Any], place: dict[str, Any],
    grid_options: dict[str, Any], extra: dict[str, Any], saving: dict[str, Any],
    device: str | None, json: bool, quiet: bool,
) -> int:  # fmt: skip
    """Draw one picture and say what it took."""
    (width, height), aovs = picture["size"], picture["aovs"]
    paths = [Path(name) for name in outputs]
    _check_outputs(paths, aovs, saving)

    from clgrid.bench import Measurement, Work, load_timed
    from clgrid.device import choose
    from clgrid.renderer import render as draw

    chosen = choose(device)
    work = Work(width=width, height=height, **grid_options)
    with output.progress(quiet=quiet) as show:
        _say(show, f"load {scene}")
        loaded, load_s = load_timed(scene)
        look_s = _read_look(loaded, aovs, extra["shading"], quiet=quiet)
        view = cameras.choose_camera(loaded, width / height, **place)
        seen = Measurement(loaded, load_s + look_s, chosen)
        if loaded.mesh.triangle_count:
            _say(show, "compile")
            parallel = view.orthographic_height is not None
            seen.first_compile_s.append(work.warm_up(chosen, aovs, loaded, extra["shading"], parallel))
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
                background=picture["background"],
                progress=None if show is None else lambda share: show("render", share),
                **extra,
            )
        )
        row = seen.row(grid, image)
        save_s = _save(image, paths, row, show, loaded.path, saving)
    _report(row, seen, grid, paths, save_s, json=json, quiet=quiet)
    return 0


def _shading(given: dict[str, Any]) -> Shading | None:
    """How the picture is lit; refused before any work if a number cannot be."""
    if not given:
        return None
    from clgrid.look import Shading
    from clgrid.shading.order import check_shading

    shading = Shading(**given)
    check_shading(shading)
    return shading


def _read_look(scene: Scene, aovs: tuple[str, ...], shading: Shading | None, *, quiet: bool) -> float:
    """Read materials and textures where the picture shows them, say what was left out; the seconds."""
    import time

    from clgrid.renderer import needs_look

    start = time.perf_counter()
    look = scene.look if needs_look(aovs, shading) else None
    taken = time.perf_counter() - start
    output.warn(scene.mesh.warnings + (() if look is None else look.warnings), quiet=quiet)
    return taken


def _check_outputs(paths: list[Path], aovs: tuple[str, ...], saving: dict[str, Any]) -> None:
    """Find out before any work what would fail after it."""
    from clgrid.image import check_output
    from clgrid.imagefile import Saving
    from clgrid.renderer import check_aovs

    Saving(**saving)
    check_aovs(aovs)
    for path in paths:
        check_output(path)
    if aovs and not any(path.suffix.lower() == ".exr" for path in paths):
        raise InputError(f"--aov {','.join(aovs)}: only an .exr holds them; add -o NAME.exr")


def _say(show: Show, step: str) -> None:
    if show is not None:
        show(step, None)


def _save(
    image: Image, paths: list[Path], row: Row, show: Show, source: Path | None, saving: dict[str, Any]
) -> dict[str, float]:
    """Write the picture with its timings; return the seconds by file."""
    import time

    from clgrid.batch.keys import Hashes

    if source is not None:
        image.metadata["clgrid:source_sha256"] = Hashes().of(source)
    image.metadata["clgrid:load_s"] = row.load_s[0]
    image.metadata["clgrid:first_compile_s"] = sum(row.first_compile_s)
    image.metadata["clgrid:build_s"] = row.build_s[0]
    image.metadata["clgrid:time_to_image_s"] = row.time_to_image_s[0]
    taken = {}
    for path in paths:
        _say(show, f"write {path}")
        start = time.perf_counter()
        image.save(path, **saving)
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
        made = record.RenderRecord(
            schema=record.schema("render"),
            clgrid=record.version(),
            device=record.describe_device(device),
            compiled=record.describe_builds(device),
            row=row,
            outputs=tuple(map(str, paths)),
            save_s=save_s,
        )
        output.emit(record.encode(output.signed(made)))
    elif not quiet:
        output.emit_pairs(_lines(row, grid, save_s))


def _lines(row: Row, grid: Grid, save_s: dict[str, float]) -> list[tuple[str, str]]:
    from clgrid.bench import rate

    build_s, render_s = row.build_s[0], row.render_s[0]
    stages = ", ".join(f"{name} {units.seconds(values[0])}" for name, values in row.build_stages_s.items())
    return [
        ("scene", f"{row.scene}, {row.triangles:,} triangles"),
        ("device", grid.device.description.line()),
        ("load", units.seconds(row.load_s[0])),
        ("first compile", units.seconds(sum(row.first_compile_s))),
        ("build", f"{units.seconds(build_s)}, {rate(row.triangles, [build_s]):.3g} Mtri/s ({stages})"),
        (
            "render",
            f"{units.seconds(render_s)}, {rate(row.rays, [render_s]):.3g} Mrays/s"
            f" ({row.width}x{row.height}, {row.hits:,} hits)",
        ),
        ("time to image", units.seconds(row.time_to_image_s[0])),
        (
            "grid",
            f"{units.bytes_text(row.grid_bytes)}, {row.bytes_per_triangle:.3g} bytes per triangle"
            f" ({'x'.join(map(str, row.resolution))} cells, {row.references:,} references,"
            f" {row.layout}, {row.accuracy}; peak {units.bytes_text(row.peak_bytes)})",
        ),
        *(("written", f"{path} in {units.seconds(taken)}") for path, taken in save_s.items()),
    ]
