"""Rays and hits that stay on the device: the bits of cast, for any shape, and what is refused."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from same import assert_same_bits, some_rays

import clgrid
from clgrid import memory, procedural, target
from clgrid.device import Device
from clgrid.errors import InputError
from clgrid.grid import Grid, build
from clgrid.layouts import ALL_LAYOUTS
from clgrid.mesh import Mesh

pytestmark = pytest.mark.thorough


def queue_of(device: Device, **options: Any) -> Any:
    import pyopencl as cl

    return cl.CommandQueue(device.context, **options)


def on(queue: Any, *arrays: np.ndarray) -> list[Any]:
    import pyopencl.array as cl_array

    return [cl_array.to_device(queue, np.ascontiguousarray(array)) for array in arrays]


def assert_answers_as_hosts(grid: Grid, rays: tuple[np.ndarray, np.ndarray], *rest: Any) -> None:
    queue = queue_of(grid.device)
    on_it = on(queue, *rays)
    for found, expected in (
        (grid.occluded_on_device(queue, *on_it, *rest), grid.occluded(*rays, *rest).astype(np.uint8)),
        (grid.count_on_device(queue, *on_it, *rest), grid.count(*rays, *rest)),
    ):
        assert (found.shape, found.dtype) == (expected.shape, expected.dtype)
        assert found.get().tobytes() == expected.tobytes()


def assert_as_cast(grid: Grid, rays: tuple[np.ndarray, np.ndarray], *rest: Any, **options: Any) -> None:
    queue = queue_of(grid.device)
    found = grid.cast_on_device(queue, *on(queue, *rays), *rest, **options)
    expected = grid.cast(*rays, *rest, **options)
    hits = found.get()
    assert hits.invalid_rays == expected.invalid_rays
    assert_same_bits(hits, expected, ("t_hit", "primitive_ids", "points", "primitive_normals"))
    assert hits.computed.keys() == expected.computed.keys()
    for name, array in expected.computed.items():
        assert hits.computed[name].dtype == array.dtype
        assert hits.computed[name].tobytes() == array.tobytes(), name


@pytest.mark.parametrize("layout", ALL_LAYOUTS)
def test_the_bits_of_cast(layout: str, device: Device) -> None:
    grid = build(procedural.icosphere(4), layout, device=device)
    assert_as_cast(grid, some_rays(count=3001))


def test_occlusion_and_counts_are_the_hosts(device: Device) -> None:
    grid = build(procedural.icosphere(4), device=device)
    rays = some_rays(count=3001)
    assert 0 < grid.occluded(*rays).mean() < 1
    assert_answers_as_hosts(grid, rays, 0.25, np.linspace(0, 3, 3001))
    for shape in ((), (0,), (40, 7), (9, 30)):
        count = int(np.prod(shape))
        assert_answers_as_hosts(grid, tuple(array[:count].reshape(*shape, 3) for array in rays))


@pytest.mark.parametrize("real", [np.float32, np.float64])
@pytest.mark.parametrize("shape", [(1,), (63,), (9, 30), (40, 7), (3, 5, 17), (0,), (0, 4), ()])
def test_rays_of_any_shape(shape: tuple[int, ...], real: type, device: Device) -> None:
    grid = build(procedural.icosphere(3), device=device)
    origins, directions = some_rays(count=int(np.prod(shape)))
    assert_as_cast(grid, tuple(array.reshape(*shape, 3).astype(real) for array in (origins, directions)))


def test_of_the_rays_of_a_camera(device: Device) -> None:
    mesh = procedural.icosphere(3)
    grid = build(mesh, device=device)
    x, y = np.meshgrid(np.linspace(-1.2, 1.2, 50), np.linspace(-1.2, 1.2, 40))
    origins = np.stack([x, y, np.full_like(x, 3.0)], axis=-1)
    assert_as_cast(grid, (origins, np.broadcast_to([0.0, 0.0, -1.0], origins.shape)))


@pytest.mark.parametrize("accuracy", ["fast", "robust", "precise", "exact"])
def test_all_that_may_be_asked_for(accuracy: str, device: Device) -> None:
    grid = build(procedural.icosphere(3), accuracy=accuracy, device=device)
    fields = ["primitive_uvs", "steps"]
    fields += ["t_err"] if accuracy != "fast" else []
    fields += ["certain"] if accuracy == "exact" else []
    rays = some_rays(count=500)
    # Counters depend on which rays share a tile.
    assert_as_cast(grid, rays, fields=[name for name in fields if name != "steps"])
    assert_as_cast(grid, rays, fields=())
    queue = queue_of(device)
    found = grid.cast_on_device(queue, *on(queue, *rays), fields=fields)
    assert set(found.computed) == {*fields, "steps", "tests", "batches"} - {"primitive_uvs"}
    assert (found.computed["steps"].get()[grid.cast(*rays).mask] > 0).all()


def test_intervals_and_rays_that_are_none(device: Device) -> None:
    grid = build(procedural.icosphere(3), device=device)
    origins, directions = some_rays(count=300)
    origins[5], directions[7], directions[9] = np.nan, 0, np.inf
    assert_as_cast(grid, (origins, directions), 0.25, 1.5)
    t_max = np.linspace(0, 3, 300)
    t_max[3] = np.nan
    assert_as_cast(grid, (origins, directions), 0.1, t_max)


def test_several_parts(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        for module in (memory, target):
            patch.setattr(module, "largest_buffer", lambda device: 20_000)
        grid = build(procedural.icosphere(4), density=4, device=device)
    assert grid.stats.parts > 1
    assert_as_cast(grid, some_rays(count=1000))
    assert_answers_as_hosts(grid, some_rays(count=1000))


def test_a_mesh_without_triangles(device: Device) -> None:
    grid = build(Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint32)), device=device)
    origins, directions = some_rays(count=20)
    directions[3] = 0
    assert_as_cast(grid, (origins, directions))
    assert_answers_as_hosts(grid, (origins, directions))


def test_hits_are_taken_on_by_other_work(device: Device) -> None:
    """On a queue that keeps no order, by events alone."""
    import pyopencl as cl

    modes = cl.command_queue_properties
    queue = queue_of(device, properties=modes.OUT_OF_ORDER_EXEC_MODE_ENABLE)
    grid = build(procedural.icosphere(4), device=device)
    origins, directions = some_rays(count=2000)
    far, along = on(queue, origins * 0.5, directions)
    found = grid.cast_on_device(queue, far * 2, along)
    twice = found.t_hit + found.t_hit
    np.testing.assert_array_equal(twice.get(), 2 * grid.cast(origins, directions).t_hit)
    counts = grid.count_on_device(queue, far * 2, along)
    np.testing.assert_array_equal((counts + counts).get(), 2 * grid.count(origins, directions))
    assert found.event.command_execution_status == cl.command_execution_status.COMPLETE


_DROPPING = """
import sys
import numpy as np, pyopencl as cl, pyopencl.array as cl_array
from clgrid import Mesh, build, procedural
from clgrid.device import choose
from same import some_rays

