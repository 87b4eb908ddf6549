from __future__ import annotations

import pytest

from clgrid import bench as module
from clgrid.bench import Work, bench, bench_scene, rate
from clgrid.errors import DeviceError, InputError
from clgrid.record import BenchRecord, decode, encode

SMALL = Work(width=32, height=16, repetitions=3)


def test_a_row_holds_every_repetition_and_the_grids_numbers(device):
    row = bench_scene("icosphere:2", SMALL, device)
    assert (row.scene, row.triangles, row.device) == ("icosphere:2", 320, device.label)
    assert len(row.build_s) == len(row.render_s) == len(row.time_to_image_s) == 3
    assert [b + r for b, r in zip(row.build_s, row.render_s, strict=True)] == row.time_to_image_s
    assert len(row.load_s) == len(row.first_compile_s) == 1
    assert {"upload", "count", "insert"} <= set(row.build_stages_s)
    for k in range(3):
        assert 0 < sum(times[k] for times in row.build_stages_s.values()) <= row.build_s[k]
    cells = row.resolution[0] * row.resolution[1] * row.resolution[2]
    assert row.grid_bytes == 4 * (cells + 1) + 4 * row.references
    assert row.density == cells / 320
    assert (row.rays, 0 < row.hits < row.rays) == (512, True)


def test_density_and_resolution_reach_the_grid(device):
    assert bench_scene("cube", Work(8, 8, 1, resolution=(2, 3, 5)), device).resolution == (2, 3, 5)
    sparse = bench_scene("icosphere:3", Work(8, 8, 1, density=0.5), device)
    dense = bench_scene("icosphere:3", Work(8, 8, 1, density=8.0), device)
    assert dense.grid_bytes > 2 * sparse.grid_bytes


def test_one_bad_scene_does_not_stop_the_others(device, tmp_path):
    (tmp_path / "bad.ply").write_text("ply\nformat ascii 1.0\n")
    seen: list[str] = []
    names = ["cube", str(tmp_path / "bad.ply"), "icosphere:1"]
    result = bench(names, SMALL, device, seen.append)
    assert [row.scene for row in result.rows] == ["cube", "icosphere:1"]
    assert [failure.scene for failure in result.failures] == [names[1]]
    assert "bad.ply" in result.failures[0].error
    assert seen == names
    assert decode(encode(result), BenchRecord) == result


def test_what_nobody_foresaw_is_the_scenes_failure(device, monkeypatch):
    def broken(*_: object) -> None:
        raise RuntimeError("out of resources")

    monkeypatch.setattr(module, "bench_scene", broken)
    assert bench(["cube"], SMALL, device).failures[0].error == "RuntimeError: out of resources"


def test_a_device_that_cannot_work_stops_everything(device, monkeypatch):
    def broken(*_: object) -> None:
        raise DeviceError("gone")

    monkeypatch.setattr(module, "bench_scene", broken)
    with pytest.raises(DeviceError):
        bench(["cube", "cube"], SMALL, device)


def test_empty_scenes_have_a_row(device, tmp_path):
    (tmp_path / "empty.off").write_text("OFF\n0 0 0\n")
    row = bench_scene(str(tmp_path / "empty.off"), SMALL, device)
    assert (row.triangles, row.hits, row.grid_bytes, row.bytes_per_triangle) == (0, 0, 0, 0)
    assert row.warnings


def test_no_repetition_is_an_input_error():
    with pytest.raises(InputError, match="repetitions"):
        Work(8, 8, 0)


def test_rates_use_the_median():
    assert rate(3_000_000, [9.0, 1.0, 2.0]) == 1.5
    assert rate(3, []) == 0
