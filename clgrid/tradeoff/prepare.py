"""Compile what a trade-off runs, on one triangle, so that no kernel is compiled while anything is timed."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from clgrid.device import Device
from clgrid.grid import build
from clgrid.mesh import Mesh
from clgrid.procedural import cube
from clgrid.renderer import warm_up
from clgrid.rungs import RUNGS
from clgrid.structured import Aim
from clgrid.tradeoff.survey import Easel
from clgrid.verify import compared_fields, well_inside

Progress = Callable[[str, float | None], None]


def compile_all(
    easel: Easel, auto_layout: str, reference_layout: str, *, closed: bool, progress: Progress
) -> list[float]:
    """Compile all variants; the seconds of each rung and layout.

    Parameters
    ----------
    easel : Easel
    auto_layout, reference_layout : str
        Of the grid that the reference's picture is drawn from, and of that which its rays go through.
    closed : bool
        Whether points inside of the mesh will be looked for.
    progress : callable
    """
    plan, scene, device = easel.plan, easel.scene, easel.device
    wanted = list(dict.fromkeys((point.accuracy, point.layout) for point in plan.points()))
    if ("exact", auto_layout) not in wanted:
        wanted.append(("exact", auto_layout))
    smooth = scene.mesh.vertex_normals is not None
    shown: set[str] = set()
    taken = []
    for number, (accuracy, layout) in enumerate(wanted):
        progress(f"compile {accuracy}, {layout}", number / len(wanted))
        start = time.perf_counter()
        _pictures(easel, accuracy, layout)
        lossless = RUNGS[accuracy].lossless
        # One grid speaks for a rung that no grid changes.
        if not lossless or accuracy not in shown or (accuracy, layout) == ("exact", auto_layout):
            warm_up(device, ("id",), smooth=smooth, layout=layout, accuracy=accuracy, density=1.0)
            _answers(device, accuracy, reference_layout if lossless else layout)
            shown.add(accuracy)
        taken.append(time.perf_counter() - start)
    if closed:
        progress("compile for points inside", None)
        start = time.perf_counter()
        well_inside(Aim.at(cube(), (2, 2, 2)), device, plan.seed)
        taken.append(time.perf_counter() - start)
    return taken


def _pictures(easel: Easel, accuracy: str, layout: str) -> None:
    scene, plan = easel.scene, easel.plan
    smooth = scene.mesh.vertex_normals is not None
    orthographic = easel.view.orthographic_height is not None
    for samples in sorted(set(plan.samples)) or (None,):
        shading = easel.shading(samples)
        warm_up(
            easel.device,
            smooth=smooth,
            look=scene.look if shading is not None else None,
            shading=shading,
            orthographic=orthographic,
            layout=layout,
            accuracy=accuracy,
            density=1.0,
        )


def _answers(device: Device, accuracy: str, layout: str) -> None:
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
    triangle = Mesh(corners, np.array([[0, 1, 2]], np.uint32))
    with build(triangle, layout, 1.0, accuracy=accuracy, device=device) as grid:
        grid.cast(np.zeros((1, 3)), np.ones((1, 3)), fields=compared_fields(grid.rung))
