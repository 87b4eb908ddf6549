"""What went wrong in other walks through grids and voxels, each rebuilt on every strict rung.

Each test's docstring names its source: owner/repository#number of an issue or a pull request, or a file of
published code for compact grids.
"""

from __future__ import annotations

import itertools

import numpy as np
import numpy.typing as npt
import pytest
from agreement import RUNGS, assert_same
from meshes import lattice_box, soup, torus
from promises import kept
from rays import NEARLY_ZERO, Surroundings, surroundings, through_cell_corners
from shapes import WAYS, box, joined

from clgrid.device import Device
from clgrid.mesh import Mesh

# Seconds in all, but the fast part has none to spare: of these, it has test_watertightness_suites.py.
pytestmark = [pytest.mark.slow, pytest.mark.thorough]

F64 = npt.NDArray[np.float64]


def crumbs(rng: np.random.Generator, count: int = 300, size: float = 0.1) -> Mesh:
    """Small triangles all over [-1, 1]^3, and its corners."""
    corners = rng.uniform(-1, 1, (count, 1, 3)) + size * rng.normal(size=(count, 3, 3))
    ends = np.array([[[-1, -1, -1], [-1, -1, -0.9], [-1, -0.9, -1]], [[1, 1, 1], [1, 1, 0.9], [1, 0.9, 1]]])
    return soup(np.concatenate([np.clip(corners, -1, 1), ends]))


def lattice_lines(positions: F64, start: float) -> tuple[F64, F64]:
    """Rays along all axes, both ways, at all pairs of positions; zeros of either sign."""
    origins, ways = [], []
    for axis, sign in itertools.product(range(3), (1.0, -1.0)):
        a, b = (side.reshape(-1) for side in np.meshgrid(positions, positions))
        origins.append(np.insert(np.stack([a, b], -1), axis, -sign * start, axis=1))
        way = np.full((len(a), 3), 0.0)
        way[::2] = -0.0
        way[:, axis] = sign
        ways.append(way)
    return np.concatenate(origins), np.concatenate(ways)


def test_rays_along_grid_edges_drjit_311(device: Device) -> None:
    """mitsuba-renderer/drjit PR#311: rays along edges of the grid are not handled right."""
    steps = np.arange(-8, 9) / 8  # every second one a lattice line of the box, whose cells these nearly are
    origins, ways = lattice_lines(steps, 3.0)
    within = (np.abs(np.where(ways == 0, origins, 0)) < 1).all(axis=1)
    for cells in ((8, 8, 8), (16, 16, 16)):
        found = kept(lattice_box(8), origins, ways, device, resolution=cells, sample=300)
        assert all(hits.mask[within].all() for hits in found.hits.values())
        assert (found.counts[within] == 2).all()
        assert (found.counts % 2 == 0).all()
        t = found.every["exact"].t_hit
        assert set(t.tolist()) == {2.0, 4.0}


def test_axis_parallel_rays_beside_the_grid_drjit_311(device: Device) -> None:
    """mitsuba-renderer/drjit PR#311: axis-aligned rays that pass the grid are reported as hits."""
    outside = np.array([-2.0, -1.25, np.nextafter(-1, -2), np.nextafter(1, 2), 1.0625, 1e9])
    rays = lattice_lines(outside, 3.0)
    found = kept(lattice_box(8), *rays, device, resolution=(8, 8, 8), t_min=-np.inf)
    assert (found.counts == 0).all()
    clear = (np.abs(rays[0]) > 1.01).all(axis=1)
    assert not any(hits.mask[clear].any() for hits in found.hits.values())


def test_a_direction_of_minus_zero_drjit_311(device: Device) -> None:
    """mitsuba-renderer/drjit PR#311: (-1, -0.0) is not traversed. Here the bits are those of +0.0."""
    around = surroundings(torus(18, 12), (5, 4, 6))
    origins = np.stack([np.random.default_rng(a).choice(around.planes[a], 200) for a in range(3)], -1)
    ways = WAYS[np.arange(200) % 26]
    mesh, options = torus(18, 12), {"resolution": (5, 4, 6)}
    plus = kept(mesh, origins - 3 * ways, np.where(ways == 0, 0.0, ways), device, **options)
    minus = kept(mesh, origins - 3 * ways, np.where(ways == 0, -0.0, ways), device, **options)
    for rung in RUNGS:
        assert_same(plus.hits[rung], minus.hits[rung])
        assert_same(plus.every[rung], minus.every[rung])


