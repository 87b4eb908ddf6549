"""Pictures in stages: the same bits whatever draws them, in what order; windows; parallel rays; samples."""

from __future__ import annotations

import numpy as np
import pytest
from shaded import WHITE, plain_look, quad, scene_of
from test_shading import LEAVES, checks

from clgrid import memory, target
from clgrid.camera import Camera
from clgrid.errors import InputError
from clgrid.grid import build
from clgrid.image import NO_ID, Image, read_image
from clgrid.look import Light, Look, Material, Shading, Texture, TextureUse
from clgrid.mesh import Mesh
from clgrid.procedural import icosphere
from clgrid.renderer import AOVS, PLAIN_AOVS, render
from clgrid.shading import passing, staged

CAMERA = Camera.look_at((1.2, -2.4, 2.1), (0, 0, 0.3), (0, 0, 1), fov=50)
SIZE = (75, 53)
LAMPS = (
    Light("point", (1, 0.8, 0.6), 9, (1, -1, 2.5)),
    Light("spot", (0.5, 0.7, 1), 9, (-1, 1, 3), (0.3, -0.3, -1), inner_cone=0.2, outer_cone=0.5),
)
SHADING = Shading(samples=3, seed=11, sun=(1, 2, 3), sky=(0.3, 0.4, 0.5), occlusion_rays=5)
ARRAYS = (
    "rgba",
    "depth",
    "normal",
    "primitive_id",
    "geometry_id",
    "t_err",
    "position",
    "uv",
    "albedo",
    "coverage",
)


def everything() -> tuple[Mesh, Look]:
    """A floor, masked leaves over it, a single-sided sheet, a ball with smooth normals and vertex colours."""
    rng = np.random.default_rng(2)
    picture = Texture(rng.integers(0, 256, (5, 7, 4), dtype=np.uint8), ("mirror", "clamp"))
    shown = Material(
        "picture", base_texture=TextureUse(1), emissive_texture=TextureUse(1), emissive=(0.1, 0.2, 0.3)
    )
    paper = Material("paper", double_sided=False)
    mesh, look = scene_of(
        [quad(half=3), quad(1.1, 0.7), quad(1.6, 0.4)], [shown, LEAVES, paper], [checks(), picture]
    )
    ball = icosphere(2)
    count = len(mesh.vertices)
    vertices = np.concatenate([mesh.vertices, ball.vertices * np.float32(0.45) + np.float32([0, 0, 0.5])])
    normals = np.concatenate([np.tile(np.float32([0, 0, 1]), (count, 1)), ball.vertices])
    whole = Mesh(
        vertices, np.concatenate([mesh.faces, ball.faces + np.uint32(count)]), vertex_normals=normals
    )
    uvs = np.concatenate([look.uvs[0], ball.vertices[:, :2]])
    ids = np.concatenate([look.material_ids, np.full(len(ball.faces), 3)]).astype(np.uint16)
    colours = rng.random((len(vertices), 4)).astype(np.float32)
    colours[:count] = 1
    return whole, Look((*look.materials, WHITE), ids, look.textures, (uvs,), (None,), colours, LAMPS)


def bits(image: Image) -> dict[str, bytes]:
    return {name: getattr(image, name).tobytes() for name in ARRAYS if getattr(image, name) is not None}


AOVS_BUT_STEPS = tuple(name for name in AOVS if name != "steps")


@pytest.fixture(scope="module")
def whole() -> tuple[Mesh, Look]:
    return everything()


@pytest.mark.slow
def test_shaded_pictures_are_the_same_bits_on_every_device(all_devices, whole):
    mesh, look = whole
    pictures = [
        render(mesh, CAMERA, *SIZE, AOVS_BUT_STEPS, look=look, shading=SHADING, device=device, density=4)
        for device in all_devices
    ]
    assert set(bits(pictures[0])) == set(ARRAYS)
    assert len(np.unique(pictures[0].rgba[..., 0])) > 1000
    assert set(np.unique(pictures[0].primitive_id)) & {2, 3}
    for other in pictures[1:]:
        assert bits(other) == bits(pictures[0])


