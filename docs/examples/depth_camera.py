"""Depth camera: a point cloud with the noise and the gaps of a real sensor.

``t_hit`` of a camera ray is the planar depth that such sensors report. Noise grows with the square of the
depth, and surfaces seen at a grazing angle return nothing. Left the depth, right the cloud from aside.
"""

from __future__ import annotations

from pathlib import Path

import common
import numpy as np

import clgrid

NOISE = 0.005  # standard deviation at the middle of the scene, as a share of the depth there
GRAZING = 0.25  # the least cosine to the normal that returns light

arguments = common.parser(__doc__, "demo")
arguments.add_argument("--cloud", type=Path, help="write the points here too, as float32 .npy")
arguments = arguments.parse_args()
scene = clgrid.load_scene(arguments.scene)
grid = clgrid.build(scene.mesh)
middle = scene.mesh.bounds.mean(axis=0)

side = arguments.size // 2
camera = clgrid.default_camera(scene, 1.0)
origins, directions = camera.rays(side, side)
hits = grid.cast(origins, directions)

towards = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
cosine = np.abs(np.sum(hits.primitive_normals * towards, -1))
seen = hits.mask & (cosine > GRAZING)
depth = np.where(seen, hits.t_hit, np.nan)
distance = np.dot(middle - camera.eye, camera.forward)
random = np.random.default_rng(1)
depth += NOISE * depth**2 / distance * random.normal(size=depth.shape)
points = (origins + depth[..., None] * directions)[seen]
if arguments.cloud:
    np.save(arguments.cloud, points.astype(np.float32))

low, high = np.nanpercentile(depth, [1, 99])
left = np.where(seen[..., None], common.colours(depth, low, high), 0.0)
# A quarter of a right angle to the side, and as far away.
aside = middle + 0.92 * (camera.eye - middle) + 0.38 * distance * camera.right
other = clgrid.Camera.look_at(aside, middle, camera.up)
right = common.dots(points, common.colours(depth[seen], low, high), other, side)
common.save(arguments.output, np.concatenate([left, right], axis=1))
print(f"{len(points):,} points; {np.sum(hits.mask & ~seen):,} pixels met a surface and returned nothing")
