"""What can be said of a scene before a grid is built."""

from __future__ import annotations

import msgspec
import numpy as np

from clgrid import record
from clgrid.cast import Defines
from clgrid.cost import DEFAULT_RAYS, Choice
from clgrid.device import Device
from clgrid.features import features
from clgrid.frame import LocalFrame
from clgrid.info_record import CandidateRecord, ConstantsRecord, ExplainRecord, InfoRecord
from clgrid.layouts import programs
from clgrid.layouts.lists import NESTED, list_defines
from clgrid.layouts.nested import DEFAULT_DENSITY as NESTED_DENSITY
from clgrid.layouts.nested import top_resolution, within_nest
from clgrid.look import Look
from clgrid.mesh import Mesh
from clgrid.prediction import predict_choice
from clgrid.recipe import kinds
from clgrid.renderer import AOVS, kernel_options
from clgrid.resolution import DEFAULT_DENSITY, by_density, checked
from clgrid.scene import Scene, gltf_cameras
from clgrid.shading.surfaces import is_passable, look_defines

_CHUNK = 1 << 20


def info(
    scene: Scene,
    density: float | str = "auto",
    resolution: tuple[int, int, int] | None = None,
) -> InfoRecord:
    """Describe a scene and the grid it would get, without touching a device.

    Parameters
    ----------
    scene : Scene
        As loaded.
    density, resolution
        As for ``clgrid.build``; since "auto" depends on the device, the paper's density stands for it.

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
        compiled=variants(mesh) + shaded_variants(mesh, scene.look),
        warnings=mesh.warnings,
        features=features(scene),
    )


def explain(
    scene: Scene,
    device: Device,
    layout: str = "compact",
    density: float | str = "auto",
    resolution: tuple[int, int, int] | None = None,
    max_memory: int | None = None,
    skipping: bool | str = False,
    rays: int = DEFAULT_RAYS,
) -> InfoRecord:
    """Describe a scene and the grid it would get on a device: chosen among which, and its exact bytes.

    Parameters
    ----------
    scene : Scene
        As loaded.
    device : Device
        Where references are counted, and for which constants are fitted if there are none.
    layout, density, resolution, max_memory, skipping, rays
        As for ``clgrid.build``.

    Raises
    ------
    InputError, GridTooLargeError, DeviceError
        As ``clgrid.build``.
    """
    nbytes, choice = predict_choice(
        scene.mesh, layout, density, resolution, device, max_memory, skipping, rays
    )
    if choice is None:
        layout, skips = kinds(layout, skipping)[0]
    else:
        layout, skips, density = choice.chosen.layout, choice.chosen.skipping, choice.chosen.density
    if layout in NESTED:
        found = _of_nest(info(scene, resolution=(1, 1, 1)), scene.mesh, density, resolution, nbytes)
    else:
        found = info(scene, density, resolution)
    explained = ExplainRecord(
        device=record.describe_device(device),
        rays=rays,
        max_memory=max_memory,
        layout=layout,
        skipping=skips,
        nbytes=nbytes,
        candidates=[] if choice is None else _candidates(choice),
        constants=[] if choice is None else _constants(choice),
    )
    compiled = variants(scene.mesh, layout, skipping=skips) + shaded_variants(scene.mesh, scene.look)
    return msgspec.structs.replace(found, compiled=compiled, explained=explained)


def _of_nest(
    found: InfoRecord,
    mesh: Mesh,
    density: float | str,
    resolution: tuple[int, int, int] | None,
    nbytes: dict[str, int],
) -> InfoRecord:
    """With the top grid's resolution, and the cells of all grids, hashed ones to the next row of them."""
    wanted = NESTED_DENSITY if isinstance(density, str) else density
    if not mesh.triangle_count:
        return msgspec.structs.replace(found, density=wanted, resolution=resolution)
    extents = LocalFrame.of_bounds(mesh.bounds).to_local(mesh.bounds).astype(np.float64)
    cells = nbytes["cells"] // 4 - 1 if "cells" in nbytes else 8 * nbytes["domain"]
    return msgspec.structs.replace(
        found,
        density=wanted,
        resolution=within_nest(resolution or top_resolution(extents[1] - extents[0], mesh.triangle_count)),
        cells=cells,
        cell_bytes=nbytes.get("cells", nbytes.get("domain", 0)),
    )


def _candidates(choice: Choice) -> list[CandidateRecord]:
    return [
        CandidateRecord(
            layout=one.layout,
            skipping=one.skipping,
            density=one.density,
            resolution=one.resolution,
            cells=round(one.work.cells),
            references=round(one.work.references),
            full_cells=round(one.work.full_cells),
            nbytes=one.nbytes,
            steps=one.work.steps,
            tests=one.work.tests,
            batches=one.work.batches,
            build_s=one.build_s,
            cast_s=one.cast_s,
            fits=one.fits,
            chosen=one is choice.chosen,
        )
        for one in choice.candidates
    ]


def _constants(choice: Choice) -> list[ConstantsRecord]:
    return [
        ConstantsRecord(
            layout=layout,
            skipping=skipping,
            build=dict(zip(("fixed", "triangle", "reference", "cell"), seconds.build, strict=True)),
            cast=dict(zip(("ray", "passed_cell", "passed_reference"), seconds.cast, strict=True)),
            source=seconds.source,
        )
        for (layout, skipping), seconds in choice.constants.items()
    ]


def variants(mesh: Mesh, layout: str = "compact", *, skipping: bool = False) -> tuple[str, ...]:
    """List the programs that building and rendering this mesh compiles, with their options.

    A picture with fewer AOVs, or none, is a variant of render.cl with fewer options.
    """
    lists = list_defines(layout, wide=False)
    walk = {**lists, **({"SKIP_EMPTY": 1} if skipping else {})}
    # Of the stages, one alone asks for lists.
    stages = (
        _told(name, lists if name == "mark_bricks.cl" else {}) for name in programs(layout, skip=skipping)
    )
    return (*stages, _told("render.cl", {**kernel_options(mesh, AOVS), **walk}))


def _told(file: str, options: Defines) -> str:
    return " ".join((file, *(f"-D{key}={value}" for key, value in sorted(options.items()))))


def shaded_variants(mesh: Mesh, look: Look | None) -> tuple[str, ...]:
    """List the programs of a shaded picture on ``robust`` whose options follow from the look."""
    if look is None or not mesh.triangle_count:
        return ()
    options: Defines = {"REAL": "float", **look_defines(look)}
    smooth: Defines = {"SMOOTH_NORMALS": 1} if mesh.vertex_normals is not None else {}
    files = [("find_surfaces.cl", options | smooth)]
    if is_passable(look):
        files.append(("pass_surfaces.cl", options))
    return tuple(_told(name, own) for name, own in files)


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