@pytest.mark.host
def test_no_order_of_the_work_changes_a_shaded_picture(device, whole, monkeypatch):
    mesh, look = whole
    grid = build(mesh, device=device, density=4)

    def drawn(**more) -> Image:
        return render(mesh, CAMERA, *SIZE, AOVS_BUT_STEPS, look=look, shading=SHADING, grid=grid, **more)

    full = drawn()
    shares: list[float] = []
    monkeypatch.setattr(staged, "_TILE_RAYS", 300)
    monkeypatch.setattr(staged, "_TILE_COLUMNS", 20)
    monkeypatch.setattr(staged, "_SKY_RAYS", 400)
    monkeypatch.setattr(passing, "_RAYS_AT_ONCE", 50)
    assert bits(drawn(progress=shares.append)) == bits(full)
    assert len(shares) > 8
    assert shares == sorted(shares)
    assert shares[-1] == 1
    # A window has the bits of the whole.
    part = drawn(crop=(13, 9, 60, 41))
    assert (part.width, part.height, part.crop, part.full_size) == (47, 32, (13, 9), SIZE)
    assert part.metadata["clgrid:crop"] == "13 9 60 41"
    for name in ARRAYS:
        assert getattr(part, name).tobytes() == getattr(full, name)[9:41, 13:60].tobytes(), name
    seeds = [
        render(mesh, CAMERA, *SIZE, look=look, shading=Shading(2, seed), grid=grid).rgba for seed in (0, 1)
    ]
    assert (seeds[0] != seeds[1]).any()


@pytest.mark.host
def test_a_mesh_in_several_grids_is_shaded_alike(device, whole, monkeypatch):
    mesh, look = whole
    one = build(mesh, device=device, density=4)
    with monkeypatch.context() as patch:
        for module in (memory, target):
            patch.setattr(module, "largest_buffer", lambda device: 1200)
        several = build(mesh, device=device, density=4)
    assert several.stats.parts > 1
    assert any(part.mesh.used is not None for part in several.parts)
    pictures = [
        render(mesh, CAMERA, *SIZE, AOVS_BUT_STEPS, look=look, shading=SHADING, grid=grid)
        for grid in (one, several)
    ]
    assert bits(pictures[0]) == bits(pictures[1])


@pytest.mark.host
def test_a_window_of_a_plain_picture_has_the_bits_of_the_whole(device):
    mesh, camera = icosphere(3), Camera.look_at((1.3, 0.7, 1.9), (0.1, 0, 0), fov=55)
    grid = build(mesh, device=device, density=4)
    whole = render(mesh, camera, 83, 59, PLAIN_AOVS, grid=grid)
    for x0, y0, x1, y1 in ((0, 0, 83, 59), (11, 7, 70, 50), (82, 58, 83, 59), (40, 0, 41, 59)):
        part = render(mesh, camera, 83, 59, PLAIN_AOVS, grid=grid, crop=(x0, y0, x1, y1))
        for name in (*ARRAYS[:6], "steps"):
            assert getattr(part, name).tobytes() == getattr(whole, name)[y0:y1, x0:x1].tobytes(), name
    for crop in ((0, 0, 84, 59), (5, 5, 5, 9), (-1, 0, 3, 3), (0, 0, 1.5, 2), (1, 2, 3)):
        with pytest.raises(InputError, match="crop"):
            render(mesh, camera, 83, 59, grid=grid, crop=crop)


