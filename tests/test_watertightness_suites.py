"""The watertightness tests of other ray casters, and one that none of them passes; nothing is tolerated.

Each test's docstring names its source, as in ``test_bugs_in_the_wild.py``.
"""

from __future__ import annotations

import itertools

import numpy as np
import numpy.typing as npt
import pytest
from agreement import RUNGS, ask, fields_of, query
from meshes import lattice_box, needle_fan, scaled, torus
from promises import kept
from rays import NEARLY_ZERO
from scenes import scene
from shapes import WAYS, edge_middles, uv_sphere

import clgrid
from clgrid import procedural, rational
from clgrid.device import Device
from clgrid.grid import build
from clgrid.mesh import Mesh

F64 = npt.NDArray[np.float64]


@pytest.mark.parametrize("offset", [0.0, 1e3, 1e5])
def test_no_ray_from_within_a_ball_escapes_and_each_counts_once(offset: float, device: Device) -> None:
    """Measured with releases of 2026: rays at all vertices and middles of edges of an icosphere, from within.

    Of 40,962 rays at offset 0, 4,505 escape from Mitsuba 3.9, 86 from robust Embree 4.4 and Open3D 0.20,
    whose parity is wrong 7,131 times; see also mikedh/trimesh#2317 and pyvista/pyvista PR#949, #5587.
    """
    ball = procedural.icosphere(5)
    ball = Mesh((ball.vertices + offset).astype(np.float32), ball.faces)
    targets = np.concatenate([ball.vertices, edge_middles(ball).astype(np.float32)])
    assert len(targets) == 10_242 + 30_720
    origin = np.full(3, offset, np.float32)
    ways = (targets - origin).astype(np.float64)
    rays = query(origin.astype(np.float64), ways)
    triangles = rational.Triangles.of_mesh(ball)
    for rung in RUNGS:
        grid = build(ball, accuracy=rung, device=device, density=4)
        hits = grid.cast(*rays, fields=fields_of(rung))
        assert hits.mask.all(), f"{rung}: {np.sum(~hits.mask)} rays escape"
    assert (grid.count(*rays) == 1).all()
    for row in range(0, len(ways), 997):
        truth = rational.crossings(triangles, origin, ways[row])
        assert hits.primitive_ids[row] == next(c.id for c in truth if c.t >= 0)


