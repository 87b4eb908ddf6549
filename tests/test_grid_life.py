"""The life of a grid: released, copied, pickled, forked; a hundred of them leave memory as it was."""

from __future__ import annotations

import copy
import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from same import answers, assert_same_answers

import clgrid
from clgrid import procedural
from clgrid.device import Device
from clgrid.errors import ClgridError, DeviceError, InputError
from clgrid.grid import Grid, build
from clgrid.layouts import ALL_LAYOUTS
from clgrid.mesh import Mesh

pytestmark = pytest.mark.thorough

RAY = ([[0.1, 0.2, 3.0]], [[0.0, 0.0, -1.0]])

USES: dict[str, Callable[[Grid], object]] = {
    "cast": lambda grid: grid.cast(*RAY),
    "cast_all": lambda grid: grid.cast_all(*RAY),
    "count": lambda grid: grid.count(*RAY),
    "occluded": lambda grid: grid.occluded(*RAY),
    "contains": lambda grid: grid.contains([[0, 0, 0]]),
    "render": lambda grid: clgrid.render(grid.mesh, width=8, height=8, grid=grid),
    "update": lambda grid: grid.update(grid.mesh.vertices),
    "arrays": lambda grid: grid.arrays(),
    "save": lambda grid: grid.save("never.grid"),
    "frame": lambda grid: grid.frame,
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
}


@pytest.mark.parametrize("use", [*USES, "with", "pickle"])
def test_use_after_release_is_one_clear_error(use: str, device: Device) -> None:
    grid = build(procedural.cube(), device=device)
    grid.release()
    grid.release()
    uses = {**USES, "with": Grid.__enter__, "pickle": pickle.dumps}
    with pytest.raises(InputError, match=r"^the grid over .* was released; build it anew$"):
        uses[use](grid)


def test_a_grid_of_nothing_is_released_too(device: Device) -> None:
    grid = build(Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint32)), device=device)
    with grid as same:
        assert same is grid
        assert not grid.occluded(*RAY).any()
    with pytest.raises(InputError, match="was released"):
        grid.occluded(*RAY)


def test_with_releases_whatever_happens(device: Device) -> None:
    grid = build(procedural.cube(), device=device)
    assert grid.cast(*RAY).mask.all()
    buffers = grid.parts[0].lists.buffers
    with pytest.raises(ZeroDivisionError), grid:
        _ = 1 / 0
    assert grid.parts == []
    assert grid.stats.triangles == 12
    assert grid.nbytes == 0
    held = sys.getrefcount(buffers[0])
    assert held == 2, "nobody but this test holds a buffer"


def test_what_was_answered_outlives_the_grid(device: Device) -> None:
    with build(procedural.icosphere(2), device=device) as grid:
        hits = grid.cast(*RAY)
    assert hits.mask.all()
    assert hits.points.shape == (1, 3)
    assert hits.primitive_normals.shape == (1, 3)


@pytest.mark.parametrize("layout", ALL_LAYOUTS)
def test_copies_live_on_their_own(layout: str, device: Device) -> None:
    mesh = procedural.icosphere(3)
    grid = build(mesh, layout, device=device)
    expected = answers(grid)
    shallow, deep = copy.copy(grid), copy.deepcopy(grid)
    assert shallow.mesh is mesh
    assert deep.mesh is not mesh
    assert not np.shares_memory(deep.mesh.vertices, mesh.vertices)
    assert grid.recipe == shallow.recipe == deep.recipe
    shallow.update(mesh.vertices * np.float32(2))
    grid.release()
    assert answers(deep) == expected
    assert answers(copy.copy(deep)) == expected


@pytest.mark.parametrize(
    "options",
    [
        *({"layout": layout} for layout in ALL_LAYOUTS),
        {"resolution": (5, 6, 7), "skipping": True, "max_memory": 1 << 24},
        {"accuracy": "exact", "density": 3},
        {"layout": "auto", "skipping": "auto"},
    ],
    ids=str,
)
def test_a_pickled_grid_is_rebuilt(options: dict[str, object], device: Device) -> None:
    ball = procedural.icosphere(3)
    starts = np.array([0, 7, ball.triangle_count], np.int64)
    mesh = Mesh(ball.vertices, ball.faces, ball.vertices.copy(), starts, ("a", "b"), "ball", ("warned",))
    grid = build(mesh, device=device, **options)  # type: ignore[arg-type]
    grid.update(ball.vertices * np.float32(1.25))
    loaded = pickle.loads(pickle.dumps(grid))
    assert loaded.device is device
    assert loaded.recipe == grid.recipe
    assert (loaded.choice is None) == (grid.choice is None)
    assert loaded.mesh.geometry_names == ("a", "b")
    assert loaded.mesh.source == "ball"
    assert_same_answers(loaded, grid)
    for name, array in grid.arrays().items():
        np.testing.assert_array_equal(loaded.arrays()[name], array)


