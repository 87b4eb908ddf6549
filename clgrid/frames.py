"""Moving meshes: one rebuild and one picture a frame, timed."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

import numpy as np
import numpy.typing as npt

from clgrid import record
from clgrid.animation.vertices import Positions, read_frames
from clgrid.bench import Work, load_timed
from clgrid.camera import Camera
from clgrid.device import Device
from clgrid.errors import InputError
from clgrid.grid import Grid
from clgrid.mesh import Mesh, used_vertices
from clgrid.outermost import extent
from clgrid.record import FrameMedians, FrameRow, FramesRecord
from clgrid.renderer import render
from clgrid.scene import Scene, up_axis


def bounds_of_all(frames: Positions, mesh: Mesh) -> npt.NDArray[np.float64]:
    """(2, 3) float64: lowest and highest corner that a triangle reaches in any frame."""
    used = used_vertices(mesh)
    low, high = zip(*[extent(frame[used]) for frame in frames], strict=True)
    return np.stack([np.min(low, axis=0), np.max(high, axis=0)]).astype(np.float64)


class FrameTally:
    """What is measured of one frame, play by play."""

    def __init__(self, frame: int) -> None:
        self.frame = frame
        self.build_s: list[float] = []
        self.render_s: list[float] = []

    def play(self, grid: Grid, vertices: Positions, view: Camera, work: Work) -> FrameRow:
        """Rebuild the grid for the vertices and draw it; the row covers all plays so far."""
        start = time.perf_counter()
        grid.update(vertices)
        built = time.perf_counter()
        image = render(grid.mesh, view, work.width, work.height, grid=grid)
        self.build_s.append(built - start)
        self.render_s.append(time.perf_counter() - built)
        stats = grid.stats
        return FrameRow(
            frame=self.frame,
            resolution=stats.resolution,
            references=stats.references,
            grid_bytes=grid.nbytes,
            peak_bytes=grid.peak_nbytes,
            build_s=self.build_s,
            render_s=self.render_s,
            time_to_image_s=[b + r for b, r in zip(self.build_s, self.render_s, strict=True)],
            hits=image.hits,
        )


def bench_frames(
    name: str,
    path: Path,
    work: Work,
    device: Device,
    progress: Callable[[str], None] = lambda step: None,
) -> FramesRecord:
    """Rebuild and draw each frame of a moving mesh, by default from a camera that sees all of them.

    The sequence is played once a repetition, after one untimed frame. Vertex normals of the mesh are not
    used: they belong to one pose.

    Parameters
    ----------
    name : str
        File or built-in scene: which vertices make triangles.
    path : Path
        As for ``read_frames``.
    work : Work
        Pixels, repetitions and the grid.
    device : Device
        Where.
    progress : callable
        Called with each step before its turn.

    Raises
    ------
    ClgridError
        If the mesh or the frames cannot be used, or a grid cannot be built.
    """
    progress(name)
    loaded, load_s = load_timed(name)
    frames = read_frames(path, loaded.mesh)
    if not loaded.mesh.triangle_count:
        raise InputError(f"bench: {name} has no triangles, so no frame shows anything; give another mesh")
    pose = np.array(frames[0], order="C")
    mesh = Mesh(pose, loaded.mesh.faces, source=loaded.mesh.source)
    first_compile_s = work.warm_up(device)
    if work.view is not None:
        view = work.camera(loaded)
    else:
        aspect = work.width / work.height
        view = Camera.framing(bounds_of_all(frames, mesh), up_axis(loaded), aspect=aspect)
    grid = work.build(Scene(loaded.name, mesh), device, view)
    FrameTally(0).play(grid, pose, view, work)
    tallies = [FrameTally(k) for k in range(len(frames))]
    rows: list[FrameRow] = []
    for _ in range(work.repetitions):
        rows.clear()
        for tally, vertices in zip(tallies, frames, strict=True):
            progress(f"frame {tally.frame}")
            # A real copy, so that no file is read while the clock runs.
            rows.append(tally.play(grid, np.array(vertices, order="C"), view, work))
    return FramesRecord(
        schema=record.schema("bench.frames"),
        clgrid=record.version(),
        device=record.describe_device(device),
        compiled=record.describe_builds(device),
        process_peak_bytes=record.process_peak_bytes(),
        scene=loaded.name,
        frames=str(path),
        frames_bytes=frames.nbytes,
        triangles=mesh.triangle_count,
        vertices=len(mesh.vertices),
        layout=grid.layout,
        accuracy=grid.accuracy,
        width=work.width,
        height=work.height,
        rays=work.width * work.height,
        load_s=[load_s],
        first_compile_s=[first_compile_s],
        rows=rows,
        medians=FrameMedians(
            build_s=_median([row.build_s for row in rows]),
            render_s=_median([row.render_s for row in rows]),
            time_to_image_s=_median([row.time_to_image_s for row in rows]),
        ),
        warnings=loaded.mesh.warnings,
    )


def _median(times: list[list[float]]) -> float:
    return median(seconds for repetitions in times for seconds in repetitions)
