from __future__ import annotations

import gzip
import io
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from meshes import MESHES
from scenes import scene

import clgrid
from clgrid import frames as module
from clgrid.bench import Work
from clgrid.camera import Camera
from clgrid.cli import main
from clgrid.errors import InputError
from clgrid.frames import bench_frames, bounds_of_all, read_frames
from clgrid.grid import Grid
from clgrid.layouts import ALL_LAYOUTS
from clgrid.mesh import Mesh
from clgrid.procedural import icosphere
from clgrid.record import FramesRecord, decode, encode
from clgrid.renderer import render
from clgrid.scene import Scene

SMALL = Work(width=24, height=16, repetitions=2)
BALL = icosphere(2)


def swelling(count: int = 3) -> np.ndarray:
    """The ball at sizes 1, 2, 3..., moving to the right."""
    sizes = np.arange(1, count + 1, dtype=np.float32)[:, None, None]
    return BALL.vertices[None] * sizes + sizes * np.float32([1, 0, 0])


@pytest.fixture
def save(tmp_path):
    def write(frames: np.ndarray, name: str = "f.npy") -> Path:
        path = tmp_path / name
        with gzip.open(path, "wb") if name.lower().endswith(".gz") else open(path, "wb") as file:
            np.save(file, frames)
        return path

    return write


# Reading


@pytest.mark.parametrize("name", ["f.npy", "f.npy.gz", "F.NPY.GZ"])
def test_frames_come_back_as_they_were(save, name):
    assert np.array_equal(read_frames(save(swelling(), name), BALL), swelling())


def test_fortran_order_is_read_too(save, device):
    path = save(np.asfortranarray(swelling()))
    assert np.array_equal(read_frames(path, BALL), swelling())
    assert len(bench_frames("icosphere:2", path, SMALL, device).rows) == 3


def poisoned(value: float) -> np.ndarray:
    frames = swelling()
    frames[1, 7, 2] = value
    return frames


