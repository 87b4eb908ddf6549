"""``clgrid info``: what a scene holds, what its grid would be, and why."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from clgrid import units
from clgrid.cli import options, output
from clgrid.errors import InputError

if TYPE_CHECKING:
    from rich.table import Table

    from clgrid.features_record import FeaturesRecord
    from clgrid.info_record import ExplainRecord, InfoRecord

_DEFAULT_LAYOUT = "compact"

Explain = Annotated[
    bool,
    typer.Option(
        "--explain",
        help="Say which grid the device would get and why: what it was chosen among, its exact bytes.",
        rich_help_panel=options.GRID,
    ),
]


def info(
    scene: options.SceneName,
    explain: Explain = False,
    layout: options.Layout = _DEFAULT_LAYOUT,
    density: options.Density = "auto",
    resolution: options.Resolution = "",
    rays: options.Rays = None,
    device: options.DeviceName = None,
    max_memory: options.MaxMemory = "",
    skipping: options.Skipping = False,
    json: options.Json = False,
) -> None:
    """Describe a scene and the grid it would get, without building one."""
    cells_per_triangle, cells = options.parse_density(density), options.parse_resolution(resolution)
    memory = options.parse_bytes(max_memory)
    given = {
        "--layout": layout != _DEFAULT_LAYOUT,
        "--rays": rays is not None,
        "--device": device is not None,
        "--max-memory": memory is not None,
        "--skipping": skipping,
    }
    unread = [name for name, there in given.items() if there and not explain]
    if unread:
        raise InputError(f"info: {unread[0]} matters with --explain alone; give that too")

    from clgrid import record
    from clgrid.info import explain as describe_on
    from clgrid.info import info as describe
    from clgrid.scene import load_scene

    loaded = load_scene(scene)
    if explain:
        from clgrid.cost import DEFAULT_RAYS
        from clgrid.device import choose

        wanted = DEFAULT_RAYS if rays is None else rays
        found = describe_on(
            loaded, choose(device), layout, cells_per_triangle, cells, memory, skipping, wanted
        )
    else:
        found = describe(loaded, cells_per_triangle, cells)
    if json:
        output.emit(record.encode(found))
        return
    auto = isinstance(cells_per_triangle, str) and cells is None
    output.emit_pairs(_lines(found, auto=auto))
    if found.explained is not None and found.explained.candidates:
        output.emit_table(_table(found.explained))
    more = () if found.features is None else found.features.warnings
    output.warn((*found.warnings, *more), quiet=False)


def _lines(found: InfoRecord, *, auto: bool) -> list[tuple[str, str]]:
    lines = [
        ("scene", found.source),
        ("triangles", f"{found.triangles:,}"),
        ("vertices", f"{found.vertices:,} {found.vertex_dtype}{', normals' * found.vertex_normals}"),
        ("geometries", _listed(found.geometries)),
        ("cameras", _listed(found.cameras) if found.cameras else "none"),
        ("mesh", units.bytes_text(found.mesh_bytes)),
        *([] if found.features is None else _features(found.features)),
    ]
    if found.bounds is not None and found.resolution is not None:
        low, high = (", ".join(f"{value:.9g}" for value in corner) for corner in found.bounds)
        rounding = f"rounds by at most {found.max_rounding:.3g}" if found.max_rounding else "exact"
        offset = ", ".join(f"{value:.9g}" for value in found.frame_offset)
        lines += [
            ("bounds", f"({low}) to ({high})"),
            ("degenerate", f"{found.degenerate:,} triangles without area"),
            ("local frame", f"offset ({offset}), scale 2^{-found.frame_exponent}, {rounding}"),
            ("grid", _grid(found, auto=auto)),
        ]
    explained = [] if found.explained is None else _reasons(found.explained)
    return [*lines, ("kernels", "\n".join(found.compiled)), *explained]


def _features(found: FeaturesRecord) -> list[tuple[str, str]]:
    """What the file holds beside triangles, with the bytes of each; nothing of what there is none of."""
    size = units.bytes_text
    kinds = {"double-sided": found.double_sided, "masked": found.masked, "emissive": found.emissive}
    told = "".join(f", {count} {kind}" for kind, count in kinds.items() if count)
    ids = found.nbytes.get("material_ids")
    lines = [("materials", f"{found.materials}{told}{f': {size(ids)}' if ids else ''}")] * bool(
        found.materials
    )
    for each in found.textures:
        alpha = ", alpha" * each.alpha
        lines.append(("texture", f"{each.name!r} {each.width}x{each.height}{alpha}: {size(each.nbytes)}"))
    for uv in found.uv_sets:
        lines.append(("uv", f"{uv.rows:,} rows{', own faces' * uv.own_faces}: {size(uv.nbytes)}"))
    if found.vertex_colours:
        lines.append(("colours", f"of vertices: {size(found.nbytes['colours'])}"))
    lines += [("light", f"{light.name!r} {light.kind}") for light in found.lights]
    if found.frames is not None:
        frames = found.frames
        kind = ", each a mesh of its own" * frames.topology_changes + ", cameras move" * frames.cameras_move
        rate = f"{frames.count} at {frames.fps:g} a second"
        lines.append(("frames", f"{rate}{kind}: {size(frames.nbytes)} each; {frames.source}"))
    return lines


def _grid(found: InfoRecord, *, auto: bool) -> str:
    cells = "x".join(map(str, found.resolution or ()))
    at = f"{cells} = {found.cells:,} cells at density {found.density:g}"
    if found.explained is None:
        open_choice = ", the paper's; auto depends on the device, see --explain" if auto else ""
        return f"{at}{open_choice}: {units.bytes_text(found.cell_bytes)}, and 4 bytes a reference"
    arrays = ", ".join(f"{name} {count:,}" for name, count in found.explained.nbytes.items())
    skipping = ", skipping" * found.explained.skipping
    return (
        f"{at}, {found.explained.layout}{skipping}: {sum(found.explained.nbytes.values()):,} bytes ({arrays})"
    )


def _reasons(explained: ExplainRecord) -> list[tuple[str, str]]:
    bound = "" if explained.max_memory is None else f", of at most {units.bytes_text(explained.max_memory)}"
    lines = [("device", f"{explained.device.name}, driver {explained.device.driver}")]
    if not explained.candidates:
        return [*lines, ("chosen", "nothing: the options leave one grid")]
    lines.append(("chosen", f"for {explained.rays:,} rays: the least build + cast{bound}"))
    for one in explained.constants:
        seconds = ", ".join(
            f"{units.seconds(value)} fixed"
            if name == "fixed"
            else f"{1e9 * value:.3g} ns a {name.replace('_', ' ')}"
            for name, value in {**one.build, **one.cast}.items()
        )
        lines.append((f"{one.layout}{'*' * one.skipping}", f"{seconds}; {one.source}"))
    return lines


def _table(explained: ExplainRecord) -> Table:
    from rich.table import Table

    starred = any(one.skipping for one in explained.candidates)
    title = "estimates" + "; * leaps over empty space" * starred
    table = Table(title=title, title_justify="left", pad_edge=False)
    table.add_column("layout", no_wrap=True)
    for name in ("density", "cells", "references", "bytes", "build", "cast", "sum"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("")
    for one in explained.candidates:
        table.add_row(
            f"{one.layout}{'*' * one.skipping}",
            f"{one.density:g}",
            f"{one.cells:,}",
            f"{one.references:,}",
            units.bytes_text(one.nbytes),
            units.seconds(one.build_s),
            units.seconds(one.cast_s),
            units.seconds(one.build_s + one.cast_s),
            "chosen" if one.chosen else "" if one.fits else "too large",
            style="bold" if one.chosen else None,
        )
    return table


def _listed(names: tuple[str, ...]) -> str:
    """Count names and show the first few."""
    shown = ", ".join(repr(name) for name in names[:8])
    return f"{len(names)}: {shown}{', ...' if len(names) > 8 else ''}"
