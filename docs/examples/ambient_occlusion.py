"""Ambient occlusion: which share of the sky each point of a surface sees.

A camera ray finds the point of each pixel. From there, rays go to random directions above the surface,
more of them near the normal. Each asks only whether anything is near: ``occluded`` with a ``t_max``.
"""

from __future__ import annotations

import common
import numpy as np

import clgrid

SAMPLES = 32
REACH = 0.5  # as a share of the scene's size

arguments = common.parser(__doc__, "demo").parse_args()
scene = clgrid.load_scene(arguments.scene)
size = np.linalg.norm(np.ptp(scene.mesh.bounds, axis=0))
grid = clgrid.build(scene.mesh)

camera = clgrid.default_camera(scene, 4 / 3)
origins, directions = camera.rays(arguments.size, arguments.size * 3 // 4)
hits = grid.cast(origins, directions)
normals = hits.primitive_normals
away = np.sum(normals * directions, -1, keepdims=True) > 0
normals = np.where(away, -normals, normals)[hits.mask]
# A little above the surface, so that a ray does not meet the triangle that it leaves.
starts = hits.points[hits.mask] + 1e-5 * size * normals

random = np.random.default_rng(1)
open_sky = np.zeros(len(starts))
for _ in range(SAMPLES):
    # The normal and a point of the unit sphere added up: directions by the cosine to the normal.
    ball = random.normal(size=starts.shape)
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    towards = normals + 0.999 * ball
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    open_sky += ~grid.occluded(starts, towards, t_max=REACH * size)

picture = np.full((*hits.mask.shape, 3), 0.2)
# Squared, so that half of the sky looks half as bright.
picture[hits.mask] = ((open_sky / SAMPLES) ** 2)[:, None]
common.save(arguments.output, picture)
print(f"{hits.mask.sum():,} points, {SAMPLES} rays each: {100 * open_sky.mean() / SAMPLES:.1f} % of the sky")
