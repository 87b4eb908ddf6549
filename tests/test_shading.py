"""Light in pictures: against what is known in closed form."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from shaded import WHITE, plain_look, quad, scene_of

from clgrid.camera import Camera
from clgrid.device import Device
from clgrid.errors import InputError
from clgrid.look import Light, Look, Material, Shading, Texture, TextureUse
from clgrid.mesh import Mesh
from clgrid.procedural import cube, icosphere
from clgrid.renderer import render

# On one device; that all answer alike is tried in test_shading_bits.py.
pytestmark = pytest.mark.host

FRONT = Camera.look_at((0, 0, 5), (0, 0, 0), fov=40)
ONE = (1.0, 1.0, 1.0)


def from_above(height: float, wide: float) -> Camera:
    """Parallel rays down from a height, x to the right and y up in a square picture."""
    return Camera.look_at((0, 0, height), (0, 0, 0), (0, 1, 0), orthographic_height=wide)


def places(camera: Camera, side: int) -> np.ndarray:
    """(side, side, 3): where the pixels' rays meet z = 0."""
    origins, _ = camera.rays(side, side)
    return origins * [1, 1, 0]


def draw(mesh: Mesh, camera: Camera, side: int, device: Device, shading: Shading, look: Look, **more):
    more = {"background": (0, 0, 0), "density": 4, **more}
    return render(mesh, camera, side, side, look=look, shading=shading, device=device, **more)


def test_a_white_furnace_shows_nothing(device):
    """Albedo 1 under a sky of 1 all round: what is convex vanishes, and what is not where all sky is open."""
    ball, corner = (
        icosphere(3),
        Mesh(
            np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0], [1, -1, 2], [1, 1, 2]], np.float32),
            np.array([[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2]], np.uint32),
        ),
    )
    for mesh, shading in (
        (ball, Shading(sky=ONE)),
        (
            ball,
            Shading(sky=ONE, samples=3, occlusion_rays=9),
        ),  # no ray is stopped by the surface that it leaves
        (corner, Shading(sky=ONE, samples=2)),
    ):
        picture = draw(mesh, FRONT, 48, device, shading, plain_look(mesh), background=ONE)
        assert (picture.rgba[..., :3] == 1).all()
        assert 0.1 < picture.rgba[..., 3].mean() < 0.9
    shut = draw(
        corner, FRONT, 48, device, Shading(sky=ONE, occlusion_rays=9), plain_look(corner), background=ONE
    )
    assert shut.rgba[..., 0].min() < 0.7


@pytest.mark.thorough
@pytest.mark.parametrize("smooth", [False, True])
def test_normals_are_of_length_one_and_those_of_plain_pictures(device, smooth):
    """Cross products of triangles as small as these are far from 1; lifts and lights want unit ones."""
    ball = icosphere(3)
    normals = ball.vertices * np.float32(-0.2) if smooth else None
    mesh = Mesh(ball.vertices, ball.faces, vertex_normals=normals)
    plain = render(mesh, FRONT, 32, 32, ("normal",), device=device, density=4)
    staged = render(mesh, FRONT, 32, 32, ("normal", "P"), device=device, density=4)
    hit = staged.rgba[..., 3] == 1
    assert np.abs(np.linalg.norm(staged.normal[hit].astype(np.float64), axis=-1) - 1).max() < 1e-6
    assert (staged.normal == plain.normal).all()
    assert (staged.rgba == plain.rgba).all()


def test_no_sky_leaks_into_a_closed_box(device):
    camera = Camera.look_at((0.5, 0.3, -0.4), (-1, -1, 1), fov=120)
    room = Mesh(cube().vertices * np.float32(3.3) + np.float32(100), cube().faces)
    inside = Camera.look_at(camera.eye + 100, camera.eye + 100 + camera.forward, fov=120)
    picture = draw(room, inside, 64, device, Shading(sky=ONE, occlusion_rays=8), plain_look(room))
    assert (picture.rgba == [0, 0, 0, 1]).all()


