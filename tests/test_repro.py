"""Files that replay a difference: written, read, refused, run again."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import planted
import pytest

from clgrid import locate, procedural, record
from clgrid.cli import main
from clgrid.device import Device
from clgrid.errors import InputError
from clgrid.locate import Finding, Side, meshes, read_repro, repro, write_repro
from clgrid.mesh import Mesh
from clgrid.repro_record import (
    NONE,
    AnswerRecord,
    Located,
    ReplayRecord,
    ReproRay,
    ReproRecord,
    SideRecord,
)

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    """The command line in this process: exit code, stdout, stderr."""

    def call(*words: str) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as exit_:
            main(words)
        streams = capsys.readouterr()
        assert isinstance(exit_.value.code, int)
        return exit_.value.code, streams.out, streams.err

    return call


@pytest.mark.thorough
def test_a_difference_is_written_small_and_replayed(
    device: Device, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "difference.json"
    finding = planted.missed(device.label)
    written = write_repro(path, finding)
    assert read_repro(path) == written
    assert written.located == finding.located
    assert not written.mesh.whole
    assert written.mesh.triangles == 80
    assert len(written.mesh.faces) < 40
    assert list(tmp_path.iterdir()) == [path]

    code, out, err = run("repro", str(path))
    assert (code, out) == (1, "")
    assert "brings kernel sources of its own (rays_in_out.h, shear.h, triangle_robust.h)" in err
    assert err.count("\n") == 1

    code, out, err = run("repro", str(path), "--trust", "--json")
    assert code == 2
    replayed = record.decode(out, ReplayRecord)
    assert (replayed.schema, replayed.outcome) == ("clgrid.repro.run/1", "same")
    # The scene's numbers of cells and triangles, though the file has few of them.
    assert replayed.found.difference == finding.located.difference
    assert replayed.found.where == finding.located.where
    assert [side.alone for side in replayed.found.sides] == [side.alone for side in finding.located.sides]

    monkeypatch.setattr(locate, "replay", lambda *words, **options: replayed)
    code, out, err = run("repro", str(path), "--trust")
    assert (code, err) == (2, "")
    text = " ".join(out.split())
    assert "the difference of the file" in text
    assert finding.located.difference is not None
    assert finding.located.difference.operation in text
    assert "second: a miss" in text
    assert "first decision" in text
    assert all(name in text for name in finding.located.difference.inputs)


def side(label: str, t: float) -> SideRecord:
    answer = AnswerRecord(3, t.hex(), "0x0.0p+0", "0x0.0p+0")
    return SideRecord(
        label=label,
        device=record.DeviceRecord("a processor", "1.0", "a platform"),
        build_options="",
        kernels={},
        compiled=(),
        traced=answer,
        alone=answer,
        together=answer,
        values=10,
        checked=5,
        off=0,
        off_as=(),
    )


def located(first: str, second: str, kind: str = "kernel") -> Located:
    return Located(
        kind=kind,
        where="somewhere",
        ray=ReproRay.of((0.1, 0.2, 0.3), (0, 0, 1)),
        grid=planted.GRID,
        sides=(side(first, 1.0), side(second, 2.0)),
        differing=0,
        difference=None,
        decision=None,
    )


def unlikely(device: str, mesh: Mesh = planted.MESH) -> Finding:
    """A difference that there is not."""
    return Finding(
        located(device, device), mesh, (Side(device), Side(device)), tuple(range(mesh.triangle_count))
    )


def test_no_difference_is_exit_code_0_and_a_missing_device_3(
    device: Device, tmp_path: Path, run: Run
) -> None:
    path = tmp_path / "difference.json"
    written = write_repro(path, unlikely(device.label))
    assert written.mesh.whole
    code, out, err = run("repro", str(path), "--devices", f"{device.label},{device.label}")
    assert (code, err) == (0, "")
    assert "no difference: the devices agree" in out
    code, out, err = run("repro", str(path), "--devices", f"{device.label},nowhere")
    assert (code, out) == (3, "")
    assert err.startswith("clgrid: error: no OpenCL device matches 'nowhere'")
    assert err.count("\n") == 1
    for words in ("intel", "a,b,c", "a,"):
        code, out, err = run("repro", str(path), "--devices", words)
        assert (code, out, err.count("\n")) == (1, "", 1)


def test_triangles_that_do_not_show_the_difference_bring_the_whole_mesh(
    device: Device, tmp_path: Path
) -> None:
    mesh = procedural.icosphere(3)
    finding = unlikely(device.label, mesh)
    finding = Finding(finding.located, mesh, finding.sides, (3, 5, 8))
    written = write_repro(tmp_path / "x.json", finding)
    assert (written.mesh.whole, written.mesh.faces, written.mesh.triangle_ids) == (True, [], [])
    again = meshes.mesh_of(read_repro(tmp_path / "x.json").mesh)
    assert again.vertices.dtype == np.float32
    np.testing.assert_array_equal(again.vertices, mesh.vertices)
    np.testing.assert_array_equal(again.faces, mesh.faces)


def test_devices_that_agree_leave_nothing_to_write(tmp_path: Path) -> None:
    finding = Finding(located("a", "b", NONE), planted.MESH, (Side("a"), Side("b")), ())
    with pytest.raises(InputError, match="agree"):
        write_repro(tmp_path / "x.json", finding)
    assert list(tmp_path.iterdir()) == []


def test_some_triangles_keep_frame_and_order() -> None:
    mesh = Mesh(procedural.icosphere(2).vertices.astype(np.float64) / 3 + 50, procedural.icosphere(2).faces)
    some = meshes.some_of(mesh, [7, 11, 300])
    assert some is not None
    assert some.triangle_ids == [7, 11, 300, 320, 320]
    small = meshes.mesh_of(some)
    np.testing.assert_array_equal(small.bounds, mesh.bounds)
    for own, of in enumerate((7, 11, 300)):
        np.testing.assert_array_equal(small.vertices[small.faces[own]], mesh.vertices[mesh.faces[of]])
    # The other two are points.
    assert (np.ptp(small.faces[3:], axis=1) == 0).all()
    assert meshes.some_of(planted.MESH, range(79)) is None


def replaced(written: ReproRecord, **of_mesh: Any) -> bytes:
    changed = msgspec.structs.replace(written, mesh=msgspec.structs.replace(written.mesh, **of_mesh))
    return record.encode(changed).encode()


def test_damaged_files_are_refused_in_one_line(tmp_path: Path, run: Run) -> None:
    path = tmp_path / "difference.json"
    written = ReproRecord(
        schema=repro.SCHEMA,
        clgrid="0",
        mesh=meshes.whole_of(planted.MESH),
        located=located("pocl", "intel"),
    )
    text = record.encode(written)
    assert len(written.mesh.faces) == 80
    ray = msgspec.structs.replace(written.located.ray, origin=("1", "2", "three"))
    wrong = msgspec.structs.replace(written, located=msgspec.structs.replace(written.located, ray=ray))
    damaged = {
        "no JSON": b"\x00\x01",
        "cut": text[: len(text) // 2].encode(),
        "a list": b"[]",
        "of another schema": text.replace("clgrid.repro/1", "clgrid.bench/1").encode(),
        "a field too many": text.replace('"whole"', '"else": 1, "whole"').encode(),
        "a field of another type": text.replace('"whole": true', '"whole": "yes"').encode(),
        "a number that is none": record.encode(wrong).encode(),
        "no triangles": replaced(written, faces=[]),
        "a vertex that is none": replaced(written, faces=[(0, 1, 99)]),
        "a negative vertex": replaced(written, faces=[(0, 1, -1)]),
        "another dtype": replaced(written, dtype="float16"),
        "arrays that are none": replaced(written, npz="AAAA"),
        "arrays in no base64": replaced(written, npz="!"),
        "ids of others": replaced(written, triangle_ids=[1, 2]),
        "a vertex nowhere": replaced(written, vertices=[("nan", "0", "0")] * len(written.mesh.vertices)),
    }
    for name, content in damaged.items():
        path.write_bytes(content)
        code, out, err = run("repro", str(path))
        assert (code, out, err.count("\n")) == (1, "", 1), name
        assert str(path) in err, name
        assert "unexpected" not in err, name
    code, out, err = run("repro", str(tmp_path / "missing.json"))
    assert (code, out, err.count("\n")) == (1, "", 1)
