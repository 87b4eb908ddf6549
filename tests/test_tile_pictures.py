"""Pictures, drawn in tiles, show what brute force finds for the camera's rays, shaded as numpy shades it."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from agreement import KINDS, RUNGS, bits
from meshes import MESHES, lattice_box, moved, torus

from clgrid import memory, procedural, renderer, target
from clgrid.brute import brute_force
from clgrid.camera import Camera
from clgrid.device import Device
from clgrid.frame import LocalFrame
from clgrid.grid import build
from clgrid.hits import Hits
from clgrid.image import NO_ID, Image
from clgrid.mesh import Mesh
from clgrid.renderer import render

F64 = npt.NDArray[np.float64]
AOVS = ("depth", "normal", "id", "t_err")
NAMES = ("rgba", "depth", "normal", "primitive_id", "t_err")
BACKGROUND = (0.25, 0.5, 0.75)
SIZES = [(1, 1), (3, 1), (1, 9), (8, 8), (9, 7), (61, 47), (64, 16), (50, 133)]


# --- the twin of cl/shade.h ------------------------------------------------------------------------------


def dot(a: F64, b: F64) -> F64:
    """In the kernel's order of operations."""
    return np.asarray((a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1]) + a[:, 2] * b[:, 2])


def has_length(square: F64) -> npt.NDArray[np.bool_]:
    return np.asarray((square > 0) & (square < np.inf))


def to_unit(v: F64) -> tuple[F64, npt.NDArray[np.bool_]]:
    """Scaled to length 1, but for those without a direction; and which were."""
    square = dot(v, v)
    sound = has_length(square)
    return v * (1.0 / np.sqrt(np.where(sound, square, 1.0)))[:, None], sound


def face_normals(mesh: Mesh, ids: npt.NDArray[np.int64], views: F64) -> F64:
    local = LocalFrame.of_bounds(mesh.bounds).to_local(mesh.vertices).astype(np.float32).astype(np.float64)
    a, b, c = (local[mesh.faces[ids, k]] for k in range(3))
    e, f = b - a, c - a
    way = [e[:, i] * f[:, j] - e[:, j] * f[:, i] for i, j in ((1, 2), (2, 0), (0, 1))]
    normal = np.stack(way, axis=-1)
    sound = has_length(dot(normal, normal))
    normal = np.where((dot(normal, views) > 0)[:, None], -normal, normal)
    return np.where(sound[:, None], normal, -views)


def smooth_normals(mesh: Mesh, hits: Hits, rows: npt.NDArray[np.bool_], faces: F64) -> F64:
    assert mesh.vertex_normals is not None
    ids = hits.primitive_ids[rows]
    u, v = np.moveaxis(hits.primitive_uvs[rows].astype(np.float64), -1, 0)
    total, without = np.zeros((len(ids), 3)), np.zeros(len(ids))
    for k, weight in enumerate(((1 - u) - v, u, v)):
        n, sound = to_unit(mesh.vertex_normals[mesh.faces[ids, k]].astype(np.float64))
        total = np.where(sound[:, None], total + weight[:, None] * n, total)
        without = np.where(sound, without, without + weight)
    total = np.where((dot(total, faces) < 0)[:, None], -total, total)
    total = total + without[:, None] * to_unit(faces)[0]
    return np.where(has_length(dot(total, total))[:, None], total, faces)


def expected_picture(
    mesh: Mesh, camera: Camera, width: int, height: int, device: Device, accuracy: str
) -> dict[str, npt.NDArray[Any]]:
    """By brute force and numpy."""
    o, d = camera.rays(width, height)
    hits = brute_force(mesh, o, d, device=device, accuracy=accuracy, fields=("primitive_uvs", "t_err"))
    rows = hits.mask
    views = d[rows]
    normals = face_normals(mesh, hits.primitive_ids[rows], views)
    if mesh.vertex_normals is not None:
        normals = smooth_normals(mesh, hits, rows, normals)
    facing = -dot(normals, views) / np.sqrt(dot(normals, normals) * dot(views, views))
    light = (0.8 * (0.1 + (1 - 0.1) * np.where(facing > 0, facing, 0.0))).astype(np.float32)
    rgba = np.zeros((height, width, 4), np.float32)
    rgba[..., :3] = BACKGROUND
    rgba[rows] = np.stack([light, light, light, np.ones_like(light)], axis=-1)
    normal = np.zeros((height, width, 3), np.float32)
    normal[rows] = to_unit(normals)[0].astype(np.float32)
    ids = np.where(rows, hits.primitive_ids, NO_ID).astype(np.uint32)
    t_err = np.where(rows, hits.t_err * (1 + 2.0**-22), 0).astype(np.float32)
    depth = hits.t_hit.astype(np.float32)
    return {"rgba": rgba, "depth": depth, "normal": normal, "primitive_id": ids, "t_err": t_err}


