"""``clgrid info``: what a scene holds and what its grid would be."""

from __future__ import annotations

from typing import TYPE_CHECKING

from clgrid.cli import options, output

if TYPE_CHECKING:
    from clgrid.record import InfoRecord


def info(
    scene: options.SceneName,
    density: options.Density = "auto",
    resolution: options.Resolution = "",
    json: options.Json = False,
) -> None:
    """Describe a scene and the grid it would get, without building one."""
    cells_per_triangle, cells = options.parse_density(density), options.parse_resolution(resolution)

    from clgrid import record
    from clgrid.info import info as describe
    from clgrid.scene import load_scene

    loaded = load_scene(scene)
    found = describe(loaded, cells_per_triangle, cells)
    if json:
        output.emit(record.encode(found))
        return
    output.emit_pairs(_lines(found))
    output.warn(found.warnings, quiet=False)


def _lines(found: InfoRecord) -> list[tuple[str, str]]:
    lines = [
        ("scene", found.source),
        ("triangles", f"{found.triangles:,}"),
        ("vertices", f"{found.vertices:,} {found.vertex_dtype}{', normals' * found.vertex_normals}"),
        ("geometries", _listed(found.geometries)),
        ("cameras", _listed(found.cameras) if found.cameras else "none"),
        ("mesh", output.size(found.mesh_bytes)),
    ]
    if found.bounds is not None and found.resolution is not None:
        low, high = (", ".join(f"{value:.9g}" for value in corner) for corner in found.bounds)
        rounding = f"rounds by at most {found.max_rounding:.3g}" if found.max_rounding else "exact"
        offset = ", ".join(f"{value:.9g}" for value in found.frame_offset)
        lines += [
            ("bounds", f"({low}) to ({high})"),
            ("degenerate", f"{found.degenerate:,} triangles without area"),
            ("local frame", f"offset ({offset}), scale 2^{-found.frame_exponent}, {rounding}"),
            (
                "grid",
                f"{'x'.join(map(str, found.resolution))} = {found.cells:,} cells"
                f" at density {found.density:g}: {output.size(found.cell_bytes)}, and 4 bytes a reference",
            ),
        ]
    return [*lines, ("kernels", "\n".join(found.compiled))]


def _listed(names: tuple[str, ...]) -> str:
    """Count names and show the first few."""
    shown = ", ".join(repr(name) for name in names[:8])
    return f"{len(names)}: {shown}{', ...' if len(names) > 8 else ''}"
