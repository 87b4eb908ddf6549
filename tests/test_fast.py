"""Rung ``fast``: it promises nothing, but its answers are those of `robust` nearly always, on every path."""

from __future__ import annotations

import numpy as np
import pytest
from meshes import MESHES

from clgrid import grid as grid_module
from clgrid import memory, procedural, target
from clgrid.brute import brute_force
from clgrid.device import Device
from clgrid.errors import InputError
from clgrid.grid import build
from clgrid.mesh import Mesh
from clgrid.renderer import render
from clgrid.wavefront import random_rays

BALL = procedural.icosphere(4)


def pair(mesh: Mesh, device: Device, **options: object) -> list[grid_module.Grid]:
    return [
        build(mesh, density=4, device=device, accuracy=accuracy, **options)  # type: ignore[arg-type]
        for accuracy in ("fast", "robust")
    ]


@pytest.mark.parametrize(
    "options",
    [{}, {"layout": "hashed"}, {"layout": "linked-list"}, {"layout": "dynamic-array"}, {"skipping": True}],
    ids=str,
)
def test_nearest_hits_are_those_of_robust_nearly_always(options: dict[str, object], device: Device) -> None:
    rays = random_rays(BALL, 20_000, seed=1)
    fast, robust = (grid.cast(rays.origins, rays.directions) for grid in pair(BALL, device, **options))
    assert (fast.primitive_ids != robust.primitive_ids).mean() < 1e-3
    same = (fast.primitive_ids == robust.primitive_ids) & robust.mask
    assert same.mean() > 0.2
    np.testing.assert_allclose(fast.t_hit[same], robust.t_hit[same], rtol=1e-5)
    np.testing.assert_allclose(fast.primitive_uvs[same], robust.primitive_uvs[same], atol=0.01)


def test_all_queries_agree_with_one_another_nearly_always(device: Device) -> None:
    rays = random_rays(BALL, 20_000, seed=2)
    fast, robust = pair(BALL, device)
    ray = rays.origins, rays.directions
    count, every = fast.count(*ray), fast.cast_all(*ray)
    np.testing.assert_array_equal(every.counts, count)
    assert (count != robust.count(*ray)).mean() < 1e-3
    np.testing.assert_array_equal(fast.occluded(*ray), count > 0)
    assert (fast.cast(*ray).mask != (count > 0)).mean() < 1e-3
    assert (brute_force(BALL, *ray, device=device, accuracy="fast").mask != (count > 0)).mean() < 1e-3
    points = rays.origins + rays.directions
    assert (fast.contains(points) != robust.contains(points)).mean() < 1e-3


def test_intervals_and_rays_that_are_none(device: Device) -> None:
    fast, _ = pair(BALL, device)
    origins, directions = np.zeros((5, 3)), np.tile([[0.0, 0.0, 2.0]], (5, 1))
    directions[1], directions[2, 0], origins[3, 1] = 0.0, np.nan, np.inf
    hits = fast.cast(origins, directions)
    assert hits.mask.tolist() == [True, False, False, False, True]
    assert hits.invalid_rays == 3
    np.testing.assert_allclose(hits.t_hit[0], 0.5, rtol=1e-4)
    assert not fast.cast(origins[0], directions[0], t_max=0.4).mask
    assert not fast.cast(origins[0], directions[0], t_min=0.6).mask
    assert fast.cast(origins[0], directions[0], t_min=-0.6, t_max=0.4).t_hit < 0


def test_counters_tell_of_work(device: Device) -> None:
    fast, robust = pair(BALL, device)
    rays = random_rays(BALL, 1000, seed=3)
    counted = [grid.cast(rays.origins, rays.directions, fields=("steps",)) for grid in (fast, robust)]
    for field in ("steps", "tests", "batches"):
        ours, theirs = (float(hits[field].mean()) for hits in counted)
        assert 0.5 < ours / theirs < 2


@pytest.mark.parametrize("smooth", [False, True])
def test_pictures_look_like_those_of_robust(smooth: bool, device: Device) -> None:
    normals = BALL.vertices if smooth else None
    mesh = Mesh(BALL.vertices, BALL.faces, vertex_normals=normals)
    aovs = ("depth", "normal", "id", "steps")
    fast, robust = (render(mesh, None, 101, 67, aovs, grid=grid) for grid in pair(mesh, device))
    assert (fast.primitive_id != robust.primitive_id).mean() < 1e-3
    same = fast.primitive_id == robust.primitive_id
    assert fast.depth is not None
    assert fast.normal is not None
    np.testing.assert_allclose(fast.rgba[same], robust.rgba[same], atol=2e-3)
    np.testing.assert_allclose(fast.depth[same], robust.depth[same], rtol=1e-5)  # type: ignore[index]
    np.testing.assert_allclose(fast.normal[same], robust.normal[same], atol=2e-3)  # type: ignore[index]


def test_parts_give_what_the_whole_gives(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    rays = random_rays(BALL, 2000, seed=4)
    whole, _ = pair(BALL, device)
    picture = render(BALL, None, 33, 17, ("id",), grid=whole)
    for module in (memory, target):
        monkeypatch.setattr(module, "largest_buffer", lambda device: 60_000)
    split, _ = pair(BALL, device)
    assert split.stats.parts > 1
    hits = [grid.cast(rays.origins, rays.directions) for grid in (whole, split)]
    assert (hits[0].primitive_ids != hits[1].primitive_ids).mean() < 2e-3
    again = render(BALL, None, 33, 17, ("id",), grid=split)
    assert (picture.primitive_id != again.primitive_id).mean() < 1e-2  # type: ignore[union-attr]


def test_what_only_strict_rungs_know_is_refused(device: Device) -> None:
    fast, _ = pair(BALL, device)
    with pytest.raises(InputError, match="'t_err' is of the strict rungs, not of fast"):
        fast.cast(np.zeros(3), np.ones(3), fields=("t_err",))
    with pytest.raises(InputError, match="t_err is of the strict rungs"):
        render(BALL, None, 8, 8, ("t_err",), grid=fast)


@pytest.mark.thorough
@pytest.mark.slow
@pytest.mark.parametrize("name", MESHES)
def test_no_mesh_is_too_strange(name: str, device: Device) -> None:
    """It ends, and finds what it can."""
    mesh = MESHES[name]
    rays = random_rays(mesh, 2000, seed=5)
    hits = build(mesh, density=4, device=device, accuracy="fast").cast(rays.origins, rays.directions)
    truth = brute_force(mesh, rays.origins, rays.directions, device=device)
    assert (hits.mask != truth.mask).mean() < 0.02