def test_a_component_of_1e_16_nerfacc_265(device: Device) -> None:
    """nerfstudio-project/nerfacc#265: from (1, 0, 0) of a grid of 32^3, along (-1, -1e-16, 0): nothing."""
    dust = np.array([1e-16, -1e-16, 1e-7, -1e-7, 5e-324, -5e-324, 1e-310, 0.0, -0.0])
    y, z = (side.reshape(-1) for side in np.meshgrid(dust, dust))
    ways = np.stack([np.full(len(y), -1.0), y, z], -1)
    for start, t_min, t in ((1.0, 1e-3, 2.0), (1.0, 0.0, None), (0.5, 0.0, 1.5), (3.0, 0.0, 2.0)):
        found = kept(lattice_box(8), (start, 0, 0), ways, device, t_min, resolution=(32, 32, 32))
        assert found.all_hit()
        if t:
            assert all(np.allclose(hits.t_hit, t, rtol=1e-6) for hits in found.hits.values())


def test_a_reversed_ray_is_not_stuck_openvdb_7(device: Device) -> None:
    """AcademySoftwareFoundation/openvdb#7: voxels at 0, 8 and 24 of tiles of 8; one ray and its reverse."""
    voxels = joined(*(box((x, 0, 0), (x + 1, 1, 1)) for x in (0, 8, 24)))
    for cells in ((25, 1, 1), (4, 2, 2)):
        for y, z in ((0.5, 0.5), (0.0, 0.0), (0.25, 0.5), (1.0, 0.0)):
            rays = [(-1, y, z), (26, y, z)], [(1, 0, 0), (-1, 0, 0)]
            every = kept(voxels, *rays, device, resolution=cells).every["exact"]
            there, back = np.split(every.t_hit, every.ray_splits[1:2])
            assert there.tolist() == (27 - back[::-1]).tolist()
            assert there.tolist() == ([1, 2, 9, 10, 25, 26] if y in (0.25, 0.5) else there.tolist())
            assert len(there) % 2 == 0


def test_rays_that_miss_come_to_an_end_openvdb_1710(device: Device) -> None:
    """AcademySoftwareFoundation/openvdb#1710: an endless ray that misses marches on for ever."""
    far = 10.0 ** np.array([0.5, 3, 9, 30, 100])[:, None, None]
    starts = (far * WAYS).reshape(-1, 3)
    away = np.tile(WAYS, (5, 1))
    assert kept(torus(18, 12), starts, away, device).none_hit()
    aside = np.cross(away, (0.3, -0.7, 0.9))
    assert kept(torus(18, 12), 4 * away, aside, device).none_hit()


def test_every_layer_below_a_ray_is_found_fvdb_72(device: Device) -> None:
    """openvdb/fvdb-core#72: rays straight down through flat voxels of 25 x 28 x 0.6: upper ones missing."""
    heights = np.float32(-0.6051) * np.arange(1, 49, dtype=np.float32)
    width, depth = 25.2165 * 48, 27.9808 * 48
    quad = np.array([[-width, -depth], [width, -depth], [width, depth], [-width, depth]])[[0, 1, 2, 0, 2, 3]]
    flat = np.broadcast_to(quad, (48, 6, 2))
    layers = soup(np.concatenate([flat, np.broadcast_to(heights[:, None, None], (48, 6, 1))], axis=2))
    x, y = np.meshgrid(25.2165 * np.arange(-47, 48, 5), 27.9808 * np.arange(-47, 48, 5))
    origins = np.stack([np.append(x, 0.0), np.append(y, 0.0), np.full(x.size + 1, 10.0)], -1)
    found = kept(layers, origins, (0, 0, -1), device, resolution=(98, 98, 48), sample=20)
    assert (found.counts == 48).all()
    every = found.every["exact"].t_hit.reshape(-1, 48)
    np.testing.assert_allclose(
        every, np.broadcast_to(10 - heights.astype(np.float64), every.shape), rtol=1e-15
    )
    assert all((hits.primitive_ids < 2).all() for hits in found.hits.values())