@pytest.mark.slow
@pytest.mark.parametrize("across", [48, 200])
def test_random_rays_within_a_far_sphere_embree_watertight(across: int, device: Device) -> None:
    """RenderKit/embree WatertightTest: a sphere of 2 at (148376, 1234, -223423), a plane; 2e-5 may miss."""
    centre = np.array([148376.0, 1234.0, -223423.0])
    ball = uv_sphere(2.0, across, across // 2)
    ball = Mesh((ball.vertices + centre).astype(np.float32), ball.faces)
    rng, count = np.random.default_rng(5), 20 * across * across // 4
    origins = centre + rng.uniform(-1, 1, (count, 3))
    ways = rng.normal(size=(count, 3))
    aimed = ball.vertices[rng.integers(len(ball.vertices), size=count // 4)].astype(np.float64)
    ways[: len(aimed)] = aimed - origins[: len(aimed)]
    side = np.arange(-20, 21)
    x, z = (axis.reshape(-1) for axis in np.meshgrid(side, side))
    floor = Mesh((np.stack([x, np.zeros(len(x)), z], -1) + centre).astype(np.float32), _squares(41, 41))
    above = centre + rng.uniform((-18, 1, -18), (18, 9, 18), (count, 3))
    below = centre + rng.uniform((-18, 0, -18), (18, 0, 18), (count, 3))
    for rung in RUNGS:
        inner = ask(build(ball, accuracy=rung, device=device, density=4), query(origins, ways))
        assert inner.hits.mask.all()
        down = ask(build(floor, accuracy=rung, device=device, density=4), query(above, below - above))
        assert down.hits.mask.all()
    assert (inner.counts % 2 == 1).all()
    assert (down.counts == 1).all()


def _squares(rows: int, columns: int) -> npt.NDArray[np.uint32]:
    """Two triangles for each square of a lattice of vertices."""
    r, c = np.meshgrid(np.arange(rows - 1), np.arange(columns - 1), indexing="ij")
    a = r * columns + c
    faces = np.stack([a, a + 1, a + columns + 1, a, a + columns + 1, a + columns], -1)
    return faces.reshape(-1, 3).astype(np.uint32)


def quantised(mesh: Mesh, steps: int) -> Mesh:
    """On a lattice of integers, the largest extent ``steps`` wide."""
    low, high = mesh.bounds
    points = np.round((mesh.vertices - low) / (high - low).max() * steps)
    return Mesh(points.astype(np.float32), mesh.faces)


def assert_lattice_of_rays_is_solid(mesh: Mesh, device: Device, step: float) -> None:
    """Rays along all axes, on a lattice over the bounds: no gaps, and as many entries as exits."""
    low, high = mesh.bounds
    for axis, sign in itertools.product(range(3), (-1.0, 1.0)):
        others = [a for a in range(3) if a != axis]
        a, b = np.meshgrid(*(np.arange(low[k], high[k] + step, step) for k in others), indexing="ij")
        origins = np.insert(
            np.stack([a, b], -1).reshape(-1, 2), axis, high[axis] if sign < 0 else low[axis], 1
        )
        # From beside the bounds: what lies in them counts too.
        origins[:, axis] -= sign
        rays = query(origins, sign * np.eye(3)[axis])
        found = {r: ask(build(mesh, accuracy=r, device=device, density=4), rays) for r in RUNGS}
        exact = found["exact"]
        assert (exact.counts % 2 == 0).all()
        assert exact.hits.mask.mean() > 0.1
        # Nothing is rounded here, so that the other rungs meet all that is met, and edges twice.
        for rung in ("robust", "precise"):
            assert not (exact.hits.mask & ~found[rung].hits.mask).any()


@pytest.mark.slow
def test_a_lattice_of_rays_at_a_ball_of_integers_tinybvh_168(device: Device) -> None:
    """jbikker/tinybvh#168, with a ball instead of the dragon."""
    assert_lattice_of_rays_is_solid(quantised(procedural.icosphere(3), 24), device, 0.5)
    assert_lattice_of_rays_is_solid(quantised(torus(), 40), device, 1.0)


@pytest.mark.slow
@pytest.mark.parametrize(("steps", "apart"), [(64, 0.5), (255, 1.0)])
def test_a_lattice_of_rays_at_a_dragon_of_integers_tinybvh_168(
    steps: int, apart: float, device: Device
) -> None:
    """jbikker/tinybvh#168: the dragon on a grid of integers, a lattice of rays on its bounds; gaps."""
    dragon = clgrid.load(scene("scans/dragon_vrip_res4.ply.gz"))
    assert build(quantised(dragon, steps), device=device).open_edges == 0
    assert_lattice_of_rays_is_solid(quantised(dragon, steps), device, apart)


@pytest.mark.parametrize("side", [33, pytest.param(513, marks=pytest.mark.slow)])
def test_a_sphere_under_a_symmetric_camera_bvh_51(side: int, device: Device) -> None:
    """madmann91/bvh#51: pixels on edges are missed, unless moved by half; dimforge/parry#444: pinholes."""
    ball = uv_sphere(1.0, 32, 16)
    x, y = (axis.reshape(-1) for axis in np.meshgrid(*[np.linspace(-0.4, 0.4, side)] * 2))
    ways = np.stack([x, y, np.full(len(x), -1.0)], -1)
    eye = np.array([0.0, 0, 3])
    passing = np.linalg.norm(np.cross(ways, eye), axis=1) / np.linalg.norm(ways, axis=1)
    middle = passing < 0.95
    for rung in RUNGS:
        answers = ask(build(ball, accuracy=rung, device=device, density=4), query(eye, ways))
        assert answers.hits.mask[middle].all()
        assert not answers.hits.mask[passing > 1.001].any()
    assert (answers.counts[middle] == 2).all()
    assert (answers.counts % 2 == 0).all()


@pytest.mark.slow
def test_rays_at_shared_edges_mitsuba3_1300(device: Device) -> None:
    """mitsuba-renderer/mitsuba3 PR#1300, #1149, #1301: an array of rays that hit edges exactly; some pass."""
    x, z = (axis.reshape(-1) for axis in np.meshgrid(np.arange(13), np.arange(13)))
    rng = np.random.default_rng(1300)
    bumps = np.round(rng.uniform(-1, 1, len(x)) * 64) / 64
    for height in (np.zeros(len(x)), bumps):
        sheet = Mesh(np.stack([x, height, z], -1).astype(np.float32), _squares(13, 13))
        targets = np.concatenate([sheet.vertices.astype(np.float64), edge_middles(sheet)])
        inner = targets[((targets[:, ::2] > 0) & (targets[:, ::2] < 12)).all(axis=1)]
        for eye in ((6.5, 20.0, 6.25), (-3.0, 40.0, 5.0), (1e5, 3e5, -7e4)):
            found = kept(sheet, np.array(eye), inner - np.array(eye), device, sample=60)
            assert found.all_hit()
            assert (found.counts % 2 == 1).all()
            assert height.any() or (found.counts == 1).all()


@pytest.mark.slow
def test_two_rays_that_bracket_an_edge_manifold_1645(device: Device) -> None:
    """elalish/manifold PR#1645: rays 1e-15 to either side of a cube's diagonal, and upon it; one may miss."""
    cube = scaled(procedural.cube(), 0.5)
    beside = np.array([0, 1e-15, -1e-15, 5e-324, -5e-324])
    x, y = (axis.reshape(-1) for axis in np.meshgrid(beside, beside))
    for at, axis in itertools.product((0.0, 0.25), range(3)):
        for sign in (1.0, -1.0):
            origins = np.insert(np.stack([at + x, sign * at + y], -1), axis, -5.0, axis=1)
            found = kept(cube, origins, 10 * np.eye(3)[axis], device)
            assert found.all_hit()
            assert (found.counts == 2).all()
            assert all(np.allclose(hits.t_hit, 0.45, rtol=1e-7) for hits in found.hits.values())


def hostile(mesh: Mesh) -> Mesh:
    """With copies of a third of the triangles, twice, and with triangles without area."""
    twice = np.repeat(mesh.faces[::3], 2, axis=0)
    return Mesh(
        mesh.vertices, np.concatenate([twice, mesh.faces, mesh.faces[:, [0, 1, 1]], mesh.faces[:, [2, 2, 2]]])
    )


INSIDES = {
    "ball": (procedural.icosphere(2), (0.0, 0.0, 0.0)),
    "lattice box": (lattice_box(8), (0.125, -0.25, 0.0)),
    "torus": (torus(18, 12), (1.0, 0.0, 0.0)),
    "needles": (needle_fan(24), (0.0, 0.0, 0.0)),
    "copies": (hostile(procedural.icosphere(2)), (0.25, 0.0, -0.125)),
}
TRANSFORMS: dict[str, tuple[float, float, type]] = {
    "as it is": (1.0, 0.0, np.float32),
    "times 2^60": (2.0**60, 0.0, np.float32),
    "times 2^-60": (2.0**-60, 0.0, np.float32),
    "times 1e20": (1e20, 0.0, np.float32),
    "times 1e-20": (1e-20, 0.0, np.float32),
    "1e3 diagonals away": (1.0, 3e3, np.float64),
    "1e6 diagonals away": (1.0, 3e6, np.float64),
}


@pytest.mark.thorough
@pytest.mark.parametrize(
    "name", [n if n == "ball" else pytest.param(n, marks=pytest.mark.slow) for n in INSIDES]
)
@pytest.mark.parametrize("how", TRANSFORMS)
def test_the_suggested_suite(name: str, how: str, device: Device) -> None:
    """The suite that paper.md 3.5 asks for: closed meshes met from inside, at vertices, edges, cell corners.

    In 26 directions with zeros of all kinds too, at all scales and far away: all hit, parity right, and in
    every bit what brute force says.
    """
    mesh, point = INSIDES[name]
    scale, offset, dtype = TRANSFORMS[how]
    by = offset * np.array([1, -0.75, 0.5])
    moved = Mesh((mesh.vertices.astype(np.float64) * scale + by).astype(dtype), mesh.faces)
    origin = np.array(point) * scale + by
    rng = np.random.default_rng(35)
    ends = moved.vertices[rng.integers(len(moved.vertices), size=150)].astype(np.float64)
    middles = rng.permutation(edge_middles(moved))[:150]
    lattice = np.linspace(0, 1, 5)[rng.integers(5, size=(100, 3))]
    corners = moved.bounds[0] + lattice * (moved.bounds[1] - moved.bounds[0])
    dust = rng.choice(NEARLY_ZERO[:9], size=(104, 3))
    ways = np.tile(WAYS, (4, 1))
    ways = np.concatenate([*(t - origin for t in (ends, middles, corners)), np.where(ways == 0, dust, ways)])
    ways = ways[(ways != 0).any(axis=1)]
    found = kept(moved, origin, ways, device, resolution=(4, 4, 4), sample=60)
    assert found.all_hit()
    if name != "copies":
        assert (found.counts % 2 == 1).all()