device = choose(sys.argv[1])
rays = some_rays(count=100_000)

def start():
    queue = cl.CommandQueue(device.context)
    ball = procedural.icosphere(5)
    grid = build(Mesh(ball.vertices.copy(), ball.faces.copy()), density=2.0, device=device)
    return grid, grid.count_on_device(queue, *(cl_array.to_device(queue, each) for each in rays))

expected = start()[1].get()
for _ in range(3):
    counts = start()[1]
    junk = [np.full(1 << 20, 255, np.uint8) for _ in range(40)]  # where the grid was
    assert np.array_equal(counts.get(), expected)
kept = start()
print("done")
"""


def test_a_grid_may_go_while_a_kernel_reads_it(device: Device) -> None:
    """In a process of its own, which ends with a kernel under way: such a fault ends the process."""
    paths = [str(Path(__file__).parent), str(Path(clgrid.__file__).parent.parent)]
    done = subprocess.run(
        [sys.executable, "-c", _DROPPING, device.description.label],
        env={**os.environ, "PYTHONPATH": os.pathsep.join([*paths, os.environ.get("PYTHONPATH", "")])},
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stdout) == (0, "done\n"), done.stderr[-500:]


def test_what_does_not_fit_is_refused(device: Device) -> None:
    import pyopencl as cl

    grid, queue = build(procedural.cube(), device=device), queue_of(device)
    origins, directions = on(queue, *some_rays(count=20))
    # Kept: Intel's queues do not keep their context.
    context = cl.Context([device.cl_device])
    foreign = cl.CommandQueue(context)
    elsewhere = on(foreign, *some_rays(count=20))
    cases: list[tuple[tuple[Any, ...], str]] = [
        ((foreign, origins, directions), "the queue is of another context"),
        ((queue, origins, elsewhere[1]), "directions are of another context"),
        ((queue, origins.get(), directions), "origins are a ndarray; give a pyopencl array, or call cast"),
        ((queue, origins, directions[:10]), "must be of one shape and dtype"),
        ((queue, origins.astype(np.float32), directions), "must be of one shape and dtype"),
        ((queue, origins.astype(np.int32), directions), "have shape .* and dtype int32"),
        ((queue, origins[:, :2], directions), "origins have shape"),
        ((queue, origins[::2], directions[::2]), "are strided or begin within"),
        ((queue, origins[1:], directions[1:]), "are strided or begin within"),
        ((queue, origins, directions, np.zeros(3)), "do not broadcast"),
    ]
    for arguments, message in cases:
        for ask in (grid.cast_on_device, grid.occluded_on_device, grid.count_on_device):
            with pytest.raises(InputError, match=message):
                ask(*arguments)
    with pytest.raises(InputError, match="unknown 'colour'"):
        grid.cast_on_device(queue, origins, directions, fields=("colour",))
    grid.release()
    for ask in (grid.cast_on_device, grid.occluded_on_device, grid.count_on_device):
        with pytest.raises(clgrid.InputError, match="was released"):
            ask(queue, origins, directions)