@pytest.mark.parametrize(
    ("start", "end"), [((-668, -340, 77), (404, -64, -784)), ((-984, 670, -652), (580, 423, -869))]
)
def test_a_walk_between_two_points_ends_fast_voxel_traversal_5(
    start: tuple[int, ...], end: tuple[int, ...], device: Device
) -> None:
    """francisengelmann/fast_voxel_traversal#5, #3, cgyurgyik/fast-voxel-traversal-algorithm#2: no end."""
    a, b = np.array(start, float), np.array(end, float)
    low, high = 16 * np.floor(np.minimum(a, b) / 16 - 1), 16 * np.ceil(np.maximum(a, b) / 16 + 1)
    mesh = joined(box(low, high), box(a - 8, a + 8), box(b - 8, b + 8))
    cells = tuple(((high - low) / 16).astype(int).tolist())
    found = kept(mesh, [a, b], [b - a, a - b], device, t_max=1.0, resolution=cells)
    assert found.counts.tolist() == [2, 2]
    np.testing.assert_array_equal(found.hits["exact"].geometry_ids, [1, 2])


def test_a_ray_parallel_to_an_axis_cpu_voxel_raycaster_3(device: Device) -> None:
    """Forceflow/cpu_voxel_raycaster#3: (0.49, 0.49, -1) along (0, 0, 2) into the unit cube goes wrong."""
    cube, s = box((0, 0, 0), (1, 1, 1)), np.array([0.49, 0.5, 0.25, 1 / 3])
    for axis in range(3):
        origins = np.insert(np.stack([s, s[::-1]], -1), axis, -1.0, axis=1)
        found = kept(cube, origins, 2 * np.eye(3)[axis], device, resolution=(4, 4, 4))
        assert all((hits.t_hit == 0.5).all() for hits in found.hits.values())
        assert (found.counts == 2).all()


def test_negative_coordinates_are_no_other_javidx9_82(device: Device) -> None:
    """OneLoneCoder/Javidx9#82: truncation is floor for positive coordinates only."""
    ring, rng = torus(18, 12), np.random.default_rng(82)
    ring = Mesh(ring.vertices + np.float32(4), ring.faces)
    mirrored = Mesh(-ring.vertices, ring.faces)
    origins, ways = rng.uniform(2, 6, (300, 3)), rng.normal(size=(300, 3))
    there = kept(ring, origins, ways, device, resolution=(7, 6, 5), sample=30)
    back = kept(mirrored, -origins, -ways, device, resolution=(7, 6, 5), sample=30)
    assert there.ids() == back.ids()
    assert set(there.ids()) > {-1}


def test_origins_on_the_bounds_with_zero_components_gvdb_115(device: Device) -> None:
    """NVIDIA/gvdb-voxels#115: 0 / 0 where a ray with zeros starts on the box: it never steps."""
    for mesh in (lattice_box(4), torus(18, 12)):
        low, high = mesh.bounds
        share = np.array(list(itertools.product((0.0, 0.5, 1.0), repeat=3)))
        starts = np.repeat(low + share * (high - low), len(WAYS), axis=0)
        kept(mesh, starts, np.tile(WAYS, (27, 1)), device, resolution=(4, 4, 4), sample=350)


def test_rays_that_are_none_are_none_tigre_779(device: Device) -> None:
    """CERN/TIGRE PR#779: a NaN length becomes a loop of 9e18 steps."""
    ways = np.array([[np.nan, 0, 1], [np.inf, 0, 1], [0, 0, 0], [-0.0, 0, 0], [0, 0, 1]])
    found = kept(box((-1,) * 3, (1,) * 3), (0.25, 0.5, -3), ways, device)
    for hits in found.hits.values():
        assert hits.mask.tolist() == [False] * 4 + [True]
        assert hits.invalid_rays == 4
    assert found.counts.tolist() == [0, 0, 0, 0, 2]


