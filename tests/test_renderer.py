from __future__ import annotations

import numpy as np
import pytest
from agreement import KINDS
from scenes import scene as shared_scene

from clgrid import renderer
from clgrid.camera import Camera
from clgrid.errors import InputError
from clgrid.grid import build
from clgrid.image import NO_ID, Image
from clgrid.mesh import Mesh
from clgrid.procedural import cube, icosphere, make
from clgrid.renderer import PLAIN_AOVS as AOVS
from clgrid.renderer import kernel_options, render, warm_up
from clgrid.scene import default_camera, load_scene, named_camera

FRONT = Camera.look_at((0, 0, 5), (0, 0, 0), fov=40)
EMPTY = Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint32))


def bits(image: Image) -> dict[str, bytes]:
    names = ("rgba", "depth", "normal", "primitive_id", "geometry_id", "steps")
    return {name: getattr(image, name).tobytes() for name in names if getattr(image, name) is not None}


def with_normals(mesh: Mesh, normals: np.ndarray) -> Mesh:
    return Mesh(mesh.vertices, mesh.faces, vertex_normals=normals.astype(np.float32))


def test_a_cube_seen_face_on(device):
    image = render(cube(), FRONT, 64, 64, AOVS, device=device, background=(0.25, 0.5, 0.75))
    assert image.rgba[0, 0].tolist() == [0.25, 0.5, 0.75, 0]
    assert image.depth[0, 0] == np.inf
    assert image.normal[0, 0].tolist() == [0, 0, 0]
    assert (image.primitive_id[0, 0], image.geometry_id[0, 0]) == (NO_ID, NO_ID)
    # The near face is at z = 1: planar depth 4 all over it, not only in its middle.
    hit = image.rgba[..., 3] == 1
    assert hit.sum() == 44 * 44
    assert (image.depth[hit] == 4).all()
    assert (image.normal[hit] == [0, 0, 1]).all()
    assert set(image.primitive_id[hit].tolist()) == {2, 3}
    assert (image.geometry_id[hit] == 0).all()
    # A headlight: brightest where the ray meets the face squarely, by the facing ratio elsewhere.
    _, directions = FRONT.rays(64, 64)
    facing = 1 / np.linalg.norm(directions[hit], axis=-1)
    np.testing.assert_allclose(image.rgba[hit][:, 0], 0.8 * (0.1 + 0.9 * facing), rtol=1e-6)


@pytest.mark.parametrize("name", ["icosphere:4", "terrain:40"])
def test_the_picture_shows_exactly_what_cast_finds(device, name):
    mesh = make(name)
    grid = build(mesh, device=device)
    camera = default_camera(mesh, 61 / 47)
    image = render(mesh, camera, 61, 47, AOVS, grid=grid)
    hits = grid.cast(*camera.rays(61, 47))
    assert hits.mask.any()
    assert (image.primitive_id == np.where(hits.mask, hits.primitive_ids, NO_ID)).all()
    assert (image.depth == hits.t_hit.astype(np.float32)).all()
    assert ((image.rgba[..., 3] == 1) == hits.mask).all()
    # Flat shading: the triangle's own normal, on the viewer's side.
    normals = hits.primitive_normals
    _, directions = camera.rays(61, 47)
    normals *= -np.sign((normals * directions).sum(-1, keepdims=True))
    np.testing.assert_allclose(image.normal, normals, atol=3e-6)


@pytest.mark.parametrize("smooth", [False, True])
def test_pictures_are_the_same_bits_on_every_device(all_devices, smooth):
    mesh = icosphere(4)
    if smooth:
        mesh = with_normals(mesh, mesh.vertices * np.float32(3.7))
    camera = Camera.look_at((1.3, 0.7, 1.9), (0.1, 0, 0), fov=55)
    first, *others = (
        bits(render(mesh, camera, 83, 59, AOVS, device=device, density=4)) for device in all_devices
    )
    assert set(first) == {"rgba", "depth", "normal", "primitive_id", "geometry_id", "steps"}
    for other in others:
        assert other == first


