"""scripts/second_opinion: what it counts as agreement, and a small scene of its own beside Mitsuba."""

from __future__ import annotations

import importlib
import sys
from fractions import Fraction
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from scenes import scene

import clgrid
from clgrid.device import Device
from clgrid.look import Look, Material, Texture, TextureUse
from clgrid.mesh import Mesh
from clgrid.rational import Crossing

SCRIPTS = Path(__file__).resolve().parent.parent / "scripts"


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch):
    """Import a module of the script by the end of its name."""
    monkeypatch.syspath_prepend(str(SCRIPTS))

    def imported(name: str) -> ModuleType:
        return importlib.import_module(f"second_opinion_{name}")

    yield imported
    for name in [name for name in sys.modules if name.startswith("second_opinion")]:
        del sys.modules[name]


def plane(module: ModuleType, side: int = 40, slope: float = 0.02):
    """A tilted plane that fills the picture, but a column of misses on its left."""
    x = np.arange(side) - 0.5 * side
    depth = np.broadcast_to(1.0 / (0.2 + slope * 0.1 * x), (side, side)).copy()
    depth[:, 0] = np.inf
    normal = np.broadcast_to([0.0, 0.0, 1.0], (side, side, 3)).copy()
    uv = np.broadcast_to([0.25, 0.5], (side, side, 2)).copy()
    albedo = np.full((side, side, 3), 0.5)
    return module.View(depth, normal, uv, albedo, np.where(np.isfinite(depth), 0, -1))


def changed(module: ModuleType, view, **arrays):
    return module.View(**{**view.__dict__, **arrays})


@pytest.mark.host
def test_the_same_view_agrees_and_a_plane_has_no_silhouette_but_its_border(script) -> None:
    compare = script("compare")
    view = plane(compare)
    found = compare.compare(view, view)
    assert found.holds
    assert (found.hits, found.compared) == (39 * 40, 37 * 40)  # two columns beside the misses
    assert (found.depth, found.normal_all, found.albedo, found.uv) == (1.0, 1.0, 0.0, 0.0)
    assert not found.apart.any()


@pytest.mark.host
def test_what_only_one_sees_is_a_fault_and_no_silhouette(script) -> None:
    compare = script("compare")
    view = plane(compare)
    for name, spot in (("depth", view.depth[20, 20] * 1.05), ("normal", [0.0, 0.02, 0.9998])):
        array = getattr(view, name).copy()
        array[20:22, 20] = spot
        found = compare.compare(view, changed(compare, view, **{name: array}))
        assert np.argwhere(found.apart).tolist() == [[20, 20], [21, 20]]
        assert getattr(found, name) == 1 - 2 / found.compared
        assert not found.holds  # 2 of 1480
    hole = view.depth.copy()
    hole[10, 10] = np.inf
    found = compare.compare(view, changed(compare, view, depth=hole))
    assert found.apart.sum() == 1
    assert found.apart[10, 10]


@pytest.mark.host
def test_albedos_are_told_in_255ths_and_what_is_set_aside_is_not_counted(script) -> None:
    compare = script("compare")
    view = plane(compare)
    other = view.albedo.copy()
    other[:, 20:] += 2.0 / 255.0
    found = compare.compare(view, changed(compare, view, albedo=other))
    assert found.albedo == pytest.approx(2.0 * np.sqrt(20 / 37))
    assert not found.holds
    aside = np.zeros(view.hit.shape, bool)
    aside[:, 20:] = True
    apart = compare.compare(view, changed(compare, view, albedo=other), aside)
    assert (apart.albedo, apart.compared) == (0.0, 17 * 40)
    assert compare.compare(view, changed(compare, view, albedo=other), albedos=False).holds


@pytest.mark.host
def test_who_is_right_is_told_by_what_is_met_first(script) -> None:
    referee = script("referee")
    near = [Crossing(7, Fraction(2)), Crossing(3, Fraction(2) + Fraction(1, 10**9)), Crossing(9, Fraction(3))]
    assert referee.decided(near, 7, 3) == "both are in the nearest place"
    assert referee.decided(near, 7, 9) == "the first is triangle 7; clgrid is right"
    assert referee.decided(near, 9, 3) == "the first is triangle 7; Mitsuba is right"
    assert referee.decided(near, 9, -1) == "the first is triangle 7; neither is right"
    assert referee.decided([], 4, -1) == "nothing is met; Mitsuba is right"


@pytest.mark.host
def test_pieces_hold_every_triangle_once_with_its_corners(script) -> None:
    pieces = script("pieces")
    model = clgrid.load_scene(scene("textured/CesiumMilkTruck.glb"))
    found = pieces.pieces_of(model.mesh, model.look, 0.8)
    numbers = np.concatenate([piece.triangles for piece in found])
    assert np.array_equal(np.sort(numbers), np.arange(model.mesh.triangle_count))
    for piece in found:
        corners = model.mesh.vertices[model.mesh.faces[piece.triangles]]
        assert np.array_equal(piece.vertices[piece.faces], corners)


@pytest.mark.thorough
def test_a_textured_quad_is_the_same_to_mitsuba(script, device: Device) -> None:
    pytest.importorskip("mitsuba", reason="Mitsuba 3 is not installed: pip install 'clgrid[peers]'")
    compare, pieces, second = script("compare"), script("pieces"), script("mitsuba")
    pixels = np.random.default_rng(5).integers(0, 256, (5, 7, 4), np.uint8)
    corners = np.array([[-1, -1, 0], [1, -1, 0.3], [1, 1, 0], [-1, 1, 0.2]], np.float32)
    mesh = Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]], np.uint32))
    uv = np.array([[-0.3, 1.4], [1.2, 0.9], [1.0, 0.1], [0.0, -0.2]], np.float32)
    material = Material(base_colour=(0.9, 0.5, 0.2, 1.0), base_texture=TextureUse(0))
    look = Look((material,), np.zeros(2, np.uint16), (Texture(pixels, ("mirror", "mirror")),), (uv,), (None,))
    camera = clgrid.Camera.look_at((0.3, 0.2, 4), (0, 0, 0))
    aovs = ("depth", "normal", "id", "uv", "albedo")
    picture = clgrid.render(mesh, camera, 48, 48, aovs, look=look, device=device)
    ours = compare.View(
        *(array.astype(np.float64) for array in (picture.depth, picture.normal, picture.uv, picture.albedo)),
        picture.primitive_id.astype(np.int32).astype(np.int64),
    )
    theirs = second.Second(second.load(), pieces.pieces_of(mesh, look, 0.8)).look(*camera.rays(48, 48))
    found = compare.compare(ours, theirs)
    assert found.holds
    assert found.compared > 500
    assert (ours.triangle == theirs.triangle).mean() > 0.999
    assert found.albedo < 0.05
    assert found.uv < 1e-5