def assert_picture(image: Image, expected: dict[str, npt.NDArray[Any]]) -> None:
    for name in NAMES:
        np.testing.assert_array_equal(bits(getattr(image, name)), bits(expected[name]), err_msg=name)


def draw(mesh: Mesh, camera: Camera, size: tuple[int, int], **options: Any) -> Image:
    return render(mesh, camera, *size, AOVS, background=BACKGROUND, **options)


def with_normals(mesh: Mesh) -> Mesh:
    """Of any length, some of them none."""
    rng = np.random.default_rng(40)
    normals = rng.normal(size=mesh.vertices.shape) * 10.0 ** rng.uniform(-3, 3, (len(mesh.vertices), 1))
    normals[rng.random(len(normals)) < 0.1] = 0
    return Mesh(mesh.vertices, mesh.faces, vertex_normals=normals.astype(np.float32))


CAMERAS = {
    "a view": Camera.look_at((1.5, 2.0, 2.5), (0, 0.1, 0), fov=50),
    "over the diagonals": Camera.look_at((1.2, 1.2, 1.2), (0, 0, 0), (0.1, 0.9, 0.2), fov=130),
    "from within": Camera.look_at((0.1, 0.05, 0.02), (1, 1, 1), fov=100),
    "from afar": Camera.look_at((3e3, -2e4, 1e3), (0, 0, 0), fov=0.006),
    "along an axis": Camera.look_at((0, 0, 5), (0, 0, 0), fov=30),
    "past it": Camera.look_at((0, 0, 5), (0, 40, 5), (0, 0, 1), fov=60),
}


# --- tests -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("smooth", [False, True])
def test_a_picture_is_what_brute_force_finds(smooth: bool, device: Device) -> None:
    mesh = with_normals(MESHES["soup"]) if smooth else MESHES["soup"]
    grid = build(mesh, density=4, device=device)
    for name in ("over the diagonals", "from afar"):
        for size in ((9, 7), (61, 47)):
            expected = expected_picture(mesh, CAMERAS[name], *size, device, "robust")
            assert_picture(draw(mesh, CAMERAS[name], size, grid=grid), expected)
            assert (expected["primitive_id"] != NO_ID).any()


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize("accuracy", RUNGS)
@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize("name", ["soup", "lattice_box", "stacks", "edge_on_slivers", "torus", "flat"])
def test_pictures_of_any_size(name: str, smooth: bool, accuracy: str, device: Device) -> None:
    mesh = with_normals(MESHES[name]) if smooth else MESHES[name]
    grid = build(mesh, density=4, accuracy=accuracy, device=device)
    for camera in CAMERAS.values():
        for size in SIZES:
            expected = expected_picture(mesh, camera, *size, device, accuracy)
            assert_picture(draw(mesh, camera, size, grid=grid), expected)
            shares: list[float] = []
            assert_picture(draw(mesh, camera, size, grid=grid, progress=shares.append), expected)
            assert shares[-1] == 1


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize("accuracy", RUNGS)
@pytest.mark.parametrize(("layout", "skipping"), KINDS)
def test_pictures_by_any_grid(layout: str, skipping: bool, accuracy: str, device: Device) -> None:
    for mesh in (lattice_box(8), MESHES["stacks"], moved(torus(), 3e5 + 1 / 3, np.float64)):
        camera = CAMERAS["a view"]
        shift = (mesh.bounds[0] + mesh.bounds[1]) / 2
        camera = Camera(camera.eye + shift, camera.right, camera.up, camera.forward, camera.fov)
        expected = expected_picture(mesh, camera, 61, 47, device, accuracy)
        assert (expected["primitive_id"] != NO_ID).any()
        options = {"layout": layout, "skipping": skipping, "accuracy": accuracy, "device": device}
        for density in (0.1, 4.0, 100.0):
            assert_picture(draw(mesh, camera, (61, 47), density=density, **options), expected)
        assert_picture(draw(mesh, camera, (61, 47), resolution=(1, 40, 3), **options), expected)


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize("accuracy", RUNGS)
@pytest.mark.parametrize("smooth", [False, True])
def test_pictures_in_parts_and_bands(
    smooth: bool, accuracy: str, device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    ball = procedural.icosphere(4)
    mesh = Mesh(ball.vertices, np.concatenate([ball.faces, ball.faces[::3]]))
    mesh = with_normals(mesh) if smooth else mesh
    build(mesh, accuracy=accuracy, device=device)  # the self-test needs larger buffers
    with monkeypatch.context() as patch:
        for module in (memory, target):
            patch.setattr(module, "largest_buffer", lambda device: 12_000)
        grid = build(mesh, density=4, skipping=True, accuracy=accuracy, device=device)
    assert grid.stats.parts > 1
    monkeypatch.setattr(renderer, "_LARGEST_BUFFER", 16 * 50 * 20)
    for name in ("a view", "from within"):
        expected = expected_picture(mesh, CAMERAS[name], 50, 133, device, accuracy)
        assert_picture(draw(mesh, CAMERAS[name], (50, 133), grid=grid), expected)