@pytest.mark.host
def test_further_aovs_change_no_bit_of_a_plain_picture(device, tmp_path):
    ball = icosphere(3)
    mesh = Mesh(ball.vertices, ball.faces, vertex_normals=ball.vertices * np.float32(-3))
    camera = Camera.look_at((1.3, 0.7, 1.9), (0.1, 0, 0), fov=55)
    grid = build(mesh, device=device, density=4)
    plain, more = (render(mesh, camera, 83, 59, names, grid=grid) for names in (PLAIN_AOVS, AOVS))
    for name in (*ARRAYS[:6], "steps"):
        assert getattr(more, name).tobytes() == getattr(plain, name).tobytes(), name
    np.testing.assert_array_equal(more.coverage, plain.rgba[..., 3])
    hits = grid.cast(*camera.rays(83, 59))
    np.testing.assert_allclose(more.position[hits.mask], hits.points[hits.mask], atol=2e-6)
    assert (more.uv == 0).all()
    assert (more.albedo == np.where(hits.mask[..., None], np.float32(0.8), 0)).all()
    more.save(tmp_path / "a.exr")
    back = read_image(tmp_path / "a.exr")
    assert bits(back) == bits(more)


@pytest.mark.host
def test_a_picture_of_parallel_rays_shows_what_they_hit(device):
    mesh = icosphere(3)
    camera = Camera.look_at((3, 1, 2), (0, 0, 0), orthographic_height=2.3)
    grid = build(mesh, device=device, view=camera, density=4)
    picture = render(mesh, camera, 61, 47, AOVS, grid=grid)
    hits = grid.cast(*camera.rays(61, 47), fields=("steps", "t_err"))
    assert 0.3 < hits.mask.mean() < 0.9
    np.testing.assert_array_equal(picture.primitive_id, np.where(hits.mask, hits.primitive_ids, NO_ID))
    np.testing.assert_array_equal(picture.depth, hits.t_hit.astype(np.float32))
    np.testing.assert_array_equal(picture.steps, hits.steps)
    assert (picture.t_err >= hits.t_err).all()
    # The light comes from where the view goes to.
    facing = np.abs((hits.primitive_normals * camera.forward).sum(-1))
    expected = np.where(hits.mask, 0.8 * (0.1 + 0.9 * facing), 0.9)
    np.testing.assert_allclose(picture.rgba[..., 1], expected, rtol=1e-6)
    part = render(mesh, camera, 61, 47, AOVS, grid=grid, crop=(20, 10, 50, 40))
    assert part.rgba.tobytes() == picture.rgba[10:40, 20:50].tobytes()


@pytest.mark.host
def test_samples_are_averaged_over_the_pixel(device):
    """A half plane covers a share of a pixel; other AOVs are of the middle."""
    mesh, _ = scene_of([quad(0, 1, (-1 + 1 / 16, 0))], [WHITE])
    look = plain_look(mesh)
    camera = Camera.look_at((0, 0, 3), (0, 0, 0), (0, 1, 0), orthographic_height=2)
    grid = build(mesh, device=device, density=4)

    def drawn(samples: int) -> Image:
        shading = Shading(samples, sky=(1.0, 1.0, 1.0))
        return render(mesh, camera, 8, 8, AOVS, look=look, shading=shading, grid=grid, background=(0, 0, 0))

    # The edge is at x = 1 / 16: a quarter into column 4.
    for samples in (4, 16, 256):
        picture = drawn(samples)
        assert (picture.coverage[:, :4] == 1).all()
        assert (picture.coverage[:, 5:] == 0).all()
        assert (np.abs(picture.coverage[:, 4] - 0.25) <= 1 / samples**0.5).all()
        np.testing.assert_array_equal(picture.rgba, np.repeat(picture.coverage[..., None], 4, -1))
        for name in ("depth", "normal", "primitive_id", "position", "uv", "albedo", "steps", "t_err"):
            assert getattr(picture, name).tobytes() == getattr(drawn(1), name).tobytes(), name
    assert (drawn(256).coverage[:, 4] == 0.25).all() or abs(drawn(256).coverage[:, 4].mean() - 0.25) < 0.01
    assert (drawn(1).coverage[:, 4] == 0).all()


@pytest.mark.host
def test_nothing_to_draw_is_background_in_stages_too(device):
    empty = Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint32))
    picture = render(
        empty, None, 9, 5, AOVS, shading=Shading(sun=(0, 0, 1)), background=(1, 0, 0), device=device
    )
    assert (picture.rgba == [1, 0, 0, 0]).all()
    assert (picture.position == 0).all()
    assert (picture.coverage == 0).all()
