"""Batches end with every picture that can be, a record of every one that cannot, and nothing half done."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from scenes import shared_file
from test_hostile_load import ERROR, EXPECTED

from clgrid.batch import ledger, spawn
from clgrid.batch.item import ItemRecord
from clgrid.batch.job import parse_job
from clgrid.batch.keys import KEY
from clgrid.batch.ledger import Ledger, read_records
from clgrid.batch.plan import Plan, Shard, plan
from clgrid.batch.run import Choices, Outcome, run
from clgrid.batch.sheet import write_sheet
from clgrid.cli.batch_progress import Quiet
from clgrid.device import Device
from clgrid.errors import ClgridError, InputError
from clgrid.image import read_image
from clgrid.imagefile import partial_of
from clgrid.renderer import render
from clgrid.scene import load_scene

pytestmark = pytest.mark.host

ROOT = Path(__file__).resolve().parent.parent
CAMERAS = 'cameras = ["default", { name = "near", eye = [2, 1, 2], look_at = [0, 0, 0] }]\n'
BASIC = 'scenes = ["cube", "icosphere:2"]\noutput = "out/{scene}.{camera}.exr"\nsize = [24, 16]\n' + CAMERAS


@pytest.fixture(autouse=True)
def _of_this_checkout(monkeypatch: pytest.MonkeyPatch) -> None:
    """Child processes import what the tests do."""
    path = [str(ROOT), str(ROOT / "tests"), os.environ.get("PYTHONPATH", "")]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(path))


def planned(folder: Path, text: str) -> Plan:
    return plan(parse_job(text, "job.toml"), folder)


def go(folder: Path, text: str, device: Device, **choices: object) -> Outcome:
    return run(planned(folder, text), Choices(device=device.label, **choices), Quiet())  # type: ignore[arg-type]


def files(folder: Path) -> dict[str, bytes]:
    """Pictures by name; any other file than them and the records is a fault."""
    found = {path.name: path.read_bytes() for path in folder.iterdir() if not path.name.endswith(".tries")}
    return {name: content for name, content in found.items() if not name.endswith(".jsonl")}


def test_pictures_are_those_of_render_and_records_tell_all(tmp_path, device):
    outcome = go(tmp_path, BASIC + 'aovs = ["depth"]\n', device)
    assert outcome.complete
    assert read_records(tmp_path / "out/run.jsonl") == outcome.records
    alone = render(load_scene("cube"), None, 24, 16, ("depth",), device=device)
    drawn = read_image(tmp_path / "out/cube.default.exr")
    assert (drawn.rgba == alone.rgba).all()
    assert np.array_equal(drawn.depth, alone.depth)
    record = next(each for each in outcome.records if each.item == 0)
    assert drawn.metadata[KEY] == record.key
    assert json.loads(drawn.metadata["clgrid:options"])["size"] == [24, 16]
    assert drawn.metadata["clgrid:device"] == record.device.name == device.name
    assert "worldToNDC" in drawn.metadata
    assert record.outputs[0].bytes == (tmp_path / "out/cube.default.exr").stat().st_size
    assert record.hits == alone.hits
    assert record.triangles == 12
    # Four pictures, two grids: each of them serves both cameras.
    assert sum(each.load_s[0] > 0 for each in outcome.records) == 2
    write_sheet(tmp_path / "sheet.html", outcome)
    sheet = (tmp_path / "sheet.html").read_text()
    assert sheet.count("data:image/jpeg;base64,") == 4
    assert "http" not in sheet


def test_a_second_run_gives_the_same_bytes_and_skips_only_what_is_whole(tmp_path, device):
    go(tmp_path, BASIC, device)
    out = tmp_path / "out"
    before = files(out)
    (out / "cube.default.exr").write_bytes(before["cube.default.exr"][:-100])
    (out / "cube.near.exr").unlink()
    # Of the same name and whole, but of other options.
    go(tmp_path, BASIC + "background = [0, 0, 0]\n", device, shard=Shard(3, 4))
    assert files(out)["icosphere_2.near.exr"] != before["icosphere_2.near.exr"]
    partial_of(out / "cube.near.exr").write_bytes(b"half a pict")
    bystander = out / ".another.1-00000000.partial.exr"
    bystander.write_bytes(b"of another job")
    outcome = go(tmp_path, BASIC, device, skip_existing=True)
    assert sorted((each.item, each.status) for each in outcome.records) == [
        (0, "done"), (1, "done"), (2, "skipped"), (3, "done"),
    ]  # fmt: skip
    bystander.unlink()
    assert files(out) == before


def test_frames_are_those_of_a_grid_built_anew_in_any_order_and_shard(tmp_path, device):
    mesh = load_scene("icosphere:2").mesh
    sizes = np.linspace(1, 2, 5, dtype=np.float32)[:, None, None]
    np.save(tmp_path / "v.npy", mesh.vertices[None] * sizes)
    text = (
        'scenes = ["icosphere:2"]\nvertices = "v.npy"\nframes = "all"\nsize = [24, 16]\n'
        'aovs = ["id", "steps"]\n'
        'output = "{camera}.{frame}.exr"\ndensity = 4.0\n'
    )
    outcome = go(tmp_path, text, device)
    assert outcome.complete
    whole = {path.name: path.read_bytes() for path in tmp_path.glob("*.exr")}
    for name in whole:
        (tmp_path / name).unlink()
    for index in (1, 0):
        assert go(tmp_path, text, device, shard=Shard(index, 2)).complete
    assert {path.name: path.read_bytes() for path in tmp_path.glob("*.exr")} == whole
    assert len(set(whole.values())) == 5
    assert sorted(path.name for path in tmp_path.glob("*.jsonl")) == [
        "run.1-of-2.jsonl", "run.2-of-2.jsonl", "run.jsonl",
    ]  # fmt: skip


def test_a_crash_a_hang_and_a_failure_cost_their_items_alone(tmp_path, device, monkeypatch):
    monkeypatch.setattr(spawn, "MODULE", "unruly_worker")
    names = ("fine", "crash", "noise", "crash-once", "hang", "fail-once", "last")
    views = ", ".join(f'{{ name = "{name}", eye = [{3 + k}, 1, 2] }}' for k, name in enumerate(names))
    text = (
        f'scenes = ["cube"]\ncameras = [{views}]\noutput = "out/{{camera}}.png"\nsize = [8, 8]\nretries = 1\n'
        'time_limit = 30\n[[item]]\ncamera = "hang"\ntime_limit = 1.0\nretries = 0\n'
        '[[item]]\ncamera = "crash"\nretries = 0\n'
    )
    outcome = go(tmp_path, text, device)
    found = {each.camera: each for each in outcome.records}
    assert {name for name, each in found.items() if each.status == "done"} == set(names) - {"crash", "hang"}
    assert len(found) == len(outcome.records) == len(names)
    assert "SIGABRT: the driver gives up; tried 1x" in found["crash"].error
    assert "longer than the limit of 1 s; tried 1x" in found["hang"].error
    tried = {name: found[name].attempts for name in names}
    assert tried == {name: 2 if "-once" in name else 1 for name in names}
    assert set(files(tmp_path / "out")) == {f"{name}.png" for name in names if name not in ("crash", "hang")}


def test_the_first_failure_ends_the_run_if_asked(tmp_path, device):
    (tmp_path / "bad.ply").write_text("no mesh")
    text = BASIC.replace('"cube"', '"bad.ply", "cube"')
    outcome = go(tmp_path, text, device, keep_going=False)
    assert not outcome.complete
    assert outcome.count("failed") >= 1
    assert len(outcome.records) < outcome.asked
    assert "bad.ply" in outcome.records[0].error


def test_a_full_disk_is_a_failure_of_the_item_and_leaves_no_half_file(tmp_path, device):
    """The limit on the size of files stands for the disk: small pictures fit, the large one does not."""
    (tmp_path / "job.toml").write_text(
        BASIC.replace("icosphere:2", "terrain:64") + 'compression = "none"\nretries = 0\n'
        '[[item]]\nscene = "terrain:64"\nsize = [640, 640]\n'
    )
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (3 << 20, 3 << 20)); "
    code = limit + "from clgrid.cli import main; main()"
    words = [
        sys.executable,
        "-c",
        code,
        "batch",
        str(tmp_path / "job.toml"),
        "--device",
        device.label,
        "--json",
    ]
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == 4, done.stderr
    records = json.loads(done.stdout)["items"]
    failed = [each["error"] for each in records if each["status"] == "failed"]
    assert len(failed) == 2
    assert all("cannot be written" in error and str(tmp_path) in error for error in failed), failed
    assert set(files(tmp_path / "out")) == {"cube.default.exr", "cube.near.exr"}


# Signals and kills, of the command as a user has it


def start(folder: Path, device: Device, *words: str) -> subprocess.Popen[bytes]:
    command = [
        sys.executable,
        "-m",
        "clgrid",
        "batch",
        str(folder / "job.toml"),
        "--device",
        device.label,
        *words,
    ]
    return subprocess.Popen(command, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)


def many(folder: Path, size: str = "[160, 120]") -> Path:
    """A job that takes a second or two."""
    folder.mkdir(exist_ok=True)
    names = ", ".join(f'"terrain:{k}"' for k in range(8, 18))
    text = f'scenes = [{names}]\nsize = {size}\noutput = ["out/{{scene}}.{{camera}}.exr"]\naovs = ["depth"]\n'
    (folder / "job.toml").write_text(text + CAMERAS)
    return folder


def wait_for(folder: Path, count: int) -> None:
    """Until so many pictures are there."""
    for _ in range(6000):
        if len(list(folder.glob("out/*.exr"))) >= count:
            return
        time.sleep(0.01)
    raise AssertionError(f"{count} pictures did not come")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_after_what_is_begun(tmp_path, device, number):
    batch = start(many(tmp_path), device)
    wait_for(tmp_path, 3)
    batch.send_signal(number)
    assert batch.wait(60) == 128 + number
    there = files(tmp_path / "out")
    assert all(name.endswith(".exr") and not name.startswith(".") for name in there)
    records = read_records(tmp_path / "out/run.jsonl")
    assert {Path(each.outputs[0].path).name for each in records} == set(there)
    assert all(each.status == "done" for each in records)


def test_a_second_signal_ends_it_at_once_without_half_files(tmp_path, device):
    batch = start(many(tmp_path, "[1500, 1500]"), device)
    wait_for(tmp_path, 1)
    batch.send_signal(signal.SIGINT)
    batch.send_signal(signal.SIGTERM)
    assert batch.wait(60) in (128 + signal.SIGINT, 128 + signal.SIGTERM)
    assert not [name for name in files(tmp_path / "out") if name.startswith(".")]


def test_kill_9_loses_what_was_under_way_and_the_next_run_gives_the_same_bytes(tmp_path, device):
    calm = many(tmp_path / "calm")
    assert start(calm, device).wait(300) == 0
    wanted = files(calm / "out")
    assert len(wanted) == 20
    chance = random.Random(9)
    folder = many(tmp_path / "killed")
    for kill in range(5):
        for name in files(folder / "out") if kill else ():
            (folder / "out" / name).unlink()
        batch = start(folder, device)
        wait_for(folder, chance.randrange(1, 16))
        batch.kill()
        batch.wait()
        there = files(folder / "out")
        whole = {name: content for name, content in there.items() if not name.startswith(".")}
        assert all(wanted[name] == content for name, content in whole.items())
        assert start(folder, device, "--skip-existing").wait(300) == 0
        assert files(folder / "out") == wanted


# Two hundred items, twenty of them hostile


def test_two_hundred_items_of_which_twenty_are_hostile(tmp_path, device):
    hostile = [name for name, outcomes in EXPECTED.items() if outcomes == (ERROR,)][:20]
    names = [str(shared_file("hostile", name)) for name in hostile]
    # Of one size, so that a mesh too many shows.
    mesh = load_scene("terrain:32").mesh
    text = "".join(f"v {x} {y} {z}\n" for x, y, z in mesh.vertices.tolist())
    text += "".join(f"f {a} {b} {c}\n" for a, b, c in (mesh.faces + 1).tolist())
    good = [f"{k:03d}.obj" for k in range(180)]
    for name in good:
        (tmp_path / name).write_text(text)
    mixed = [name for k in range(20) for name in (*good[9 * k : 9 * k + 9], names[k])]
    (tmp_path / "job.toml").write_text(
        f'scenes = {json.dumps(mixed)}\nsize = [32, 24]\noutput = "out/{{item}}.png"\n'
    )
    command = [sys.executable, "-m", "clgrid", "batch", str(tmp_path / "job.toml"), "--device", device.label]
    done = subprocess.run([*command, "--json"], capture_output=True, text=True)
    assert done.returncode == 4
    assert "Traceback" not in done.stderr
    summary = json.loads(done.stdout)
    assert (summary["done"], summary["failed"], summary["missing"]) == (180, 20, 0)
    assert len(files(tmp_path / "out")) == 180
    failed = [each for each in summary["items"] if each["status"] == "failed"]
    assert {each["scene"] for each in failed} == set(names)
    assert all(Path(each["scene"]).name in each["error"] for each in failed)
    # The most that the process ever held grows no more once it has drawn some.
    peaks = {each["item"]: each["peak_bytes"] for each in summary["items"] if each["status"] == "done"}
    early = max(peak for item, peak in peaks.items() if item <= 20)
    assert peaks[max(peaks)] < early + (4 << 20)


# Records


def record(item: int) -> ItemRecord:
    return ItemRecord(clgrid="0", item=item, scene="s", camera="c", frame=None, status="done", key="k")


def test_a_torn_line_is_cut_off_and_the_others_stay(tmp_path):
    book = Ledger(tmp_path / "run.jsonl")
    for number in range(3):
        book.append(record(number))
    book.close()
    whole = (tmp_path / "run.jsonl").read_bytes()
    for torn in (whole[:-1], whole[:-30], whole + b"x" * 200_000, b"x" * 70_000):
        (tmp_path / "run.jsonl").write_bytes(torn)
        kept = torn.count(b"\n")
        assert [each.item for each in read_records(tmp_path / "run.jsonl")] == list(range(kept))
        book = Ledger(tmp_path / "run.jsonl")
        assert book.torn
        book.append(record(7))
        book.close()
        assert [each.item for each in read_records(tmp_path / "run.jsonl")] == [*range(kept), 7]


def test_two_runs_of_one_job_at_once_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(ledger, "_PATIENCE_SECONDS", 0.1)
    book = Ledger(tmp_path / "run.jsonl")
    with pytest.raises(InputError, match="another run"):
        Ledger(tmp_path / "run.jsonl")
    book.close()
    Ledger(tmp_path / "run.jsonl").close()


def test_a_record_that_does_not_fit_on_the_disk_is_taken_back(tmp_path, monkeypatch):
    book = Ledger(tmp_path / "run.jsonl")
    book.append(record(0))
    before = (tmp_path / "run.jsonl").read_bytes()
    real = os.write
    monkeypatch.setattr(os, "write", lambda file, data: real(file, data[:10]))
    with pytest.raises(ClgridError, match="disk full"):
        book.append(record(1))
    monkeypatch.undo()
    assert (tmp_path / "run.jsonl").read_bytes() == before
    book.close()
