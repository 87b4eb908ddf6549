"""Devices compared: the same bits, whatever the threads; processes that end badly; planted differences."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import compare_faults
import msgspec
import planted
import pytest

from clgrid import record
from clgrid.cli import main
from clgrid.compare import Plan, broken_promises, compare, process, unfinished
from clgrid.compare import run as compare_run
from clgrid.compare.locating import Replays
from clgrid.compare.messages import Order
from clgrid.compare.plan import Part
from clgrid.compare.process import Command, Rows
from clgrid.compare_record import (
    COMPLETED,
    CRASHED,
    HUNG,
    OUT_OF_MEMORY,
    REFUSED,
    CompareDevice,
    CompareRecord,
)
from clgrid.device import Device, choose
from clgrid.errors import DeviceError, InputError
from clgrid.locate import Side, replay
from clgrid.program import own_source_folder

Ran = tuple[CompareDevice, Rows]

SMALL = Plan(accuracies=("robust",), width=24, height=16, rays=300, repetitions=1, density=4.0)
KINDS = ["primary", "shadow", "incoherent", "structured"]


@pytest.fixture(autouse=True)
def _children_import_faults(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parent))


def test_all_devices_and_one_thread_of_each_give_the_same_bits(all_devices: list[Device]) -> None:
    labels = [device.label for device in all_devices]
    selectors = [*labels, *(f"{label}/1" for label in labels)]
    found = compare(["icosphere:3"], selectors, SMALL)
    assert [(each.label, each.status) for each in found.devices] == [(x, COMPLETED) for x in selectors]
    assert [each.units for each in found.devices[len(labels) :]] == [1] * len(labels)
    assert len(found.pairs) == len(selectors) * (len(selectors) - 1) // 2
    for pair in found.pairs:
        assert pair.promised
        assert (pair.equal, pair.grids, pair.ray, pair.heat_map) == (True, True, None, None)
        assert [(each.kind, each.differing) for each in pair.rays] == [(kind, 0) for kind in KINDS]
        assert (pair.image.differing, pair.image.psnr, pair.image.perceptual) == (0, None, 0.0)
    assert broken_promises(found) == unfinished(found) == []
    for device in found.devices:
        assert_whole(device)
    # Rays have somewhere to differ.
    kinds = {kind.kind: kind for kind in found.devices[0].rows[0].kinds}
    assert kinds["primary"].rays == 24 * 16 > kinds["primary"].hits > 50
    assert kinds["structured"].hits > 50
    assert record.decode(record.encode(found), CompareRecord) == found


def assert_whole(device: CompareDevice) -> None:
    assert [each.type for each in device.arithmetic] == ["float", "float8", "double", "double4"]
    for each in device.arithmetic:
        # What the strict rungs stand on.
        assert each.contracted_when_forbidden == "never"
        assert (each.wrong_quotients, each.fma) == (0, "always")
    assert device.driver is not None
    assert device.driver.fp64
    assert device.speed is not None
    assert device.speed.copied_bytes > 0
    for taken in (device.speed.launch_s, device.speed.copy_s, device.speed.upload_s, device.speed.download_s):
        assert len(taken) == SMALL.repetitions
        assert min(taken) > 0
    (row,) = device.rows
    assert len(row.build_s) == len(row.render_s) == len(row.kinds[0].cast_s) == SMALL.repetitions
    assert {"upload", "count", "scan"} <= set(row.build_stages_s)
    assert set(row.grid_digests) == set(row.nbytes)
    assert row.self_test == ""


@pytest.mark.host
@pytest.mark.parametrize(
    ("fault", "status", "reason"),
    [
        ("abort", CRASHED, "was ended by SIGABRT"),
        ("hang", HUNG, "took longer than the limit of 10 s"),
        ("memory", OUT_OF_MEMORY, "Unable to allocate"),
    ],
)
def test_a_process_that_ends_badly_is_a_result_and_the_other_completes(
    device: Device, monkeypatch: pytest.MonkeyPatch, fault: str, status: str, reason: str
) -> None:
    part = f"{device.label}/1"

    def short(own: Part, order: Order, limit: float, told: Callable[[str], None], command: Command) -> Ran:
        """As ever, but for the process that hangs."""
        return process.run(own, order, 10.0 if (fault, own.label) == ("hang", part) else limit, told, command)

    monkeypatch.setattr(compare_run, "run", short)
    # The faulty one first: what it leaves undone the other does.
    found = compare(["cube"], [part, device.label], SMALL, command=compare_faults.faulty(part, fault))
    bad, good = found.devices
    assert (bad.status, good.status) == (status, COMPLETED)
    assert reason in bad.reason
    assert (bad.step, bad.rows) == ("load cube", [])
    assert len(good.rows) == 1
    assert found.pairs == []
    if fault == "abort":
        assert bad.last_words == "LLVM ERROR: Cannot select: planted"
    (line,) = unfinished(found)
    assert line.startswith(f"{part}: {status} at 'load cube': ")


@pytest.mark.host
def test_a_device_that_does_not_compile_is_refused_and_the_other_completes(
    device: Device, tmp_path: Path
) -> None:
    part = f"{device.label}/1"
    kernels = folder_of(tmp_path, {"count_references.cl": "this is no kernel"})
    found = compare(["cube"], [device.label, part], SMALL, command=compare_faults.altered(part, kernels))
    good, bad = found.devices
    assert (good.status, bad.status) == (COMPLETED, REFUSED)
    assert "count_references.cl does not compile" in bad.reason
    assert [failure.accuracy for failure in bad.failures] == ["robust"]
    assert len(unfinished(found)) == 1


def folder_of(tmp_path: Path, kernels: dict[str, str]) -> Path:
    """Clgrid's kernels, some of them replaced."""
    folder = tmp_path / "cl"
    folder.mkdir()
    for path in own_source_folder().iterdir():
        (folder / path.name).write_text(kernels.get(path.name) or path.read_text(encoding="utf-8"))
    return folder


