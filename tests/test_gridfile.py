"""Grids in files: the same answers and bytes, and what is refused, in one line."""

from __future__ import annotations

import functools
import os
import struct
import subprocess
import sys
import zlib
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from same import assert_same_answers, some_rays

import clgrid
from clgrid import gridfile, memory, procedural, target
from clgrid.device import Device
from clgrid.errors import BufferTooLargeError, GridFileError
from clgrid.grid import build
from clgrid.layouts import ALL_LAYOUTS, LAYOUTS
from clgrid.mesh import Mesh

pytestmark = pytest.mark.thorough


def named(mesh: Mesh) -> Mesh:
    """The mesh with normals and two geometries."""
    starts = np.array([0, mesh.triangle_count // 3, mesh.triangle_count], np.int64)
    normals = mesh.vertices.astype(np.float32)
    return Mesh(mesh.vertices, mesh.faces, normals, starts, ("Ähre", "b"), "a \udce9 file", ("a warning",))


def wide(mesh: Mesh) -> Mesh:
    """In float64, with digits that float32 does not hold, far from the origin."""
    return Mesh(mesh.vertices.astype(np.float64) * 1.1 + 1e-9, mesh.faces)


KINDS = [*((layout, False) for layout in ALL_LAYOUTS), *((layout, True) for layout in LAYOUTS)]


@pytest.mark.parametrize(("layout", "skipping"), KINDS)
def test_an_opened_grid_answers_alike(layout: str, skipping: bool, device: Device, tmp_path: Path) -> None:
    mesh = named(procedural.icosphere(4))
    grid = build(mesh, layout, 2, skipping=skipping, device=device)
    grid.save(tmp_path / "a.grid")
    opened = clgrid.open_grid(tmp_path / "a.grid", device)
    assert opened.recipe == grid.recipe
    for field in ("triangles", "cells", "references", "resolution", "empty_share", "load_factor", "nbytes"):
        assert getattr(opened.stats, field) == getattr(grid.stats, field)
    assert_same_answers(opened, grid)
    for name, array in grid.arrays().items():
        np.testing.assert_array_equal(opened.arrays()[name], array)
    assert opened.mesh.geometry_names == ("Ähre", "b")
    assert opened.mesh.warnings == ("a warning",)
    assert opened.mesh.source == "a \\udce9 file"
    opened.save(tmp_path / "b.grid")
    same_files(tmp_path / "b.grid", tmp_path / "a.grid")
    for each in (opened, grid):
        each.update(mesh.vertices * np.float32(0.75))
    assert_same_answers(opened, grid)


def same_files(one: Path, other: Path) -> None:
    assert one.read_bytes() == other.read_bytes()


@pytest.mark.parametrize("accuracy", ["fast", "precise", "exact"])
@pytest.mark.parametrize("layout", ["compact", "nested"])
def test_of_every_accuracy_in_float64(accuracy: str, layout: str, device: Device, tmp_path: Path) -> None:
    grid = build(wide(procedural.icosphere(3)), layout, accuracy=accuracy, device=device)
    grid.save(tmp_path / "a.grid")
    assert_same_answers(clgrid.open_grid(tmp_path / "a.grid", device), grid)


def limit(monkeypatch: pytest.MonkeyPatch, nbytes: int) -> None:
    """Pretend that no buffer of the device may be larger."""
    for module in (memory, target):
        monkeypatch.setattr(module, "largest_buffer", lambda device: nbytes)


@pytest.mark.parametrize("layout", ALL_LAYOUTS)
def test_a_grid_of_several_parts(
    layout: str, device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mesh = named(procedural.icosphere(4))
    with monkeypatch.context() as patch:
        limit(patch, 20_000)
        grid = build(mesh, layout, 4, device=device)
        grid.save(tmp_path / "a.grid")
        opened = clgrid.open_grid(tmp_path / "a.grid", device)
        elsewhere = clgrid.open_grid(tmp_path / "a.grid", device)
        elsewhere.update(mesh.vertices * np.float32(0.5))
    assert grid.stats.parts == opened.stats.parts > 1
    assert_same_answers(opened, grid)
    assert_same_answers(clgrid.open_grid(tmp_path / "a.grid", device), grid)
    grid.update(mesh.vertices * np.float32(0.5))
    origins, directions = some_rays()
    np.testing.assert_array_equal(
        elsewhere.cast(origins, directions).t_hit, grid.cast(origins, directions).t_hit
    )


def test_a_device_with_smaller_buffers_says_so(
    device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    build(procedural.icosphere(4), device=device).save(tmp_path / "a.grid")
    limit(monkeypatch, 20_000)
    with pytest.raises(BufferTooLargeError, match=r"a\.grid: an array of .*; build the grid on") as caught:
        clgrid.open_grid(tmp_path / "a.grid", device)
    assert "\n" not in str(caught.value)


def test_a_mesh_without_triangles(device: Device, tmp_path: Path) -> None:
    mesh = Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint32))
    build(mesh, device=device).save(tmp_path / "a.grid")
    opened = clgrid.open_grid(tmp_path / "a.grid", device)
    assert opened.empty
    assert not opened.cast(*some_rays()).mask.any()


def test_a_nested_grid_without_subgrids_has_the_same_bytes(device: Device, tmp_path: Path) -> None:
    mesh = procedural.cube()
    for name in ("a", "b"):
        build(mesh, "nested", device=device).save(tmp_path / name)
    same_files(tmp_path / "a", tmp_path / "b")
    assert_same_answers(clgrid.open_grid(tmp_path / "a", device), build(mesh, "nested", device=device))


@pytest.mark.parametrize(("layout", "skipping"), KINDS)
def test_the_same_grid_gives_the_same_bytes(
    layout: str, skipping: bool, all_devices: list[Device], tmp_path: Path
) -> None:
    for number, device in enumerate(all_devices):
        build(procedural.icosphere(4), layout, 2, skipping=skipping, device=device).save(
            tmp_path / str(number)
        )
    for number in range(1, len(all_devices)):
        same_files(tmp_path / str(number), tmp_path / "0")


def test_saved_twice_it_has_the_same_bytes(device: Device, tmp_path: Path) -> None:
    grid = build(procedural.icosphere(3), device=device)
    grid.save(str(tmp_path / "a"))
    grid.save(tmp_path / "b")
    same_files(tmp_path / "a", tmp_path / "b")
    assert {path.name for path in tmp_path.iterdir()} == {"a", "b"}


def test_arrays_are_mapped_and_shared(
    device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No copy of an array is made on a device that shares the host's memory."""
    grid = build(procedural.icosphere(4), "hashed", skipping=True, device=device)
    grid.save(tmp_path / "a")
    shared: list[np.ndarray] = []
    adopt = memory.Allocator.adopt
    monkeypatch.setattr(
        memory.Allocator, "adopt", lambda self, array: shared.append(array) or adopt(self, array)
    )
    opened = clgrid.open_grid(tmp_path / "a", device)
    assert len(shared) == len(grid.stats.nbytes)
    for array in (*shared, opened.mesh.vertices, opened.mesh.faces):
        assert isinstance(first_owner(array), np.memmap)
        assert array.ctypes.data % 4096 == 0
    if device.cl_device.host_unified_memory:
        for buffer, array in zip(opened.parts[0].lists.buffers, shared, strict=True):
            host = buffer.get_host_array(array.nbytes, np.uint8)
            assert host.ctypes.data == array.ctypes.data
    assert opened.peak_nbytes == opened.nbytes == grid.nbytes


class Apart(SimpleNamespace):
    """A device, which is told from others by what it is."""

    __hash__ = object.__hash__


def test_a_device_with_memory_of_its_own_gets_a_copy(device: Device) -> None:
    facts = SimpleNamespace(host_unified_memory=False, max_mem_alloc_size=1 << 30, global_mem_size=1 << 30)
    apart = Apart(cl_device=facts, context=device.context, queue=device.queue)
    allocator = memory.Allocator(apart)  # type: ignore[arg-type]
    array = np.arange(5000, dtype=np.uint32)
    buffer = allocator.adopt(array)
    assert allocator.in_use == array.nbytes
    array[:] = 0
    np.testing.assert_array_equal(allocator.download(buffer, np.uint32, 5000), np.arange(5000))
    assert allocator.adopt(array[:0]).size == 1


def first_owner(array: np.ndarray) -> object:
    while isinstance(array.base, np.ndarray):
        array = array.base
    return array


def test_writing_to_an_opened_mesh_leaves_the_file(device: Device, tmp_path: Path) -> None:
    build(procedural.icosphere(3), device=device).save(tmp_path / "a")
    before = (tmp_path / "a").read_bytes()
    opened = clgrid.open_grid(tmp_path / "a", device)
    opened.update(opened.mesh.vertices * np.float32(3))
    opened.mesh.faces[:] = 0
    assert (tmp_path / "a").read_bytes() == before


def test_the_file_may_be_replaced_while_it_is_open(device: Device, tmp_path: Path) -> None:
    grid = build(procedural.icosphere(3), device=device)
    grid.save(tmp_path / "a")
    opened = clgrid.open_grid(tmp_path / "a", device)
    build(procedural.cube(), device=device).save(tmp_path / "a")
    assert_same_answers(opened, grid)
    opened.save(tmp_path / "a")
    assert_same_answers(clgrid.open_grid(tmp_path / "a", device), grid)


CHILD = """
import sys, clgrid
grid = clgrid.open_grid(sys.argv[1])
print(int(grid.count([[0.1, 0.2, 3]], [[0, 0, -1]])[0]))
"""


def test_another_process_opens_it(device: Device, tmp_path: Path) -> None:
    build(procedural.icosphere(3), device=device).save(tmp_path / "a")
    root = Path(__file__).resolve().parent.parent
    child = subprocess.run(
        [sys.executable, "-c", CHILD, tmp_path / "a"],
        env={
            **os.environ,
            "PYTHONPATH": os.pathsep.join([str(root), *sys.path]),
            "CLGRID_DEVICE": device.label,
        },
        capture_output=True,
        text=True,
        check=False,
    )
    assert child.stdout.strip() == "2", child.stderr


@pytest.fixture(scope="module")
def file(device: Device, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small file with all kinds of arrays."""
    path = tmp_path_factory.mktemp("file") / "whole.grid"
    build(named(procedural.cube()), "hashed", skipping=True, device=device).save(path)
    return path


def refused(data: bytes, path: Path, device: Device, message: str = "") -> str:
    path.write_bytes(data)
    with pytest.raises(GridFileError, match=message or None) as caught:
        clgrid.open_grid(path, device)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(f"{path}: ")
    return str(caught.value)


few = settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])


@few
@given(data=st.data())
def test_a_change_of_any_byte_is_refused(
    file: Path, data: st.DataObject, device: Device, tmp_path: Path
) -> None:
    content = bytearray(file.read_bytes())
    # As often in the header, which is a small part of it.
    at = data.draw(st.integers(0, len(content) - 1) | st.integers(0, 2000))
    content[at] ^= data.draw(st.integers(1, 255))
    refused(bytes(content), tmp_path / "a", device)


@few
@given(data=st.data())
def test_a_file_cut_anywhere_is_refused(
    file: Path, data: st.DataObject, device: Device, tmp_path: Path
) -> None:
    content = file.read_bytes()
    length = data.draw(st.integers(0, len(content) - 1) | st.integers(0, 64))
    refused(
        content[:length], tmp_path / "a", device, "truncated" if length >= 36 else "not the file of a grid"
    )


@few
@given(junk=st.binary(max_size=200))
def test_what_is_no_grid_is_refused(junk: bytes, device: Device, tmp_path: Path) -> None:
    refused(junk, tmp_path / "a", device, "not the file of a grid")


def test_other_versions_are_refused(file: Path, device: Device, tmp_path: Path) -> None:
    content = file.read_bytes()
    newer = content[:8] + struct.pack("<I", gridfile.FORMAT + 1) + content[12:]
    refused(newer, tmp_path / "a", device, rf"format version {gridfile.FORMAT + 1}, and this clgrid reads")
    refused(content + b"\0", tmp_path / "a", device, "altered")


def test_a_header_of_something_else_is_refused(device: Device, tmp_path: Path) -> None:
    """Its checksum is right, but it says nothing of a grid."""
    for header in (b"{}", b"[1]", b"{", b"\xff", b""):
        start = struct.pack("<8sIIQQ", gridfile.MAGIC, gridfile.FORMAT, 0, len(header), 4096)
        padded = header.ljust(4096 - len(start) - 4, b"\0")
        content = start + struct.pack("<I", zlib.crc32(start + padded)) + padded
        refused(content, tmp_path / "a", device, "not the file of a grid")


def test_other_structs_are_refused(file: Path, device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("clgrid.saved._structs", lambda: "other")
    with pytest.raises(GridFileError, match=r"written by clgrid .*; build the grid and save it anew"):
        clgrid.open_grid(file, device)


def test_what_is_not_there_is_refused(device: Device, tmp_path: Path) -> None:
    with pytest.raises(GridFileError, match=r"nothing: no such file; grid\.save"):
        clgrid.open_grid(tmp_path / "nothing", device)
    with pytest.raises(GridFileError, match="is a folder; name the file"):
        clgrid.open_grid(tmp_path, device)


def test_where_nothing_can_be_written(device: Device, tmp_path: Path) -> None:
    grid = build(procedural.cube(), device=device)
    for path, message in (
        (tmp_path, "is a folder"),
        (tmp_path / "no" / "a", "no such folder"),
        (tmp_path / ("a" * 300), "cannot be written"),
    ):
        with pytest.raises(GridFileError, match=message):
            grid.save(path)
    assert not list(tmp_path.iterdir())


def failing(after: int) -> Callable[..., object]:
    """A write of an array that finds the disk full after some."""
    left = iter(range(after))
    write = gridfile._write_array

    @functools.wraps(write)
    def fail(*arguments: object) -> object:
        if next(left, None) is None:
            raise OSError(28, "No space left on device")
        return write(*arguments)  # type: ignore[arg-type]

    return fail


def test_a_failure_leaves_what_was_there(
    device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a"
    build(procedural.cube(), device=device).save(path)
    before = path.read_bytes()
    monkeypatch.setattr(gridfile, "_write_array", failing(after=3))
    with pytest.raises(GridFileError, match=r"a: cannot be written \(No space left on device\); choose"):
        build(procedural.icosphere(3), device=device).save(path)
    assert path.read_bytes() == before
    assert [each.name for each in tmp_path.iterdir()] == ["a"]