def test_an_empty_or_opened_grid_is_pickled(device: Device, tmp_path: Path) -> None:
    nothing = build(Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint32)), device=device)
    assert pickle.loads(pickle.dumps(nothing)).empty
    grid = build(procedural.icosphere(3), device=device)
    grid.save(tmp_path / "a")
    opened = clgrid.open_grid(tmp_path / "a", device)
    assert_same_answers(pickle.loads(pickle.dumps(opened)), grid)
    assert_same_answers(copy.deepcopy(opened), grid)


def test_where_its_device_is_not_it_is_rebuilt_on_the_default(
    device: Device, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    grid = build(procedural.icosphere(2), device=device)
    expected = answers(grid)
    data = pickle.dumps(grid)
    monkeypatch.setenv("CLGRID_DEVICE", device.label)
    loaded = pickle.loads(data.replace(device.label.encode(), b"?" * len(device.label)))
    assert loaded.device is device
    assert "it is rebuilt on" in caplog.text
    assert answers(loaded) == expected


def in_a_fork(run: Callable[[], str], seconds: int = 60) -> str:
    """What ``run`` returns in a forked child, which is killed if it hangs."""
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        signal.alarm(seconds)
        try:
            found = run()
        except BaseException as error:
            found = f"{type(error).__name__}: {error}"
        os.write(write, found.encode())
        os._exit(0)
    os.close(write)
    with os.fdopen(read, "rb") as pipe:
        found = pipe.read().decode()
    _, status = os.waitpid(child, 0)
    assert status == 0, "the child hung" if os.WIFSIGNALED(status) else status
    return found


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork")
@pytest.mark.filterwarnings("ignore:.*multi-threaded, use of fork:DeprecationWarning")
def test_a_forked_process_is_told_so(device: Device) -> None:
    grid = build(procedural.icosphere(2), device=device)
    expected = answers(grid)

    def messages() -> str:
        found = []
        for name, use in USES.items():
            try:
                use(grid)
            except ClgridError as error:
                found.append(f"{name} {type(error).__name__} {error}")
        grid.release()
        return "\n".join(found)

    told = in_a_fork(messages).splitlines()
    assert [line.split()[0] for line in told] == list(USES)
    for line in told:
        assert line.split()[1] == DeviceError.__name__
        assert "multiprocessing.get_context('spawn')" in line
    assert answers(grid) == expected, "the child has left the parent's buffers alone"


def cast_in_a_child(grid: Grid) -> tuple[bytes, str]:
    return grid.cast(*RAY).t_hit.tobytes(), grid.device.label


def test_a_spawned_process_rebuilds_it(device: Device) -> None:
    grid = build(procedural.icosphere(2), device=device)
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        assert pool.apply(cast_in_a_child, (grid,)) == (grid.cast(*RAY).t_hit.tobytes(), device.label)


HUNDRED = """
    import gc, os, sys
    import clgrid
    from clgrid import procedural

    def resident():
        gc.collect()
        with open("/proc/self/statm") as file:
            return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")

    mesh, how = procedural.make("icosphere:6"), sys.argv[1]
    rays = [[0.1, 0.2, 3.0]] * 1000, [[0.0, 0.0, -1.0]] * 1000

    def once():
        grid = clgrid.build(mesh, density=4)
        assert grid.cast(*rays).mask.all()
        nbytes = grid.nbytes
        if how == "release":
            grid.release()
        return nbytes

    for _ in range(20):
        nbytes = once()
    before = resident()
    for _ in range(100):
        once()
    print((resident() - before) / nbytes)
"""


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is read from /proc")
@pytest.mark.parametrize("how", ["release", "forget"])
def test_a_hundred_grids_leave_memory_flat(how: str, device: Device) -> None:
    """All that is kept of a hundred grids is less than what five of them take."""
    root = Path(__file__).resolve().parent.parent
    path = os.pathsep.join([str(root), *sys.path])
    child = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(HUNDRED), how],
        env={**os.environ, "PYTHONPATH": path, "CLGRID_DEVICE": device.label},
        capture_output=True,
        text=True,
        check=False,
    )
    assert child.returncode == 0, child.stderr
    assert float(child.stdout) < 5