@pytest.mark.thorough
def test_layout_of_the_work_does_not_change_the_picture(device, monkeypatch):
    mesh = icosphere(3)
    whole = bits(render(mesh, FRONT, 50, 333, AOVS, device=device))
    shares: list[float] = []
    assert bits(render(mesh, FRONT, 50, 333, AOVS, device=device, progress=shares.append)) == whole
    assert len(shares) > 8
    assert shares == sorted(shares)
    assert shares[-1] == 1
    monkeypatch.setattr(renderer, "_LARGEST_BUFFER", 16 * 50 * 20)
    bands = renderer._bands(50, 333, device, watched=False)
    assert [last - first for first, last in bands] == [16] * 20 + [13]
    assert bits(render(mesh, FRONT, 50, 333, AOVS, device=device)) == whole
    # The cells that a ray looks at are the grid's own; all else is the same for every grid.
    same = [aov for aov in AOVS if aov != "steps"]
    whole = bits(render(mesh, FRONT, 50, 333, same, device=device))
    options: list[dict[str, object]] = [{"density": 0.1}, {"resolution": (1, 40, 3)}]
    options += [{"layout": layout, "skipping": skipping} for layout, skipping in KINDS]
    for option in options:
        assert bits(render(mesh, FRONT, 50, 333, same, device=device, **option)) == whole


@pytest.mark.parametrize("aovs", [(), ("depth",), ("normal",), ("id",), ("id", "depth"), ("steps",)])
def test_each_aov_is_made_only_when_asked_for(device, aovs):
    full = bits(render(icosphere(2), FRONT, 40, 40, AOVS, device=device))
    part = bits(render(icosphere(2), FRONT, 40, 40, aovs, device=device))
    wanted = {"rgba", *aovs} - {"id"} | ({"primitive_id", "geometry_id"} if "id" in aovs else set())
    assert part == {name: full[name] for name in wanted}
    macros = {"depth": "AOV_DEPTH", "normal": "AOV_NORMAL", "id": "AOV_ID", "steps": "COUNT_STEPS"}
    assert set(kernel_options(cube(), aovs)) == {macros[name] for name in aovs}


def test_steps_are_those_of_the_cast_and_fall_with_skipping(device):
    mesh, camera = icosphere(5), FRONT
    plain, skipping = (build(mesh, device=device, density=30, skipping=choice) for choice in (False, True))
    images = [render(mesh, camera, 40, 30, ("steps",), grid=grid) for grid in (plain, skipping)]
    for grid, image in zip((plain, skipping), images, strict=True):
        steps = grid.cast(*camera.rays(40, 30), fields=("steps",))["steps"]
        np.testing.assert_array_equal(image.steps, steps)
        assert "steps" not in grid.cast(*camera.rays(40, 30)).computed
    before, after = (int(image.steps.sum()) for image in images)
    assert after < 0.7 * before


def test_smooth_normals_are_interpolated(device):
    sphere = icosphere(3)
    # Lengths differ and signs are inward: only directions count, and the viewer's side.
    scale = -np.linspace(0.1, 50, len(sphere.vertices), dtype=np.float32)[:, None]
    image = render(with_normals(sphere, sphere.vertices * scale), FRONT, 65, 65, AOVS, device=device)
    hit = image.rgba[..., 3] == 1
    origins, directions = FRONT.rays(65, 65)
    points = origins[hit] + image.depth[hit][:, None] * directions[hit]
    ideal = points / np.linalg.norm(points, axis=1, keepdims=True)
    inner = (ideal * directions[hit]).sum(1) < -0.3  # off the rim, where facets turn away
    assert np.abs(image.normal[hit] - ideal)[inner].max() < 0.01
    flat = render(sphere, FRONT, 65, 65, AOVS, device=device)
    assert np.abs(flat.normal[hit] - ideal)[inner].max() > 0.05
    np.testing.assert_allclose(np.linalg.norm(image.normal[hit], axis=1), 1, rtol=1e-6)


@pytest.mark.parametrize("value", [0.0, np.nan, np.inf])
def test_vertices_without_a_usable_normal_take_the_faces(device, value):
    nowhere = np.full((8, 3), value, np.float32)
    image = render(with_normals(cube(), nowhere), FRONT, 32, 32, AOVS, device=device)
    flat = render(cube(), FRONT, 32, 32, AOVS, device=device)
    assert bits(image) == bits(flat)