def test_the_sky_is_hidden_by_the_form_factor_of_what_hides_it(device):
    """A square of half side a, at height c over a point: the view factor of parallel plates."""
    a, c, side = 0.7, 1.0, 48
    mesh, look = scene_of([quad(half=3), quad(c, a)], [WHITE, WHITE])
    camera = from_above(0.5, 1e-3)
    for rays in (16, 5):
        picture = draw(mesh, camera, side, device, Shading(sky=ONE, occlusion_rays=rays, seed=7), look)
        x = a / c
        hidden = 4 / (2 * math.pi) * 2 * (x / math.sqrt(1 + x * x)) * math.atan(x / math.sqrt(1 + x * x))
        # Three standard errors of as many independent rays; strata make it less.
        error = 3 * math.sqrt(hidden * (1 - hidden) / (side * side * rays))
        assert abs(float(picture.rgba[..., 0].mean()) - (1 - hidden)) < error
        assert picture.rgba[..., 0].std() > 0
    # What is farther away than the distance hides nothing; what is nearer hides what it did.
    far = Shading(sky=ONE, occlusion_rays=16, seed=7, occlusion_distance=0.99)
    assert (draw(mesh, camera, side, device, far, look).rgba[..., 0] == 1).all()
    near = Shading(sky=ONE, occlusion_rays=16, seed=7, occlusion_distance=10.0)
    endless = draw(mesh, camera, side, device, Shading(sky=ONE, occlusion_rays=16, seed=7), look)
    assert (draw(mesh, camera, side, device, near, look).rgba == endless.rgba).all()


def test_a_sun_shines_by_the_cosine(device):
    mesh, _ = scene_of([quad()], [WHITE])
    look = plain_look(mesh, base_colour=(0.5, 0.25, 1.0, 1.0), emissive=(0.0, 0.5, 0.0))
    for toward in ((0, 0, 1), (1, 2, 2), (3, 0, 4), (1, 0, -1e-9), (0, 0, -1)):
        picture = draw(mesh, from_above(3, 1), 8, device, Shading(sun=toward, sun_strength=2.0), look)
        cosine = max(toward[2] / math.hypot(*toward), 0)
        expected = np.array([0.5, 0.25, 1.0]) * cosine * 2.0 / math.pi + [0.0, 0.5, 0.0]
        np.testing.assert_allclose(picture.rgba[..., :3], np.broadcast_to(expected, (8, 8, 3)), rtol=1e-6)


def test_all_that_a_light_sends_arrives(device):
    """What a square gets of a point light above it is its solid angle, seen from there: energy is kept."""
    half, height, side = 1.5, 0.75, 96
    mesh, _ = scene_of([quad(half=2)], [WHITE])
    lamp = Light("point", (1.0, 0.5, 0.25), intensity=3.0, position=(0.0, 0.0, height))
    camera = from_above(0.5, 2 * half)
    picture = draw(mesh, camera, side, device, Shading(), plain_look(mesh, lamp))
    irradiance = math.pi * picture.rgba[..., :3].astype(np.float64)
    flux = irradiance.sum((0, 1)) * (2 * half / side) ** 2
    solid = 4 * math.asin(half * half / (half * half + height * height))
    np.testing.assert_allclose(flux, 3.0 * solid * np.array([1.0, 0.5, 0.25]), rtol=1e-4)
    # And point by point: the inverse square times the cosine.
    squares = (places(camera, side) ** 2).sum(-1) + height**2
    np.testing.assert_allclose(irradiance[..., 0], 3.0 * height / squares**1.5, rtol=1e-6)
    near = Light("point", intensity=3.0, position=(0.0, 0.0, height), reach=1.0)
    bounded = math.pi * draw(mesh, camera, side, device, Shading(), plain_look(mesh, near)).rgba[..., 0]
    window = np.clip(1 - squares**2, 0, 1)
    np.testing.assert_allclose(bounded, window * 3.0 * height / squares**1.5, rtol=1e-5, atol=1e-9)
    assert (bounded == 0).any()


def test_a_spot_shines_within_its_cone(device):
    mesh, _ = scene_of([quad(half=2)], [WHITE])
    spot = Light("spot", intensity=math.pi, position=(0.2, 0, 1), inner_cone=0.3, outer_cone=0.6)
    camera = from_above(0.5, 3)
    picture = draw(mesh, camera, 64, device, Shading(), plain_look(mesh, spot)).rgba[..., 0]
    to = places(camera, 64) - spot.position
    distance = np.linalg.norm(to, axis=-1)
    cosine = -to[..., 2] / distance
    angles, full = np.arccos(cosine), cosine / distance**2
    share = np.clip((cosine - math.cos(0.6)) / (math.cos(0.3) - math.cos(0.6)), 0, 1) ** 2
    np.testing.assert_allclose(picture, share * full, rtol=1e-5, atol=1e-9)
    assert (picture[angles > 0.601] == 0).all()
    np.testing.assert_allclose(picture[angles < 0.299], full[angles < 0.299], rtol=1e-6)


