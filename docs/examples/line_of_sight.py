"""Line of sight over terrain: what a watchtower on the highest hill sees.

Rays straight down give the height of each pixel's place. A ray from the tower to a place is as long as
its direction, so ``t`` is 1 there, and ``occluded(..., t_max=1)`` tells whether a hill is in between.
"""

from __future__ import annotations

import common
import numpy as np

import clgrid

TOWER = 0.02  # heights above the ground, as shares of the terrain's width
TARGET = 0.001

arguments = common.parser(__doc__, "terrain:512", 384).parse_args()
mesh = clgrid.load_scene(arguments.scene).mesh
grid = clgrid.build(mesh)
low, high = mesh.bounds
width = high[0] - low[0]

# The map: row 0 is north, y up the picture. Pixel centres are in the bounds.
side = arguments.size
middles = (np.arange(side) + 0.5) / side
x, y = np.meshgrid(low[0] + middles * width, high[1] - middles * (high[1] - low[1]))
above = np.stack([x, y, np.full_like(x, high[2] + width)], -1)
ground = grid.cast(above, [0.0, 0.0, -1.0])

places = ground.points
heights = np.where(ground.mask, places[..., 2], -np.inf)
up = np.array([0.0, 0.0, width])
tower = places.reshape(-1, 3)[np.argmax(heights)] + TOWER * up
targets = np.where(ground.mask[..., None], places, tower) + TARGET * up
visible = ground.mask & ~grid.occluded(tower, targets - tower, t_max=1.0)

# Hills lit from the north-west; what is seen is yellow, what is not is blue.
normals = ground.primitive_normals * np.sign(ground.primitive_normals[..., 2:])
light = 0.25 + 0.75 * np.clip(normals @ (np.array([-1.0, 1.0, 0.7]) / np.sqrt(2.49)), 0.0, 1.0)
colour = np.where(visible[..., None], [1.0, 0.72, 0.25], [0.12, 0.2, 0.4])
picture = np.where(ground.mask[..., None], light[..., None] * colour, 0.9)
spot = np.hypot(x - tower[0], y - tower[1]) < 0.012 * width
picture[spot] = [0.8, 0.0, 0.0]
common.save(arguments.output, picture)
share = visible.sum() / ground.mask.sum()
print(f"the tower at {tower.round(2).tolist()} sees {100 * share:.1f} % of the map")