@pytest.mark.parametrize("sign", [1, -1])
def test_one_vertex_without_a_normal_takes_the_faces(device, sign):
    normals = np.array([[0, 0, 0], [0.6, 0, 0.8], [0, 0.6, 0.8]], np.float32) * np.float32(sign)
    triangle = Mesh(
        np.array([[-3, -3, 0], [3, -3, 0], [-3, 3, 0]], np.float32),
        np.array([[0, 1, 2]], np.uint32),
        vertex_normals=normals,
    )
    image = render(triangle, FRONT, 33, 33, ("normal",), device=device)
    origins, directions = FRONT.rays(33, 33)
    hits = build(triangle, device=device).cast(origins, directions)
    u, v = np.moveaxis(hits.primitive_uvs[hits.mask].astype(np.float64), -1, 0)
    expected = (1 - u - v)[:, None] * [0, 0, 1] + u[:, None] * [0.6, 0, 0.8] + v[:, None] * [0, 0.6, 0.8]
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    np.testing.assert_allclose(image.normal[hits.mask], expected, atol=1e-6)


def test_geometries_are_told_apart(device):
    ball = icosphere(1)
    both = Mesh(
        np.concatenate([ball.vertices - np.float32([1.2, 0, 0]), ball.vertices + np.float32([1.2, 0, 0])]),
        np.concatenate([ball.faces, ball.faces + np.uint32(len(ball.vertices))]),
        geometry_starts=np.array([0, 80, 80, 160]),
        geometry_names=("left", "nothing", "right"),
    )
    image = render(both, FRONT, 64, 64, ("id",), device=device)
    assert set(image.geometry_id[:, :32].flatten().tolist()) == {0, NO_ID}
    assert set(image.geometry_id[:, 32:].flatten().tolist()) == {2, NO_ID}


def test_an_empty_mesh_gives_the_background(device):
    image = render(EMPTY, None, 9, 5, AOVS, device=device, background=(1, 0, 0))
    assert (image.rgba == [1, 0, 0, 0]).all()
    assert np.isinf(image.depth).all()
    assert (image.geometry_id == NO_ID).all()
    assert image.hits == 0


def test_metadata_tell_device_grid_and_camera(device):
    found = render(cube(), FRONT, 8, 8, device=device).metadata
    assert found["clgrid:device"] == device.name
    assert found["clgrid:driver"] == device.driver_version
    assert found["clgrid:platform"] == device.platform
    assert found["clgrid:triangles"] == 12
    assert found["clgrid:camera_eye"] == "0.0 0.0 5.0"
    assert found["clgrid:kernel_options"] == ""
    assert (found["worldToCamera"] == FRONT.world_to_camera()).all()


def test_the_second_warm_up_compiles_nothing(device):
    from clgrid.program import builds

    warm_up(device, ("depth",), smooth=True)
    before = len(builds(device))
    assert before > 0
    render(with_normals(cube(), cube().vertices), FRONT, 16, 16, ("depth",), device=device)
    assert len(builds(device)) == before


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"width": 0}, "size"),
        ({"width": 1 << 20, "height": 1 << 20}, "size"),
        ({"aovs": ("depth", "uvw")}, "AOV 'uvw'"),
        ({"background": (1, 2)}, "background"),
        ({"background": (1, 2, np.nan)}, "background"),
    ],
)
def test_wrong_arguments_are_refused_by_name(change, message):
    with pytest.raises(InputError, match=message):
        render(cube(), **change)


def test_a_grid_of_another_mesh_is_refused(device):
    with pytest.raises(InputError, match="another mesh"):
        render(cube(), grid=build(cube(), device=device))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["country_kitchen", "white_room"])
def test_rooms_have_no_holes_and_the_same_bits_everywhere(all_devices, name):
    scene = load_scene(str(shared_scene(f"arch/{name}.glb.gz")))
    camera = named_camera(scene, str(shared_scene(f"arch/{name}.camera.json")))
    pictures = [render(scene, camera, 320, 180, AOVS, device=device, density=4) for device in all_devices]
    assert pictures[0].hits > 0.9 * 320 * 180
    for other in pictures[1:]:
        assert bits(other) == bits(pictures[0])
