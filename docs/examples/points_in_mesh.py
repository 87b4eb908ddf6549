"""Points in a mesh: random ones, even over its inside, and its volume by counting.

Points are dealt over the bounds, and ``contains`` keeps those inside. On the rung ``exact`` its answers
are right for every point. The picture shows the points of the rear half, coloured by height.
"""

from __future__ import annotations

import common
import numpy as np

import clgrid

arguments = common.parser(__doc__, "demo")
arguments.add_argument("--geometry", help="the name of one geometry of the scene; of demo, the knot")
arguments.add_argument("--points", type=int, default=1_000_000, help="how many are tried")
arguments = arguments.parse_args()

name = arguments.geometry or ("knot" if arguments.scene == "demo" else None)
mesh = common.part(clgrid.load_scene(arguments.scene).mesh, name)
grid = clgrid.build(mesh, accuracy="exact")
low, high = mesh.bounds
points = np.random.default_rng(1).uniform(low, high, (arguments.points, 3))
inside = grid.contains(points)

box = np.prod(high - low)
share = inside.mean()
error = box * np.sqrt(share * (1 - share) / len(points))
print(f"{inside.sum():,} of {len(points):,} points are inside: volume {box * share:.3f} +- {error:.3f}")

view = clgrid.Camera.framing(mesh.bounds).forward
kept = points[inside]
kept = kept[(kept - 0.5 * (low + high)) @ view > 0]
camera = clgrid.Camera.framing([kept.min(axis=0), kept.max(axis=0)])
colour = common.colours(kept[:, 1], low[1], high[1])
common.save(arguments.output, common.dots(kept, colour, camera, arguments.size))