@pytest.mark.slow
@pytest.mark.host
def test_a_planted_difference_is_counted_located_and_replayed(device: Device, tmp_path: Path) -> None:
    part = f"{device.label}/1"
    kernels = folder_of(tmp_path, planted.contracted())
    plan = Plan(**{**vars(SMALL), "rays": 2000})

    def side(label: str) -> Side:
        return Side(label, kernels=planted.contracted()) if label == part else Side(label)

    found = compare(
        ["icosphere:2"],
        [device.label, part],
        plan,
        replays=Replays(tmp_path, side),
        command=compare_faults.altered(part, kernels),
    )
    (pair,) = found.pairs
    assert [each.status for each in found.devices] == [COMPLETED, COMPLETED]
    # The self-test, which other verbs refuse the device for, is told of.
    assert "self-test" in found.devices[1].rows[0].self_test
    arithmetic = [each.contracted_when_forbidden for each in found.devices[1].arithmetic]
    assert arithmetic == ["always"] * 4
    assert (pair.promised, pair.equal) == (True, False)
    differing = {each.kind: each.differing for each in pair.rays}
    assert differing["structured"] > 100
    assert pair.ray is not None
    assert planted.CONTRACTION in pair.ray.where
    assert replay(pair.ray.replay, trust=True).outcome == "same"
    (line,) = broken_promises(found)
    assert line.startswith(f"icosphere:2: robust: {device.label} and {part} differ: ")
    assert line.endswith(f"clgrid repro {pair.ray.replay}")
    # A rung that promises nothing breaks no promise.
    loose = msgspec.structs.replace(pair, accuracy="fast", promised=False)
    assert broken_promises(msgspec.structs.replace(found, pairs=[loose])) == []


@pytest.mark.host
def test_a_part_of_a_device_is_a_device(device: Device) -> None:
    part = choose(f"{device.label}/1")
    assert (part.label, part.description.compute_units) == (f"{device.label}/1", 1)
    assert part is choose(f"{device.label}/1") is not device
    assert part.cl_device.max_compute_units == 1
    for wrong in (0, device.description.compute_units + 1):
        with pytest.raises(DeviceError, match=f"has {device.description.compute_units} compute units"):
            choose(f"{device.label}/{wrong}")


@pytest.mark.host
def test_what_cannot_be_compared_is_refused(device: Device) -> None:
    with pytest.raises(InputError, match="alone is nothing to compare"):
        compare(["cube"], [device.label, device.label], SMALL)
    with pytest.raises(DeviceError, match="matches"):
        compare(["cube"], [device.label, "no such device"], SMALL)
    for wrong in ({"accuracies": ("best",)}, {"accuracies": ()}, {"rays": 0}, {"time_limit": 0.0}):
        with pytest.raises(InputError, match="compare: "):
            Plan(**wrong)  # type: ignore[arg-type]


Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    """The command line in this process, in an empty folder: exit code, stdout, stderr."""
    monkeypatch.chdir(tmp_path)

    def call(*words: str) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as exit_:
            main(["compare", *words])
        streams = capsys.readouterr()
        return int(exit_.value.code or 0), streams.out, streams.err

    return call


@pytest.mark.host
def test_the_command_line(device: Device, run: Run, tmp_path: Path) -> None:
    two = ("--devices", f"{device.label},{device.label}/1", "--accuracy", "robust", "--reps", "1")
    small = ("--size", "16x16", "--rays", "64", "--density", "4")
    code, out, err = run("cube", "gone.ply", *two, *small, "--json")
    told = record.decode(out, CompareRecord)
    assert (code, [each.scene for each in told.failures]) == (1, ["gone.ply"])
    assert err.count("\n") == 1
    assert "gone.ply" in err
    assert json.loads(out)["schema"] == "clgrid.compare/1"
    code, out, err = run("cube", *two, *small)
    assert (code, err) == (0, "")
    for words in ("structured", "what differs", "robust", "same"):
        assert words in out
    if device.description.compute_units > 1:
        # Drivers that count the cores a process is kept to need no sub-device.
        assert re.search(rf"1 of {device.description.compute_units} by (affinity|fission)", out)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.host
@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        ((), 1, "alone is nothing to compare"),
        (("--accuracy", "best"), 1, "accuracy is 'best'"),
        (("--time-limit", "0"), 1, "time limit above 0"),
        (("--repro", "gone"), 1, "no such folder"),
        (("--devices", ","), 1, "no device is named"),
        (("--devices", "nobody"), 3, "no OpenCL device matches 'nobody'"),
    ],
)
def test_wrong_words_are_one_line(
    device: Device, run: Run, words: tuple[str, ...], code: int, said: str
) -> None:
    chosen = () if "--devices" in words else ("--devices", device.label)
    found, out, err = run("cube", *chosen, *words)
    assert (found, out) == (code, "")
    assert said in err
    assert err.count("\n") == 1
