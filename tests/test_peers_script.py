"""scripts/peers: a run without peers, what all are given, agreement, peers that fail or are missing."""

from __future__ import annotations

import importlib
import json
import struct
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scenes import scene

import clgrid
from clgrid.device import Device
from clgrid.errors import InputError
from clgrid.mesh import Mesh

SCRIPTS = Path(__file__).resolve().parent.parent / "scripts"
QUICK = ("--size", "64x64", "--rounds", "1", "--reps", "1", "--rays", "2000")

# Stands for a peer in C++: answers as they do, with as many hits as it is told.
FAKE = """#!{python}
import json, sys
if "--variant" in sys.argv and sys.argv[sys.argv.index("--variant") + 1] == "low/none/8":
    sys.exit("no packets of eight here")
print("a word before")
print(json.dumps(dict(build_s=1.0, render_s=2.0, tti_s=3.0, shadow_s=0.5, nshadow={hits},
                      noccl={occluded}, nhit={hits}, bytes_per_tri=99.0)))
"""


@pytest.fixture
def module(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Import a module of scripts/, as the script itself does."""
    monkeypatch.syspath_prepend(str(SCRIPTS))

    def load(name: str) -> ModuleType:
        return importlib.import_module(name)

    return load


def peers(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(SCRIPTS / "peers"), "--out", str(folder / "out"), *QUICK]
    return subprocess.run([*command, *arguments], capture_output=True, text=True)


def fakes(folder: Path, hits: int, occluded: int) -> str:
    """Make a folder of peers in C++ whose Embree is FAKE."""
    program = folder / "cpp" / "build" / "embree3"
    program.parent.mkdir(parents=True)
    program.write_text(FAKE.format(python=sys.executable, hits=hits, occluded=occluded))
    program.chmod(0o755)
    return str(folder / "cpp")


def truth(module: Any, folder: Path, device: Device) -> tuple[int, int]:
    """Of the ball's picture that everybody draws: pixels that show it, and those that lie in shadow."""
    (folder / "shot").mkdir()
    shot = module("peers_scenes").prepare("icosphere:3", folder / "shot", 64, 100)
    mesh = Mesh(shot.vertices, shot.faces)
    image = clgrid.render(mesh, shot.view.camera(), 64, 64, device=device)
    t = clgrid.build(mesh, device=device).cast(*shot.camera_rays()).t_hit
    shadows = clgrid.brute_force(mesh, *shot.shadow_rays(t), t_max=1.0, device=device)
    return image.hits, int(np.count_nonzero(shadows.mask))


def test_a_run_without_peers(tmp_path: Path, device: Device, module: Any) -> None:
    done = peers(tmp_path, "icosphere:3", "nosuch.ply", "--peers", "none", "--device", device.label)
    assert done.returncode == 1, done.stderr
    assert "nosuch.ply" in done.stderr
    record = json.loads((tmp_path / "out" / "peers.json").read_text())
    good, bad = record["scenes"]
    assert (good["name"], good["triangles"], good["pixels"], bad["results"]) == (
        "icosphere:3",
        1280,
        4096,
        [],
    )
    assert bad["failure"]
    (mine,) = good["results"]
    assert mine["name"] == f"clgrid {device.label}"
    assert (mine["facts"]["hits"], mine["facts"]["occluded"]) == truth(module, tmp_path, device)
    assert mine["facts"]["occluded"] > 0
    assert set(mine["median_s"]) == {"build", "primary", "camera_cast", "random", "shadow", "time_to_image"}
    assert mine["median_s"]["time_to_image"] == pytest.approx(
        mine["median_s"]["build"] + mine["median_s"]["primary"]
    )
    assert str(tmp_path) not in (tmp_path / "out" / "peers.md").read_text()


def test_peers_in_cpp_that_agree_fail_and_are_missing(tmp_path: Path, device: Device, module: Any) -> None:
    hits, occluded = truth(module, tmp_path, device)
    cpp = fakes(tmp_path, hits + 1, occluded)
    done = peers(tmp_path, "icosphere:3", "--peers", "embree,grid", "--cpp", cpp, "--device", device.label)
    assert done.returncode == 0, done.stderr
    assert "left out: grid in C++: no build/grid" in done.stdout
    assert "- embree low/none/8: no packets of eight here (exit code 1)" in done.stdout
    (row,) = [line for line in done.stdout.splitlines() if line.startswith("| embree low/none/16 ")]
    assert "| 1000.0 |" in row
    assert "| 3000.0 | 1.00 |" in row
    assert "| +1 |" in row


def test_hits_that_differ_end_in_2(tmp_path: Path, device: Device, module: Any) -> None:
    hits, occluded = truth(module, tmp_path, device)
    cpp = fakes(tmp_path, hits + 5, occluded)
    done = peers(tmp_path, "icosphere:3", "--peers", "embree", "--cpp", cpp, "--device", device.label)
    assert done.returncode == 2, done.stderr
    assert "embree low/none/16: hits differ by 5, more than 4" in done.stderr


def test_all_are_given_the_same(tmp_path: Path, module: Any) -> None:
    scenes = module("peers_scenes")
    shot = scenes.prepare("terrain:8", tmp_path, 64, 1000)
    data = (tmp_path / "mesh.bin").read_bytes()
    assert data[:4] == b"MSH1"
    vertices, triangles = struct.unpack("<II", data[4:12])
    assert (vertices, triangles) == (81, 128)
    assert np.array_equal(np.frombuffer(data, "<f4", 243, 12).reshape(-1, 3), shot.vertices)
    assert np.array_equal(np.frombuffer(data, "<u4", 384, 12 + 972).reshape(-1, 3), shot.faces)
    numbers = [float(word) for word in (tmp_path / "mesh.cam").read_text().split()]
    assert numbers == [*shot.view.eye, *shot.view.target, *shot.view.up, shot.view.fov, *shot.view.light]
    assert [float(np.float32(number)) for number in numbers] == numbers
    again = scenes.Shot.load(tmp_path)
    assert again.view == shot.view
    for mine, theirs in zip(shot.random_rays(), again.random_rays(), strict=True):
        assert np.array_equal(mine, theirs)
    # The first numbers of splitmix64 from 12345, by Python's integers.
    assert scenes._uniform(2).tolist() == [0.1330796480178833, 0.20481657981872559]


def first_hits(module: Any, name: str, folder: Path, device: Device) -> tuple[Any, npt.NDArray[Any]]:
    """The scene as everybody gets it, and the triangle that each of 64 x 64 pixels shows, or -1."""
    shot = module("peers_scenes").prepare(name, folder, 64, 100)
    grid = clgrid.build(Mesh(shot.vertices, shot.faces), device=device)
    return shot, grid.cast(*shot.camera_rays(), fields=()).primitive_ids


def lit(shot: Any, device: Device) -> float:
    """Share of what the camera sees that the light reaches."""
    grid = clgrid.build(Mesh(shot.vertices, shot.faces), device=device)
    shadows = shot.shadow_rays(grid.cast(*shot.camera_rays(), fields=()).t_hit)
    return 1.0 - float(np.mean(grid.occluded(*shadows, t_max=1.0)))


@pytest.mark.parametrize(
    ("name", "least_bunny", "most_bunny"), [("stadium", 1e-4, 1e-3), ("stadium-bunny", 0.5, 0.6)]
)
def test_the_bunny_is_a_speck_in_the_stadium_or_fills_the_picture(
    name: str, least_bunny: float, most_bunny: float, tmp_path: Path, device: Device, module: Any
) -> None:
    scene("arch/bunny_in_stadium.ply")
    shot, ids = first_hits(module, name, tmp_path, device)
    # The stadium itself lies flat in z = 0.
    bunny = shot.vertices[shot.faces, 2].any(axis=1)
    assert 0.9 < np.mean(ids >= 0) < 1.0
    assert least_bunny < np.sum(bunny[ids[ids >= 0]]) / len(ids) < most_bunny
    assert lit(shot, device) > 0.9


@pytest.mark.parametrize(
    ("name", "file"),
    [("luxcore", "arch/luxcore_kitchen.glb"), ("openarena", "arch/openarena_ctf_inyard.glb")],
)
def test_rooms_are_seen_from_within_and_upright(
    name: str, file: str, tmp_path: Path, device: Device, module: Any
) -> None:
    scene(file)
    shot, ids = first_hits(module, name, tmp_path, device)
    low, high = shot.vertices.min(axis=0), shot.vertices.max(axis=0)
    for place in (shot.view.eye, shot.view.light):
        assert (low < place).all()
        assert (place < high).all()
    assert np.argmax(shot.view.up) == 2
    assert np.mean(ids >= 0) > 0.9
    # A view of much, not of a wall: many triangles, and light and shadow.
    assert len(np.unique(ids)) > 150
    assert 0.6 < lit(shot, device) < 0.95


def test_nature_has_as_many_triangles_as_are_asked_for(
    tmp_path: Path, device: Device, module: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    table = module("peers_scenes")
    monkeypatch.setattr(table, "cache_folder", lambda: tmp_path / "cache")
    # Without the folder of scenes the copies are spheres of 20,480 triangles.
    monkeypatch.setattr(table, "scenes_folder", lambda: None)
    assert table.present(["nature", "nature:200000"]) == (["nature", "nature:200000"], [])
    shot, ids = first_hits(module, "nature:200000", tmp_path, device)
    assert shot.name == "nature:200000"
    assert abs(shot.triangles - 200_000) <= 20_480 / 2
    # The terrain, which comes first, has its 5 % of them in any size, and what is seen is of both kinds.
    ground = shot.triangles % 20_480
    assert ground == pytest.approx(0.05 * 200_000, rel=0.05)
    assert 0.4 < np.mean(ids >= 0) < 1.0
    assert np.sum((ids >= 0) & (ids < ground)) > 100 < np.sum(ids >= ground)
    (kept,) = (tmp_path / "cache" / "figure1").iterdir()
    made = kept.stat().st_mtime_ns
    again, _ = first_hits(module, "nature:200000", tmp_path, device)
    assert np.array_equal(again.vertices, shot.vertices)
    assert kept.stat().st_mtime_ns == made


def test_nature_itself_is_that_of_figure_1_and_not_measured_unasked(module: Any) -> None:
    table, figure1 = module("peers_scenes"), module("figure1_scenes")
    whole = int(table.SCENES["nature"].source.removeprefix("nature:"))
    assert whole > 40_000_000
    for folder in (Path(), None):
        assert figure1.nature(whole, folder) == figure1.stand_in("Nature", folder)
    assert {*table.USUAL, "nature"} == set(table.SCENES)
    assert "nature" not in table.USUAL
    # Who keeps its tree to the end of the run is left out: together they need more memory than there is.
    most = module("peers_measure")._MOST_TRIANGLES
    assert all(most[name] < whole for name in module("peers_measure").MODULES)


@pytest.mark.parametrize("size", ["", "99999", "many", "-1", "1e6"])
def test_nature_of_no_sensible_size_is_refused(size: str, tmp_path: Path, module: Any) -> None:
    with pytest.raises(InputError, match=f"^nature:{size}: give a number of triangles, at least 100000$"):
        module("peers_scenes").prepare(f"nature:{size}", tmp_path, 64, 100)


def test_nature_without_its_scan_is_refused(
    tmp_path: Path, module: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module("peers_scenes"), "scenes_folder", lambda: tmp_path)
    with pytest.raises(InputError, match=r"dragon_vrip_res4.ply.gz is not in the scenes folder"):
        module("peers_scenes").prepare("nature:200000", tmp_path, 64, 100)


def test_arrays_are_compared_ray_by_ray(tmp_path: Path, module: Any) -> None:
    results = module("peers_results")
    scene = results.SceneResult("s", 10, 4096, 4096, longest_side=1.0)
    other = results.Result(results.PYTHON, "other")
    scene.results = [other]
    t, ids = np.ones(4096), np.zeros(4096, np.int64)
    np.savez(tmp_path / "true.npz", camera_t=t, camera_ids=ids, random_t=t, random_ids=ids)
    far, missed, tied = t.copy(), ids.copy(), ids.copy()
    far[:5] = 1.01
    missed[:3], tied[:7] = -1, 1
    np.savez(tmp_path / "mine.npz", camera_t=far, camera_ids=tied, random_t=t, random_ids=missed)
    scene.compare_arrays(other, tmp_path / "mine.npz", tmp_path / "true.npz")
    assert other.differs == {"camera_rays": 5, "camera_ids": 7, "random_rays": 3, "random_ids": 0}
    assert scene.disagreements() == ["s: other: camera rays differ by 5, more than 4"]


def test_a_child_that_dies_says_so_and_comes_back(module: Any) -> None:
    process = module("peers_process")
    with process.Child(["clgrid", "--device", "no such device"], 1, 60.0) as child:
        for _ in range(2):
            with pytest.raises(process.PeerError, match="no such device"):
                child.ask(do="facts")
        child._process.kill()
        child._process.wait()
        with pytest.raises(process.PeerError, match="no such device"):
            child.ask(do="facts")


def test_clean_repetitions_count(module: Any) -> None:
    clock = module("peers_clock")
    timings = clock.Timings()
    timings._all["work"] = [(1.0, 0.0), (3.0, 0.0), (9.0, 5.0)]
    assert (timings.clean("work"), timings.value("work")) == (2, 2.0)
    timings._all["busy"] = [(3.0, 1.0), (2.0, 1.0)]
    assert (timings.clean("busy"), timings.value("busy")) == (0, 2.0)


@pytest.mark.parametrize(
    "words",
    [
        ["--size", "60x60"],
        ["--size", "64x32"],
        ["--threads", "10000"],
        ["--peers", "octree"],
        ["--density", "many"],
        ["--device", "nosuch device"],
        ["--unknown"],
    ],
)
def test_mistakes_end_in_one_line(words: list[str], tmp_path: Path) -> None:
    failed = peers(tmp_path, "cube", "--peers", "none", *words)
    assert failed.returncode in (1, 3)
    assert failed.stderr.startswith("peers: ")
    assert len(failed.stderr.splitlines()) == 1
    assert not (tmp_path / "out").exists()