@pytest.mark.parametrize("diagonals", [1.0, 1e3, 1e6])
def test_the_start_cell_of_a_rounded_entry_pbrt_v2(diagonals: float, device: Device) -> None:
    """mmp/pbrt-v2 grid.cpp, TinyRT TRTGridTraversal.h: the start cell and the first crossings disagree."""
    rng, cells = np.random.default_rng(2), (8, 8, 8)
    mesh = crumbs(rng, size=0.02)
    planes = surroundings(mesh, cells).planes
    entries = np.stack([rng.choice(planes[a], 400) for a in range(3)], -1)
    rows, axis = np.arange(400), rng.integers(3, size=400)
    entries[rows, axis] = np.array([side[[0, -1]] for side in planes])[axis, rng.integers(2, size=400)]
    ways = -entries + rng.normal(size=(400, 3)) * rng.choice([0.0, 1e-12, 0.1], size=(400, 1))
    found = kept(mesh, entries - diagonals * ways, ways, device, resolution=cells, sample=50)
    assert found.hits["exact"].mask.any()


@pytest.mark.parametrize("cells", [(1500, 2, 2), (2, 900, 3)], ids=str)
def test_roundings_do_not_pile_up_along_many_cells_pbrt_v2(cells: tuple[int, ...], device: Device) -> None:
    """mmp/pbrt-v2 grid.cpp, elucido: tMax += tDelta adds a rounding at each of a thousand cells."""
    rng = np.random.default_rng(3)
    mesh = crumbs(rng, 200, 0.05)
    around: Surroundings = surroundings(mesh, cells)  # type: ignore[arg-type]
    origins, ways = through_cell_corners(around, 400, rng)
    found = kept(mesh, origins, ways, device, resolution=cells, sample=50)
    assert found.hits["exact"].mask.any()


def test_triangles_within_cell_planes_ericson(device: Device) -> None:
    """Ericson's advice to grow objects; a CompactGrid for Unity, which drops hits that are not in the cell.

    Triangles in planes between cells and a float beside them, met at corners of cells, along and across.
    """
    cells, rng = (6, 6, 6), np.random.default_rng(7)
    hull = box((-1,) * 3, (1,) * 3)
    planes = surroundings(hull, cells).planes
    corners = []
    for axis, side in itertools.product(range(3), range(1, 6)):
        at = np.float32(planes[axis][side])
        for x in (at, np.nextafter(at, np.float32(2)), np.nextafter(at, np.float32(-2))):
            flat = rng.choice(planes[(axis + 1) % 3][1:-1], (3, 2)) + rng.choice([0, 0.2], (3, 2))
            corners.append(np.insert(np.clip(flat, -1, 1), axis, x, axis=1))
    mesh = joined(soup(np.array(corners)), hull)
    ends = np.stack([rng.choice(planes[a], (2, 500)) for a in range(3)], -1)
    ways = np.where(rng.random((500, 1)) < 0.5, ends[1] - ends[0], WAYS[rng.integers(26, size=500)])
    ways[(ways == 0).all(axis=1)] = (0, 1, 0)
    found = kept(mesh, ends[0] - 2 * ways, ways, device, resolution=cells, t_min=-4.0)
    assert (np.array(found.ids()) < len(corners)).any()


def test_a_nearer_triangle_of_a_later_cell_slcompactgrid(device: Device) -> None:
    """SLCompactGrid: a hit ends the walk by the plane just crossed, though nearer ones are in cells ahead."""
    rng = np.random.default_rng(11)
    small = crumbs(rng, 250, 0.05)
    large = soup(np.concatenate([rng.uniform(-1, 1, (40, 3, 3))]))
    mesh = joined(large, small)
    origins, ways = rng.uniform(-1.5, 1.5, (500, 3)), rng.normal(size=(500, 3))
    found = kept(mesh, origins, ways, device, resolution=(12, 12, 12))
    assert {0, 1} <= set(found.hits["exact"].geometry_ids.tolist())


def test_no_zero_of_any_kind_changes_a_walk(device: Device) -> None:
    """All kinds of nothing in one component, as TIGRE, nerfacc and drjit met them: the same triangles."""
    mesh, rng = lattice_box(8), np.random.default_rng(13)
    starts = rng.uniform(-0.9, 0.9, (60, 3))
    for axis in range(3):
        ways = [np.insert(rng.normal(size=(60, 2)), axis, 0.0, axis=1)]
        ways += [np.where(ways[0] == 0, dust, ways[0]) for dust in NEARLY_ZERO if abs(dust) <= 1e-30]
        found = [kept(mesh, starts, way, device, resolution=(8, 8, 8), sample=10).ids() for way in ways]
        assert all(ids == found[0] for ids in found)
