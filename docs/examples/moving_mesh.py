"""Moving mesh: the grid is rebuilt in place for every frame, and the frame is drawn.

The mesh is twisted to and fro around its vertical axis. The picture is a strip of four frames, up to the
widest swing. With ``--frames DIR`` all are written, for instance for ``ffmpeg -i DIR/%04d.png twist.mp4``.
"""

from __future__ import annotations

import time
from pathlib import Path

import common
import numpy as np

import clgrid

arguments = common.parser(__doc__, "demo")
arguments.add_argument("--geometry", help="the name of one geometry of the scene; of demo, the knot")
arguments.add_argument("--frames", type=Path, help="folder for all frames")
arguments.add_argument("--count", type=int, default=24, help="how many frames")
arguments = arguments.parse_args()

name = arguments.geometry or ("knot" if arguments.scene == "demo" else None)
mesh = common.part(clgrid.load_scene(arguments.scene).mesh, name)
rest = mesh.vertices.astype(np.float64)
low, high = mesh.bounds
centre = 0.5 * (low + high)
camera = clgrid.Camera.framing(mesh.bounds)
side = arguments.size // 4
if arguments.frames:
    arguments.frames.mkdir(parents=True, exist_ok=True)


def twisted(phase: float) -> np.ndarray:
    """Vertices turned around the vertical axis, by more the higher they are."""
    angle = 2.0 * np.sin(2 * np.pi * phase) * (rest[:, 1] - low[1]) / (high[1] - low[1])
    x, z = rest[:, 0] - centre[0], rest[:, 2] - centre[2]
    cos, sin = np.cos(angle), np.sin(angle)
    return np.stack([centre[0] + cos * x + sin * z, rest[:, 1], centre[2] - sin * x + cos * z], -1)


grid = clgrid.build(mesh, rays=side * side)
strip, seconds = [], []
shown = [max(1, arguments.count // 12) * k for k in range(4)]
for frame in range(arguments.count):
    vertices = twisted(frame / arguments.count).astype(np.float32)
    start = time.perf_counter()
    grid.update(vertices)
    seconds.append(time.perf_counter() - start)
    image = clgrid.render(grid.mesh, camera, side, side, grid=grid)
    if arguments.frames:
        image.save(arguments.frames / f"{frame:04d}.png")
    if frame in shown:
        strip.append(image.rgba[..., :3])

common.save(arguments.output, np.concatenate(strip, axis=1))
print(f"{mesh.triangle_count:,} triangles rebuilt in {1e3 * np.median(seconds):.1f} ms a frame, by median")