@pytest.mark.parametrize(
    ("frames", "words"),
    [
        (swelling().astype(np.float64), "<f8"),
        (swelling().astype(">f4"), ">f4"),
        (swelling()[0], r"shape \(162, 3\)"),
        (swelling()[..., :2], r"shape \(3, 162, 2\)"),
        (swelling()[:0], r"shape \(0, 162, 3\)"),
        (swelling()[:, :-1], "161 vertices a frame.*has 162"),
        (poisoned(np.nan), "frame 1, vertex 7"),
        (poisoned(-np.inf), "frame 1, vertex 7"),
        (np.array([{"a": 1}], object), "not a .npy"),
    ],
)
def test_frames_that_do_not_fit_are_named(save, frames, words):
    with pytest.raises(InputError, match=words) as caught:
        read_frames(save(frames), BALL)
    assert "f.npy" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_files_that_are_no_arrays_are_named(tmp_path, save):
    whole = save(swelling(), "whole.npy.gz").read_bytes()
    plain = save(swelling(), "whole.npy").read_bytes()
    boast = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        boast, {"descr": "<f4", "fortran_order": False, "shape": (10**8, 162, 3)}
    )
    contents = {
        "text.npy": b"hello",
        "empty.npy": b"",
        "cut.npy": plain[:-5],
        "cut_header.npy": plain[:20],
        "empty.npy.gz": b"",
        "text.npy.gz": b"hello",
        "cut.npy.gz": whole[: len(whole) // 2],
        "flipped.npy.gz": whole[:200] + bytes(50) + whole[250:],
        "boasts.npy": boast.getvalue(),
        "boasts.npy.gz": gzip.compress(boast.getvalue()),
    }
    for name, content in contents.items():
        (tmp_path / name).write_bytes(content)
    np.savez(tmp_path / "many.npz", swelling())
    for name in (*contents, "many.npz", "missing.npy", "missing.npy.gz", "."):
        with pytest.raises(InputError, match=re.escape(str(tmp_path / name))) as caught:
            read_frames(tmp_path / name, BALL)
        assert "\n" not in str(caught.value)


# Measuring


@pytest.mark.parametrize("layout", ALL_LAYOUTS)
def test_each_frame_is_built_and_drawn_as_a_mesh_of_its_own(device, save, layout):
    frames = swelling()
    result = bench_frames("icosphere:2", save(frames), replace(SMALL, layout=layout, density=4), device)
    view = Camera.framing(bounds_of_all(frames, BALL), aspect=24 / 16)
    assert [row.frame for row in result.rows] == [0, 1, 2]
    for row, vertices in zip(result.rows, frames, strict=True):
        mesh = Mesh(np.ascontiguousarray(vertices), BALL.faces)
        grid = clgrid.build(mesh, layout=layout, density=4, device=device)
        assert row.references == grid.stats.references
        assert row.resolution == grid.stats.resolution
        assert row.grid_bytes == grid.nbytes <= row.peak_bytes
        assert row.hits == render(mesh, view, 24, 16, grid=grid).hits
    hits = [row.hits for row in result.rows]
    assert 0 < hits[0] < hits[1] < hits[2]


def test_times_are_lists_with_an_entry_a_repetition(device, save):
    result = bench_frames("icosphere:2", save(swelling()), Work(8, 8, 3), device)
    for row in result.rows:
        assert len(row.build_s) == len(row.render_s) == 3
        assert [b + r for b, r in zip(row.build_s, row.render_s, strict=True)] == row.time_to_image_s
        assert min(row.build_s + row.render_s) > 0
    assert result.medians.build_s == np.median([row.build_s for row in result.rows])
    assert result.medians.time_to_image_s == np.median([row.time_to_image_s for row in result.rows])
    assert len(result.load_s) == len(result.first_compile_s) == 1
    assert (result.schema, result.triangles, result.rays) == ("clgrid.bench.frames/1", 320, 64)
    assert decode(encode(result), FramesRecord) == result


def test_one_update_a_frame_and_play_of_one_grid(device, save, monkeypatch):
    grids, seen = set(), []
    right = Grid.update

    def spy(grid: Grid, vertices: np.ndarray) -> None:
        grids.add(id(grid))
        seen.append(vertices.copy())
        right(grid, vertices)

    monkeypatch.setattr(Grid, "update", spy)
    bench_frames("icosphere:2", save(swelling()), SMALL, device)
    assert len(grids) == 1
    assert np.array_equal(seen[1:], np.concatenate([swelling()] * 2))


def test_a_camera_that_is_given_is_taken(device, save):
    away = replace(SMALL, view=lambda scene, aspect: Camera.look_at([50.0, 0, 0], [90.0, 0, 0]))
    rows = bench_frames("icosphere:2", save(swelling()), away, device).rows
    assert [row.hits for row in rows] == [0, 0, 0]


def test_the_camera_frames_what_triangles_reach_in_any_frame():
    lonely = Mesh(np.concatenate([BALL.vertices, np.float32([[50, 50, 50]])]), BALL.faces)
    frames = np.stack([lonely.vertices, lonely.vertices - np.float32(3)])
    low, high = bounds_of_all(frames, lonely)
    assert np.array_equal(low, BALL.bounds[0] - 3)
    assert np.array_equal(high, BALL.bounds[1])


def test_meshes_that_strain_move_too(device, save, tmp_path, monkeypatch):
    mesh = MESHES["torus"]
    monkeypatch.setattr(module, "load_timed", lambda name: (Scene(name, mesh), 0.0))
    frames = np.stack([mesh.vertices, np.zeros_like(mesh.vertices), mesh.vertices * np.float32(1e20)])
    rows = bench_frames("torus", save(frames), Work(64, 64, 1), device).rows
    assert rows[1].hits == 0
    assert rows[2].hits > 0


def test_a_mesh_without_triangles_is_an_input_error(device, save, tmp_path):
    (tmp_path / "empty.off").write_text("OFF\n0 0 0\n")
    with pytest.raises(InputError, match="no triangles"):
        bench_frames(str(tmp_path / "empty.off"), save(np.zeros((2, 0, 3), np.float32)), SMALL, device)


@pytest.mark.parametrize("name", ["horse", "elephant"])
def test_frame_0_of_the_shared_sequences_is_the_mesh_file(name):
    mesh = clgrid.load(scene(f"dynamic/{name}_gallop_frame0.ply"))
    frames = read_frames(scene(f"dynamic/{name}_gallop_frames.npy.gz"), mesh)
    assert np.array_equal(frames[0], mesh.vertices)
    assert len(frames) > 20


# Command line


@pytest.fixture
def run(capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)

    def call(*words: str):
        with pytest.raises(SystemExit) as exit_:
            main(words)
        streams = capsys.readouterr()
        return exit_.value.code, streams.out, streams.err

    return call


def test_the_table_has_a_line_a_frame_and_the_medians(run, device, save):
    save(swelling())
    code, out, err = run(
        "bench",
        "icosphere:2",
        "--frames",
        "f.npy",
        "--size",
        "16x16",
        "--reps",
        "2",
        "--device",
        device.label,
    )
    assert (code, err) == (0, "")
    for word in ("frame of icosphere:2", "time to image", "references", "median of all", "process memory"):
        assert word in out
    assert re.findall(r"^│(\w+)", out, re.M) == ["0", "1", "2", "median"], out


def test_json_is_one_strict_document(run, device, save):
    save(swelling(), "f.npy.gz")
    code, out, err = run(
        "bench", "icosphere:2", "--frames", "f.npy.gz", "--size", "8x8", "--reps", "1", "--json",
        "--device", device.label,
    )  # fmt: skip
    assert (code, err) == (0, "")
    found = decode(out, FramesRecord)
    assert (found.frames, len(found.rows)) == ("f.npy.gz", 3)


@pytest.mark.parametrize(
    "words",
    [
        ["cube", "--frames", "f.npy"],
        ["icosphere:2", "--frames", "missing.npy"],
        ["icosphere:2", "cube", "--frames", "f.npy"],
        ["icosphere:2", "--frames", "f.npy", "--seed", "3"],
        ["icosphere:2", "--frames", "f.npy", "--layout", "octree"],
        ["missing.ply", "--frames", "f.npy"],
    ],
)
def test_mistakes_end_in_one_line_and_exit_code_1(run, save, words):
    save(swelling())
    code, out, err = run("bench", *words)
    assert (code, out) == (1, "")
    assert re.fullmatch(r"clgrid: error: [^\n]+\n", err), err
