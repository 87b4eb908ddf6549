"""Tiles of rays change no bit: every answer is that of brute force, however rays are dealt to tiles."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from agreement import KINDS, RUNGS, Query
from bundles import GRID, TILE, around_hits, assert_brute, bundles, orders, shaped, tiles_as_given, view
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from meshes import MESHES, lattice_box, moved, scaled, soup, torus
from rays import NEARLY_ZERO, surroundings
from shapes import joined
from test_extremes import cone

from clgrid import memory, procedural, target
from clgrid.brute import brute_force, brute_force_count
from clgrid.camera import Camera
from clgrid.device import Device
from clgrid.grid import build
from clgrid.hits import Hits
from clgrid.mesh import Mesh
from clgrid.renderer import render
from clgrid.tuning import Tuning, tried

F64 = npt.NDArray[np.float64]
TUNINGS = {
    "together": Tuning(widest_slice=1_000_000, fewest_together=1, remembered=8),
    "in turns": Tuning(fewest_in_turns=0),
    "mostly in turns": Tuning(fewest_in_turns=0, widest_slice=4, fewest_together=40, herd=3),
}
RESOLUTIONS = ((5, 4, 6), (8, 8, 8), (1, 1, 1), (1, 1, 40), (33, 2, 3), (24, 24, 24))


# --- tiles of every kind -------------------------------------------------------------------------------


def assert_tiles(mesh: Mesh, device: Device, accuracy: str, seed: int, count: int, **options: Any) -> Hits:
    """Tiles of all kinds, and the same with intervals that begin or end at their hits."""
    rng = np.random.default_rng([601, seed])
    resolution = options.setdefault("resolution", RESOLUTIONS[rng.integers(len(RESOLUTIONS))])
    rays = bundles(surroundings(mesh, resolution), count, rng)
    grid = build(mesh, accuracy=accuracy, device=device, **options)
    with pytest.MonkeyPatch.context() as patch, tiles_as_given(patch):
        hits = assert_brute(mesh, device, accuracy, rays, [grid])
        assert_brute(mesh, device, accuracy, around_hits(rays, hits.t_hit, rng), [grid])
    return hits


@pytest.mark.parametrize("accuracy", RUNGS)
def test_tiles_change_no_bit(accuracy: str, device: Device) -> None:
    for name, resolution in (("soup", (8, 8, 8)), ("lattice_box", (8, 8, 8)), ("flat", (5, 4, 6))):
        hits = assert_tiles(MESHES[name], device, accuracy, 1, 40, resolution=resolution)
        assert 0.1 < hits.mask.mean() < 0.9


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize("accuracy", RUNGS)
@pytest.mark.parametrize("name", [name for name in MESHES if name != "float64_times_1e100"])
def test_tiles_change_no_bit_of_any_mesh(name: str, accuracy: str, device: Device) -> None:
    for seed in range(2, 6):
        assert_tiles(MESHES[name], device, accuracy, seed, 60)


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize("accuracy", RUNGS)
@pytest.mark.parametrize(("layout", "skipping"), KINDS)
def test_tiles_in_any_layout(layout: str, skipping: bool, accuracy: str, device: Device) -> None:
    for name, resolution in (("torus", (24, 24, 24)), ("stacks", (33, 2, 3)), ("needle_fan", (8, 8, 8))):
        options = {"resolution": resolution, "layout": layout, "skipping": skipping}
        assert_tiles(MESHES[name], device, accuracy, 7, 60, **options)


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize("accuracy", RUNGS)
@pytest.mark.parametrize("most", [100_000, 12_000])
def test_tiles_in_several_parts(
    most: int, accuracy: str, device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    mesh = procedural.icosphere(4)
    # Copies: a hit in a later part that is as near loses.
    mesh = Mesh(mesh.vertices, np.concatenate([mesh.faces, mesh.faces[::3]]))
    build(mesh, accuracy=accuracy, device=device)  # the self-test needs larger buffers
    with monkeypatch.context() as patch:
        for module in (memory, target):
            patch.setattr(module, "largest_buffer", lambda device: most)
        grid = build(mesh, density=4, skipping=True, accuracy=accuracy, device=device)
    assert grid.stats.parts > 1
    rays = bundles(surroundings(mesh, (9, 9, 9)), 60, np.random.default_rng(8))
    with tiles_as_given(monkeypatch):
        hits = assert_brute(mesh, device, accuracy, rays, [grid])
    assert hits.mask.mean() > 0.2


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize("accuracy", RUNGS)
@pytest.mark.parametrize("numbers", TUNINGS)
def test_tiles_by_any_tuning(numbers: str, accuracy: str, device: Device) -> None:
    """All rays together or few; those that go alone in turns, as on large meshes."""
    with tried(TUNINGS[numbers]):
        for name, layout, skipping in (("soup", "compact", False), ("torus", "hashed", True)):
            assert_tiles(MESHES[name], device, accuracy, 9, 40, layout=layout, skipping=skipping)


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize("accuracy", RUNGS)
@pytest.mark.parametrize(
    "resolution", [(1, 1, 200), (200, 1, 1), (1, 3000, 1), (150, 150, 150), (1, 1, 20_000)], ids=str
)
def test_tiles_in_grids_of_any_shape(resolution: tuple[int, int, int], accuracy: str, device: Device) -> None:
    for name in ("soup", "flat", "one", "line"):
        count = 40 if max(resolution) < 20_000 else 4
        assert_tiles(MESHES[name], device, accuracy, 10, count, resolution=resolution)


def one_large() -> Mesh:
    rng = np.random.default_rng(11)
    small = rng.uniform(-1, 1, (200, 1, 3)) + 1e-3 * rng.normal(size=(200, 3, 3))
    large = np.array([[[-1, -1, -1], [1, 1, -0.5], [-0.5, 1, 1]], [[-1.0, 1, -1], [1, -1, 0.1], [1, 1, 1]]])
    return soup(np.concatenate([small[:100], large, small[100:]]))


def bad_ones() -> Mesh:
    """Duplicates, no area, needles, and two sheets a rounding apart."""
    rng = np.random.default_rng(12)
    ball = torus(12, 8).vertices[torus(12, 8).faces].astype(np.float64)
    lines = np.stack([ball[:, 0], ball[:, 1], (ball[:, 0] + ball[:, 1]) / 2], axis=1)
    a, b = rng.uniform(-1, 1, (2, 100, 3))
    needles = np.stack([a, b, a + 0.4 * (b - a) + 1e-7 * rng.normal(size=(100, 3))], axis=1)
    points = np.repeat(ball[:, :1], 3, axis=1)
    # Not next to 0, which exact refuses beside coordinates of 1.
    beside = np.where(ball == 0, 0, np.nextafter(ball, 9))
    return soup(np.concatenate([ball, ball[::-1], lines, points, needles, beside]), np.float64)


ODD = {
    "one_large": one_large,
    "bad_ones": bad_ones,
    "copies": lambda: Mesh(np.eye(3, dtype=np.float32), np.tile(np.arange(3, dtype=np.uint32), (900, 1))),
    "float64_offset": lambda: moved(torus(), 3.0e5 + 1 / 3, np.float64),
    "float64_1e-20": lambda: scaled(torus(), 1e-20 / 3, np.float64),
    "float64_1e20": lambda: scaled(torus(), 1e20 / 3, np.float64),
    "thin": lambda: scaled(
        Mesh(lattice_box(6).vertices * np.float32([1, 1, 2.0**-23]), lattice_box(6).faces), 1
    ),
    "rod": lambda: Mesh(lattice_box(6).vertices * np.float32([1, 2.0**-12, 2.0**-12]), lattice_box(6).faces),
}


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize("accuracy", RUNGS)
@pytest.mark.parametrize("name", ODD)
def test_tiles_over_odd_meshes(name: str, accuracy: str, device: Device) -> None:
    for seed in range(13, 17):
        assert_tiles(ODD[name](), device, accuracy, seed, 50)


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize("accuracy", RUNGS)
def test_tiles_at_a_vertex_of_100_000_triangles(accuracy: str, device: Device) -> None:
    """For exact, rays must decide so often by integers that they leave their tile and test all."""
    mesh = cone(50_000, 52).mesh
    rays = view((0.25, 0.125, 3.0), 16, 8, 1e-9, (0, 0, 1))
    rays[0][:, 8:] = (0.25, 0.125, 0.5)
    rays[1][:, 8:] = np.array([0, 0, 1.0]) - rays[0][:, 8:]
    with pytest.MonkeyPatch.context() as patch, tiles_as_given(patch, 16):
        hits = assert_brute(mesh, device, accuracy, rays, [{"density": 4}])
    assert hits.mask.any()
    if accuracy == "exact":
        assert not hits.certain.all()


# --- a ray of a tile -----------------------------------------------------------------------------------


@pytest.mark.parametrize("accuracy", RUNGS)
def test_one_ray_that_is_none_spoils_no_other(accuracy: str, device: Device) -> None:
    """Without direction, not finite, of no interval: each alone among 63 good ones, in any place."""
    mesh = MESHES["torus"]
    grid = build(mesh, accuracy=accuracy, device=device, **GRID)
    good = view((0.5, 1.5, 2.5), 8, 8)
    spoils: list[tuple[int, Any]] = [(1, 0.0), (1, -0.0), (2, 1e300), (3, -1e300), (2, np.inf), (3, -np.inf)]
    spoils += [(side, value) for side in (0, 1) for value in (np.nan, np.inf, -np.inf)]
    spoils += [(side, np.nan) for side in (2, 3)]
    tiles = []
    for number, (side, value) in enumerate(spoils):
        rays = tuple(array.reshape(TILE, *array.shape[2:]).copy() for array in good)
        rays[side][(number * 23 + 5) % TILE] = value
        tiles.append(rays)
    o, d, low, high = (np.concatenate(side) for side in zip(*tiles, strict=True))
    with pytest.MonkeyPatch.context() as patch, tiles_as_given(patch):
        hits = assert_brute(mesh, device, accuracy, (o, d, low, high), [grid])
    assert hits.invalid_rays == 10
    lone = brute_force(mesh, *good, device=device, accuracy=accuracy).primitive_ids.reshape(-1)
    assert (hits.primitive_ids.reshape(-1, TILE) == lone).sum(axis=1).min() >= TILE - 1


@pytest.mark.thorough
@pytest.mark.parametrize("count", [1, 2, 11, 12, 13, 63, 64, 65, 4095])
def test_few_rays(count: int, device: Device) -> None:
    o, d, low, high = (side.reshape(4096, *side.shape[2:])[:count] for side in view((1, 2, 3), 64, 64))
    assert_brute(MESHES["torus"], device, "robust", (o, d, low, high))


@pytest.mark.parametrize("others", [11, 12, 13, 52, 53])
def test_rays_of_another_axis_or_way(others: int, device: Device) -> None:
    """As many of a tile as go one by one, or one more: of another major axis, and of the opposite way."""
    o, d, _, high = (side.reshape(TILE, *side.shape[2:]) for side in view((0.2, 0.1, 0.3), 8, 8, 70))
    turned, back = d.copy(), d.copy()
    turned[:others] = turned[:others][:, [2, 0, 1]]
    back[64 - others :] *= -1
    rays = shaped(np.tile(o, (2, 1)), np.concatenate([turned, back]), -np.inf, np.tile(high, 2))
    with pytest.MonkeyPatch.context() as patch, tiles_as_given(patch):
        for accuracy in RUNGS:
            assert assert_brute(MESHES["torus"], device, accuracy, rays).mask.any()


def parallel(way: npt.ArrayLike, side: int, reach: float) -> Query:
    """An orthographic picture of side x side rays along a way."""
    way = np.asarray(way, np.float64)
    axis = int(np.abs(way).argmax())
    across = np.linspace(-reach, reach, side)
    origins = np.zeros((side, side, 3))
    origins[..., (axis + 1) % 3], origins[..., (axis + 2) % 3] = across[None, :], across[:, None]
    return shaped(origins - 3 * way, way)


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize("accuracy", RUNGS)
def test_parallel_rays_through_the_vertices_of_a_lattice(accuracy: str, device: Device) -> None:
    """Vertices lie on planes of the grid; rays go through them, along edges, in the planes of faces."""
    mesh = lattice_box(8)
    for axis in range(3):
        for sign in (1.0, -1.0):
            for small in NEARLY_ZERO:
                way = np.full(3, small)
                way[axis] = sign
                rays = parallel(way, 17, 1.0)
                hits = assert_brute(mesh, device, accuracy, rays, [{"resolution": (8, 8, 8)}, {"density": 8}])
                assert hits.mask[1:-1, 1:-1].all()


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize("accuracy", RUNGS)
def test_beams_that_graze_the_bounds(accuracy: str, device: Device) -> None:
    """Sheets in the sides of a box, seen along them: by beams that enter or leave within a rounding."""
    mesh, grids = lattice_box(8), [{"resolution": (8, 8, 8)}, {"resolution": (3, 40, 7)}]
    for tilt in (0.0, 2.0**-30, 2.0**-21, 2.0**-20, 2.0**-19, 2.0**-12):
        for off in (0.0, 2.0**-53, 2.0**-24, 2.0**-20, 2.0**-18, 2.0**-17, 2.0**-16, 2.0**-15):
            o, d, low, high = parallel((1.0, tilt, -tilt), 16, 2.0**-17)
            sides = [(sign * (1 + off), sign * side) for sign in (1, -1) for side in (1, 0.3)]
            o = np.concatenate([o + np.array([0, *side]) for side in sides])
            d = np.tile(d, (4, 1, 1))
            rays = shaped(o, d, np.tile(low, (4, 1)), np.tile(high, (4, 1)))
            with pytest.MonkeyPatch.context() as patch, tiles_as_given(patch, 16):
                assert_brute(mesh, device, accuracy, rays, grids)


# --- images and other batches --------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize("accuracy", RUNGS)
@pytest.mark.parametrize("width", [16, 17, 63, 64, 65, 100])
@pytest.mark.parametrize("height", [2, 8, 13, 30])
def test_images_of_any_size_in_any_order(width: int, height: int, accuracy: str, device: Device) -> None:
    mesh, rng = MESHES["soup"], np.random.default_rng(20)
    grid = build(mesh, accuracy=accuracy, device=device, density=4)
    for fov in (50, 140):  # the second looks over the diagonals
        for name, rays in orders(view((1.5, 1.5, 1.5), width, height, fov), rng):
            hits = assert_brute(mesh, device, accuracy, rays, [grid])
            # Two rows may pass between the triangles.
            assert hits.mask.any() or height == 2, name


def fish_eye(side: int) -> F64:
    """Directions over the whole sphere."""
    down, round_ = (np.arange(side) + 0.5) * np.pi / side, np.arange(side) * 2 * np.pi / side
    x, z = np.sin(down)[:, None] * np.cos(round_), np.sin(down)[:, None] * np.sin(round_)
    return np.stack([x, np.broadcast_to(np.cos(down)[:, None], x.shape), z], axis=-1)


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize("accuracy", RUNGS)
@pytest.mark.parametrize(
    "name", ["soup", "lattice_box", "stacks", "far_float64", "times_1e-20", "times_1e20"]
)
def test_views_of_all_kinds(name: str, accuracy: str, device: Device) -> None:
    mesh, rng = MESHES[name], np.random.default_rng(21)
    around = surroundings(mesh, (5, 4, 6))
    grids = [build(mesh, accuracy=accuracy, device=device, **GRID), {"density": 30, "skipping": True}]
    centre, size = around.centre, around.diagonal
    o, d, _, _ = view((1.5, 1.5, 1.5), 48, 40, 100)
    near = shaped(centre + size * o / 2, size * d)
    hits = assert_brute(mesh, device, accuracy, near, grids)
    views = [shaped(centre, fish_eye(40), -np.inf), shaped(around.corners[0, 0], fish_eye(24) * size)]
    for distance in (1e1, 1e3, 1e6):  # beyond START_LIMIT
        o, d, _, _ = view((0.3 * distance, distance, 0.6 * distance), 24, 24, np.degrees(1 / distance))
        views.append(shaped(centre + size * o, d))
    points = (near[0] + np.where(hits.mask, hits.t_hit, 0)[..., None] * near[1])[hits.mask]
    light = around.high + size * np.array([0.1, 0.7, 0.2])
    views.append(shaped(points, light - points, 1e-6, 1.0))
    views.append(shaped(points, -near[1][hits.mask], np.where(rng.random(len(points)) < 0.5, -1.0, 0.0)))
    for rays in views:
        assert_brute(mesh, device, accuracy, rays, grids)


# --- any camera, any mesh ------------------------------------------------------------------------------

_COORDINATE = st.one_of(
    st.integers(-4, 4).map(float), st.floats(-4, 4), st.floats(-1e6, 1e6), st.sampled_from(NEARLY_ZERO)
)
_POINT = st.tuples(_COORDINATE, _COORDINATE, _COORDINATE)


@st.composite
def small_meshes(draw: st.DrawFn) -> Mesh:
    """On a lattice, so that corners and edges are shared, or anywhere; of any flatness."""
    count = draw(st.integers(1, 40))
    rng = np.random.default_rng(draw(st.integers(0, 1 << 16)))
    points = (
        rng.integers(-3, 4, (12, 3)).astype(float) if draw(st.booleans()) else rng.uniform(-3, 3, (12, 3))
    )
    flat = draw(st.sampled_from([(1, 1, 1), (1, 1, 0), (0, 1, 2.0**-20), (2.0**-12, 1, 2.0**-12)]))
    faces = rng.integers(0, 12, (count, 3)).astype(np.uint32)
    return Mesh((points * flat).astype(draw(st.sampled_from([np.float32, np.float64]))), faces)


@st.composite
def cameras(draw: st.DrawFn) -> Camera:
    """Anywhere, looking anywhere, with any field of view."""
    eye = np.array(draw(_POINT))
    way = np.array(draw(st.tuples(*[st.sampled_from([-1.0, 0.0, 1.0, 0.3, -0.7, *NEARLY_ZERO])] * 3)))
    if draw(st.booleans()):
        way = np.array(draw(_POINT)) - eye
    if not way.any():
        way = np.array([0.0, 0.0, 1.0])
    way = way / np.abs(way).max()
    axis = np.abs(way).argmin()
    fov = draw(st.one_of(st.floats(1e-6, 179.9), st.sampled_from([1e-9, 40.0, 90.0, 150.0])))
    return replace(Camera.look_at(np.zeros(3), way, np.eye(3)[axis], fov), eye=eye)


@st.composite
def camera_rays(draw: st.DrawFn) -> Query:
    """Of a picture of any size."""
    o, d = draw(cameras()).rays(draw(st.integers(1, 40)), draw(st.integers(1, 40)))
    low, high = draw(
        st.sampled_from([(0.0, np.inf), (-np.inf, np.inf), (-np.inf, 0.0), (1.0, 3.0), (2.0, 2.0)])
    )
    return shaped(o, d, low, high)


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize("accuracy", RUNGS)
@settings(max_examples=200, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(
    mesh=small_meshes(),
    rays=camera_rays(),
    density=st.sampled_from([0.05, 1.0, 4.0, 60.0]),
    layout=st.just("compact"),
)
def test_any_camera_sees_what_brute_force_sees(
    mesh: Mesh, rays: Query, density: float, layout: str, accuracy: str, device: Device
) -> None:
    options = {"density": density, "layout": layout}
    assert_brute(mesh, device, accuracy, rays, [options])
    with pytest.MonkeyPatch.context() as patch, tiles_as_given(patch, rays[0].shape[1]):
        assert_brute(mesh, device, accuracy, rays, [options])


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize("accuracy", RUNGS)
@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(
    mesh=small_meshes(),
    camera=cameras(),
    size=st.tuples(st.integers(1, 60), st.integers(1, 60)),
    density=st.sampled_from([0.05, 1.0, 4.0, 60.0]),
    layout=st.sampled_from(["compact", "hashed"]),
    skipping=st.booleans(),
)
def test_any_picture_shows_what_brute_force_finds(
    mesh: Mesh,
    camera: Camera,
    size: tuple[int, int],
    density: float,
    layout: str,
    skipping: bool,
    accuracy: str,
    device: Device,
) -> None:
    """Pictures go by blocks of tiles, those that pass no list are not cast (cl/way.h)."""
    grid = build(mesh, density=density, layout=layout, skipping=skipping, accuracy=accuracy, device=device)
    image = render(mesh, camera, *size, ("depth", "id"), grid=grid)
    hits = brute_force(mesh, *camera.rays(*size), device=device, accuracy=accuracy)
    assert image.depth is not None
    assert image.primitive_id is not None
    np.testing.assert_array_equal(image.primitive_id, hits.primitive_ids.astype(np.uint32))
    np.testing.assert_array_equal(image.depth, hits.t_hit.astype(np.float32))


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize("accuracy", RUNGS)
def test_occluded_is_count_again_and_again(accuracy: str, device: Device) -> None:
    """60,000 shadow rays from what a picture shows: no buffer goes before it was read."""
    ball = procedural.icosphere(3)
    mesh = joined(ball, Mesh(0.3 * ball.vertices + np.float32(1), ball.faces))
    grid = build(mesh, accuracy=accuracy, device=device, density=4)
    o, d, _, _ = view((3, 3, 2), 420, 420, 32)
    hits = grid.cast(o, d)
    points = (o + np.where(hits.mask, hits.t_hit, 0)[..., None] * d)[hits.mask][:60_000]
    assert len(points) == 60_000
    towards = np.array([2.0, 3.0, 4.0]) - points
    counts = brute_force_count(mesh, points, towards, 1e-4, 1, device=device, accuracy=accuracy)
    assert 0.1 < (counts > 0).mean() < 0.9
    np.testing.assert_array_equal(grid.count(points, towards, 1e-4, 1), counts)
    for _ in range(12):
        np.testing.assert_array_equal(grid.occluded(points, towards, 1e-4, 1), counts > 0)