@pytest.mark.parametrize("kind", ["point", "directional"])
def test_edges_of_shadows_are_where_geometry_has_them(device, kind):
    mesh, _ = scene_of([quad(half=3), quad(1.0, 0.5)], [WHITE, WHITE])
    lamp = Light(kind, intensity=9.0, position=(0.125, 0.25, 3.0), direction=(-0.25, 0.5, -2.0))
    camera = from_above(0.9, 3.0)
    picture = draw(mesh, camera, 128, device, Shading(), plain_look(mesh, lamp))
    at = places(camera, 128)
    to = np.asarray(lamp.position) - at if kind == "point" else -np.broadcast_to(lamp.direction, at.shape)
    crossing = (at + to / to[..., 2:])[..., :2]
    outside = np.abs(crossing).max(-1) - 0.5
    # The start of a ray is moved by 64 * 2^-24 of the scene: nearer to the edge, nothing is promised.
    told = np.abs(outside) > 2e-5
    assert told.mean() > 0.999
    assert ((picture.rgba[..., 0] > 0) == (outside > 0))[told].all()


def test_what_nearly_touches_has_a_shadow(device):
    """A sheet a hundred thousandth of the scene above the floor."""
    mesh, look = scene_of([quad(half=4), quad(1e-4, 0.5)], [WHITE, WHITE])
    # As seen from within the gap, hence from below the sheet.
    camera = from_above(5e-5, 2)
    picture = draw(mesh, camera, 64, device, Shading(sun=(0, 0, 1)), look)
    np.testing.assert_array_equal(picture.rgba[..., 0] == 0, np.abs(places(camera, 64)).max(-1) < 0.5)


def checks(**more) -> Texture:
    """4 x 4 texels, every other without alpha."""
    pixels = np.full((4, 4, 4), 255, np.uint8)
    pixels[..., 3] = np.where(np.indices((4, 4)).sum(0) % 2, 0, 255)
    return Texture(pixels, smooth=False, **more)


LEAVES = Material("leaves", base_texture=TextureUse(0), alpha_mode="mask")


