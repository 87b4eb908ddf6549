"""How rays given as arrays are dealt to tiles and launches, which changes no bit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from agreement import Query, assert_same
from bundles import GRID, TILE, assert_brute, orders, shaped, view
from meshes import MESHES

from clgrid import cast
from clgrid.brute import brute_force
from clgrid.device import Device
from clgrid.grid import build
from clgrid.rays import as_bounded_rays
from clgrid.tiles import Division, division_of


def division(rays: Query) -> Division:
    return division_of(as_bounded_rays(*rays))


@pytest.mark.parametrize(("width", "height"), [(16, 16), (17, 30), (64, 64), (65, 33), (100, 77), (640, 48)])
def test_rows_of_images_are_found(width: int, height: int) -> None:
    rng = np.random.default_rng(30)
    found = {name: division(rays).row for name, rays in orders(view((1, 2, 3), width, height), rng)}
    expected = {"an image": width, "rows": width, "rows with gaps": 0, "shuffled": 0, "reversed": width}
    assert found == expected


@pytest.mark.parametrize("shape", [(5000,), (100, 50), (2, 100, 50), (0,), (0, 50), (50, 0), (3, 100), ()])
def test_there_are_no_rows_in_random_rays(shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(31)
    o, d = rng.normal(size=(2, *shape, 3))
    assert division(shaped(o, d)) == Division()
    assert division(shaped(np.full((*shape, 3), np.nan), d)) == Division()
    assert division(shaped(o, np.full((*shape, 3), np.inf))) == Division()


@pytest.mark.parametrize(("row", "count"), [(16, 128), (17, 17 * 30), (100, 800), (0, 1), (0, 65), (0, 4095)])
def test_every_ray_is_in_one_work_item(row: int, count: int) -> None:
    """As ray_in_tile of cl/rays_in_out.h deals them."""
    size = Division(row)
    k = np.arange(TILE)
    if row:
        g, lane, tile = k // 8, k % 8, np.arange(size.items(count))[:, None]
        across = -(-row // 8)
        x, y = tile % across * 8 + g % 2 * 4 + lane % 4, tile // across * 8 + g // 2 * 2 + lane // 4
        rays = np.where(x < row, y * row + x, count)
    else:
        rays = np.arange(size.items(count))[:, None] * TILE + k
    np.testing.assert_array_equal(np.sort(rays[rays < count]), np.arange(count))


@pytest.mark.thorough
@pytest.mark.parametrize("most", [1000, 1600, 4096, 10_000])
def test_launches_of_bounded_size_change_no_bit(
    most: int, device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    mesh, rng = MESHES["torus"], np.random.default_rng(32)
    launches = []
    whole = cast.launch_on_host

    def counted(target: Any, launch: Any, rays: list[Any], results: Any) -> None:
        launches.append(len(rays[0]))
        whole(target, launch, rays, results)

    monkeypatch.setattr(cast, "launch_on_host", counted)
    monkeypatch.setattr(cast, "_RAYS_PER_LAUNCH", most)
    grid = build(mesh, device=device, **GRID)
    for _, rays in orders(view((1, 2, 3), 100, 77), rng):
        launches.clear()
        hits = grid.cast(*rays, fields=("t_err",))
        assert len(launches) > 0
        assert max(launches) <= most
        count = rays[2].size
        if count > most:
            assert len(launches) > 1
        monkeypatch.setattr(cast, "_RAYS_PER_LAUNCH", 1 << 22)
        assert_same(hits, grid.cast(*rays, fields=("t_err",)))
        assert_same(hits, brute_force(mesh, *rays, device=device, fields=("t_err",)))
        monkeypatch.setattr(cast, "_RAYS_PER_LAUNCH", most)


def test_rows_longer_than_a_launch(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """Eight of them, a band of tiles, do not fit into one: as 8 rows of 600,000 rays."""
    monkeypatch.setattr(cast, "_RAYS_PER_LAUNCH", 500)
    hits = assert_brute(MESHES["torus"], device, "robust", view((1, 2, 3), 100, 16))
    assert hits.mask.any()


@pytest.mark.parametrize("processors", [1, 2, 3])
def test_keys_are_sorted_in_a_run_for_each_processor(
    processors: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cast, "_SHORTEST_RUN", 100)
    monkeypatch.setattr("os.cpu_count", lambda: processors)
    keys = np.random.default_rng(33).permutation(1000).astype(np.uint64)
    sorted_keys = keys.copy()
    cast._sort_runs(sorted_keys)
    for run, given in zip(
        np.array_split(sorted_keys, processors), np.array_split(keys, processors), strict=True
    ):
        np.testing.assert_array_equal(run, np.sort(given))


def test_an_order_of_several_runs_changes_no_bit(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cast, "_SHORTEST_RUN", 500)
    monkeypatch.setattr("os.cpu_count", lambda: 3)
    mesh = MESHES["torus"]
    directions = np.random.default_rng(34).normal(size=(2000, 3))
    hits = build(mesh, device=device, **GRID).cast(np.zeros(3), directions)
    assert_same(hits, brute_force(mesh, np.zeros(3), directions, device=device))
    assert hits.mask.any()
