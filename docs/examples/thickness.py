"""Thickness map: how far it is through the solid, straight in from each point of its surface.

A camera ray finds the point of each pixel; a second ray goes in against the normal, and its next hit is
the far side. Where there is none, the surface is open, and stays grey.
"""

from __future__ import annotations

import common
import numpy as np

import clgrid

arguments = common.parser(__doc__, "demo").parse_args()
scene = clgrid.load_scene(arguments.scene)
size = np.linalg.norm(np.ptp(scene.mesh.bounds, axis=0))
grid = clgrid.build(scene.mesh)

camera = clgrid.default_camera(scene, 4 / 3)
origins, directions = camera.rays(arguments.size, arguments.size * 3 // 4)
hits = grid.cast(origins, directions)
normals = hits.primitive_normals
away = np.sum(normals * directions, -1, keepdims=True) > 0
inwards = np.where(away, normals, -normals)

# Misses have no point and no normal: their rays are invalid, and miss again. t_min leaves out the start.
inner = grid.cast(hits.points, inwards, t_min=1e-5 * size)
solid = inner.mask & (np.sum(inner.primitive_normals * inwards, -1) > 0)
thickness = np.where(solid, inner.t_hit, np.nan)
low, high = np.nanpercentile(thickness, [2, 98])
print(f"thickness of {solid.sum():,} points: 2 % are below {low:.3f}, 2 % above {high:.3f}")

# Darker where the surface turns away from the eye, so that its shape shows.
facing = -np.sum(inwards * directions, -1) / np.linalg.norm(directions, axis=-1)
light = 0.35 + 0.65 * np.abs(facing)[..., None]
picture = np.where(solid[..., None], common.colours(thickness, low, high), 0.35) * light
common.save(arguments.output, np.where(hits.mask[..., None], picture, 0.9))