def test_rays_pass_where_a_mask_is_open(device):
    """The eye sees the floor through holes, the sun shines through them, and so does the sky."""
    quads = [quad(half=2), quad(0.5, 1.0), quad(-0.5, 2.0)]  # a cellar, which nobody sees
    mesh, look = scene_of(quads, [WHITE, LEAVES, WHITE], [checks()])
    camera = from_above(3, 4)
    shading = Shading(sun=(0, 0, 1))
    picture = draw(mesh, camera, 64, device, shading, look, aovs=("depth", "id"))
    at = places(camera, 64)
    within = np.abs(at[..., :2]).max(-1) < 1
    row, column = ((1 - at[..., 1]) * 2).astype(int), ((at[..., 0] + 1) * 2).astype(int)
    leaf = within & ((row + column) % 2 == 0)
    np.testing.assert_array_equal(picture.depth, np.where(leaf, 2.5, 3.0))
    np.testing.assert_array_equal((picture.primitive_id // 2 == 1), leaf)
    assert (picture.rgba[..., 0] == 1).all()
    # From below the leaves, their shadow.
    low = from_above(0.25, 4)
    shadow = draw(mesh, low, 64, device, shading, look).rgba[..., 0]
    np.testing.assert_array_equal(shadow == 0, leaf)
    some = Shading(sky=ONE, occlusion_rays=4)
    opaque = Look((WHITE, Material(), WHITE), look.material_ids)
    masked = draw(mesh, low, 64, device, some, look).rgba[..., 0]
    assert masked.mean() > draw(mesh, low, 64, device, some, opaque).rgba[..., 0].mean() + 0.01
    # Blended is drawn as opaque.
    glass = (WHITE, Material("glass", alpha_mode="blend"), WHITE)
    blended = draw(mesh, camera, 8, device, shading, Look(glass, look.material_ids), aovs=("id",))
    assert blended.primitive_id[4, 4] in (2, 3)


def test_nothing_is_lost_behind_what_is_passed_in_the_same_plane(device):
    """Leaves and a floor in one plane, lower ids first; then backs and fronts of quads."""
    clear = Texture(np.full((1, 1, 4), [255, 255, 255, 0], np.uint8))
    quads = [quad()] * 4
    mesh, look = scene_of(quads, [LEAVES, LEAVES, LEAVES, WHITE], [clear])
    picture = draw(mesh, from_above(3, 1.9), 33, device, Shading(), look, aovs=("depth", "id"))
    assert (picture.depth == 3).all()
    assert set(picture.primitive_id.flatten().tolist()) == {6, 7}
    single = Material("paper", double_sided=False)
    mesh, look = scene_of([quad(0.5, up=False), quad(0, up=False), quad(0)], [single] * 3)
    above = draw(mesh, from_above(3, 1.9), 33, device, Shading(), look, aovs=("depth", "id"))
    assert (above.depth == 3).all()
    assert (above.primitive_id >= 4).all()
    under = Camera.look_at((0, 0, -3), (0, 0, 0), (0, 1, 0), orthographic_height=1.9)
    below = draw(mesh, under, 33, device, Shading(), look, aovs=("depth", "id"))
    assert (below.depth == 3).all()
    assert set(below.primitive_id.flatten().tolist()) == {2, 3}
    # All that is met is passed: the background.
    nothing = draw(*scene_of([quad(up=False)], [single])[:1], from_above(3, 1.9), 9, device, Shading(),
                   scene_of([quad(up=False)], [single])[1], background=(0.5, 0, 0))  # fmt: skip
    assert (nothing.rgba == [0.5, 0, 0, 0]).all()
    # Backs of single-sided surfaces stand before lights all the same.
    roof, roofed = scene_of([quad(half=2), quad(1.0, 1.5)], [WHITE, single])
    assert (draw(roof, from_above(0.5, 1), 9, device, Shading(sun=(0, 0, 1)), roofed).rgba[..., 0] == 0).all()


def test_without_lights_the_eye_has_one(device):
    """The plain picture is that of grey, and times the albedo of others."""
    mesh = icosphere(2)
    plain = render(mesh, FRONT, 40, 40, device=device, density=4).rgba
    grey = draw(mesh, FRONT, 40, device, Shading(), None, background=(0.9, 0.9, 0.9)).rgba
    np.testing.assert_allclose(grey, plain, rtol=1e-6)
    # A look is not read where no shading is asked for.
    dark = plain_look(mesh, base_colour=(0.2, 0.4, 0.8, 1.0))
    assert (render(mesh, FRONT, 40, 40, device=device, density=4, look=dark).rgba == plain).all()
    coloured = draw(mesh, FRONT, 40, device, Shading(), dark).rgba
    hit = plain[..., 3] == 1
    np.testing.assert_allclose(coloured[hit][:, :3], plain[hit][:, :3] * [0.25, 0.5, 1.0], rtol=1e-6)


def test_a_light_that_lies_in_a_surface_or_behind_it_gives_it_nothing(device):
    mesh, _ = scene_of([quad()], [WHITE])
    for z in (0.0, -1e-3):
        look = plain_look(mesh, Light("point", position=(0, 0, z)))
        picture = draw(mesh, from_above(3, 1), 9, device, Shading(), look)
        assert (picture.rgba[..., :3] == 0).all()


@pytest.mark.parametrize(
    ("shading", "message"),
    [
        (Shading(samples=0), "samples is 0"),
        (Shading(seed=-1), "seed is -1"),
        (Shading(occlusion_rays=3), "give sky"),
        (Shading(sky=(0, 0, -1)), r"sky is \(0, 0, -1\)"),
        (Shading(sky=ONE, occlusion_distance=0.0), "occlusion_distance"),
        (Shading(sun=(0, 1)), "sun is"),
        (Shading(sun=(0, 0, 0)), "light 'sun': direction"),
        (Shading(sun=(0, 0, 1), sun_strength=-1), "light 'sun': colour times intensity"),
    ],
)
def test_shading_out_of_range_is_refused_by_name(shading, message):
    with pytest.raises(InputError, match=message):
        render(cube(), width=8, height=8, shading=shading)


def test_a_look_that_does_not_fit_is_refused_by_name():
    mesh, look = scene_of([quad()], [LEAVES], [checks()])
    square = np.zeros((2, 2, 3), np.uint8)
    for wrong, message in (
        (replace(look, textures=(Texture(square, name="bark"),)), "texture 'bark' are"),
        (replace(look, textures=(checks(wrap=("repeat", "border")),)), "wrap of texture"),
        (Look((WHITE,), np.zeros(3, np.uint16)), "material_ids"),
        (Look((WHITE,), np.array([0, 1], np.uint16)), "material 1 of 1"),
        (Look(look.materials, look.material_ids), "names texture 0"),
        (
            Look((WHITE,), look.material_ids, uvs=(np.zeros((3, 2), np.float32),), uv_faces=(None,)),
            "uv_faces",
        ),
        (Look((WHITE,), look.material_ids, colours=np.zeros((1, 4), np.float32)), "colours"),
    ):
        with pytest.raises(InputError, match=message):
            render(mesh, width=8, height=8, look=wrong, shading=Shading())
