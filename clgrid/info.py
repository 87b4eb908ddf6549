"""What can be said of a scene before a grid is built."""

from __future__ import annotations

import numpy as np

from clgrid import record
from clgrid.frame import LocalFrame
from clgrid.mesh import Mesh
from clgrid.record import InfoRecord
from clgrid.renderer import AOVS, kernel_options
from clgrid.resolution import DEFAULT_DENSITY, by_density, checked
from clgrid.scene import Scene, gltf_cameras

BUILD_PROGRAMS = ("count_references.cl", "scan_slabs.cl", "bin_references.cl", "insert_references.cl")

_CHUNK = 1 << 20


def info(
    scene: Scene,
    density: float | str = "auto",
    resolution: tuple[int, int, int] | None = None,
) -> InfoRecord:
    """Describe a scene and the grid it would get.

    Parameters
    ----------
    scene : Scene
        As loaded.
    density, resolution
        As for ``clgrid.build``.

    Raises
    ------
    InputError, GridTooLargeError
        If density or resolution are out of range.
    """
    mesh = scene.mesh
    count = mesh.triangle_count
    wanted = DEFAULT_DENSITY if isinstance(density, str) else density
    low, high = mesh.bounds.tolist() if count else ((0.0,) * 3, (0.0,) * 3)
    frame = LocalFrame.of_bounds(mesh.bounds if count else np.zeros((2, 3)))
    cells = checked(resolution) if resolution else None
    if count and cells is None:
        local = frame.to_local(mesh.bounds).astype(np.float64)
        cells = by_density(local[1] - local[0], count, wanted)
    total = cells[0] * cells[1] * cells[2] if cells and count else 0
    return InfoRecord(
        schema=record.schema("info"),
        clgrid=record.version(),
        scene=scene.name,
        source=mesh.source,
        triangles=count,
        vertices=len(mesh.vertices),
        vertex_dtype=mesh.vertices.dtype.name,
        vertex_normals=mesh.vertex_normals is not None,
        geometries=mesh.geometry_names,
        cameras=tuple(camera.name for camera in gltf_cameras(scene)),
        bounds=(tuple(low), tuple(high)) if count else None,
        mesh_bytes=mesh.nbytes,
        degenerate=degenerate_count(mesh, frame),
        frame_offset=tuple(frame.offset.tolist()),
        frame_exponent=frame.exponent,
        max_rounding=frame.max_rounding(mesh),
        density=wanted,
        resolution=cells,
        cells=total,
        cell_bytes=4 * (total + 1) if total else 0,
        compiled=variants(mesh),
        warnings=mesh.warnings,
    )


def variants(mesh: Mesh) -> tuple[str, ...]:
    """List the programs that building and rendering this mesh compiles, with their options.

    A picture with fewer AOVs, or none, is a variant of render.cl with fewer options.
    """
    options = (f"-D{key}={value}" for key, value in sorted(kernel_options(mesh, AOVS).items()))
    return (*BUILD_PROGRAMS, " ".join(("render.cl", *options)))


def degenerate_count(mesh: Mesh, frame: LocalFrame) -> int:
    """Count the triangles whose local vertices lie on a line or in a point."""
    found = 0
    for start in range(0, mesh.triangle_count, _CHUNK):
        part = mesh.faces[start : start + _CHUNK]
        corners = frame.to_local(mesh.vertices[part.reshape(-1)]).astype(np.float64).reshape(-1, 3, 3)
        e, f = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        flat = (e * np.roll(f, -1, 1) == np.roll(e, -1, 1) * f).all(axis=1)
        found += int(np.count_nonzero(flat))
    return found
