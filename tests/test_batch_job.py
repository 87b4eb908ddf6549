"""Job files and what they ask for: all that is wrong is said before any work, with file, line and key."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from clgrid.batch import plan as planning
from clgrid.batch.frame_numbers import parse_frames
from clgrid.batch.item import Item
from clgrid.batch.job import parse_job
from clgrid.batch.keys import Hashes
from clgrid.batch.plan import parse_shard, plan
from clgrid.batch.toml_lines import keys_by_line, line_of
from clgrid.errors import InputError

JOB = """
scenes = ["cube", "icosphere:2"]
cameras = ["default", { name = "near", eye = [2, 0, 0] }]
output = "out/{scene}.{camera}.png"
size = [8, 6]
"""


def items(text: str, base: Path) -> list[Item]:
    return plan(parse_job(text, "job.toml"), base).items


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("size = [1,\n  'x']\n" + JOB.replace("size = [8, 6]", ""), r"job.toml:1: size\[1\]: expected int"),
        (JOB + "siez = 3\n", r"job.toml:6: siez: there is no such key"),
        (
            JOB + "# a\n[[item]]\nscene = 'a'\n\n[[item]]\nsamples = 1.5\n",
            r"toml:11: item\[1\].samples: expected",
        ),
        (JOB.replace("eye", "eyes"), r"job.toml:3: cameras\[1\].eyes: there is no such key"),
        ("scenes = ['cube']", r"job.toml: the key output is missing"),
        ("scenes = [\n'cube'", r"job.toml: not TOML: .*line|at end"),
        ("a = 1\na = 2\n", r"not TOML: .*line 2"),
    ],
)
def test_a_wrong_file_is_refused_with_line_and_key(text, said):
    with pytest.raises(InputError, match=said):
        parse_job(text, "job.toml")


def test_lines_of_keys_are_found_behind_what_looks_like_keys():
    text = 'a = """\nb = 1\n[c]\n"""\nb = [ # [\n  "x = 1",\n  "]",\n]\n'
    text += "[c]\nd.e = 2\n[[f]]\ng = 1\n[[f]]\ng = 2\n"
    assert keys_by_line(text) == {
        "a": 1, "b": 5, "c": 9, "c.d.e": 10, "f[0]": 11, "f[0].g": 12, "f[1]": 13, "f[1].g": 14,
    }  # fmt: skip
    assert line_of(text, "f[1].g[3].h") == 14
    assert line_of(text, "nowhere") == 0


@pytest.mark.parametrize(
    ("given", "numbers"),
    [
        ("1..3", [1, 2, 3]),
        ("0..10..5", [0, 5, 10]),
        (" 4 , 1..2", [4, 1, 2]),
        (7, [7]),
        ([3, 1], [3, 1]),
        ("all", None),
    ],
)
def test_frames_are_numbers_and_ranges(given, numbers):
    assert parse_frames(given) == numbers


@pytest.mark.parametrize(
    "given", ["", "3..1", "a", "1..2..0", "-1", [], [-1], "1,1", "1..9999999999", "0..99999999"]
)
def test_other_frames_are_refused(given):
    with pytest.raises(InputError, match="frame"):
        parse_frames(given)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ('output = "out/{scene}.png"', "written twice.*cube default.*cube near"),
        ('output = "out/{scene}.{camera}.{frame:04d}.png"', "no frames are asked for"),
        ('output = "out/{scene}.{camera}.{light}.png"', r"no field \{light\}"),
        ('output = "out/{scene:04d}.{camera}.png"', "scene:04d"),
        ('output = "out/{scene.png"', "output"),
        ('output = "out/{scene}.{camera}.tif"', "unknown picture format"),
        ('output = []', "names no picture"),
        ('scenes = ["no.ply"]', "no file .*no.ply"),
        ('scenes = ["*.ply"]', "no file fits"),
        ('scenes = []', "names none"),
        ('cameras = ["no.json"]', "no file .*no.json"),
        ('aovs = ["deepth"]', "unknown AOV 'deepth'"),
        ('layout = "compakt"', "layout is 'compakt'"),
        ('compression = "lzw"', "compression 'lzw'"),
        ('size = [0, 4]', "size 0x4"),
        ('crop = [0, 0, 9, 6]', "crop"),
        ('time_limit = 0', "time_limit"),
        ('retries = -1', "retries"),
        ('frames = "all"', "nothing moves any of the 2 scenes"),
        ('frames = "all"\nanimation = "walk"\nvertices = "."', "animation: vertices move"),
        ('frames = "all"\nfps = 0', "fps 0"),
        ('fps = 30', "fps: without frames"),
        ('scenes = ["."]', "no mesh file there"),
        ('vertices = "a.npy"', "without frames"),
        ('[[item]]\nframes = "x"', "item frames"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused_before_any_work(tmp_path, change, said):
    key = change.split(" ")[0]
    text = "\n".join(line for line in JOB.splitlines() if not line.startswith(f"{key} ")) + f"\n{change}\n"
    with pytest.raises(InputError, match=said):
        items(text, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_items_are_scenes_times_frames_times_cameras(tmp_path):
    np.save(tmp_path / "v.npy", np.zeros((5, 8, 3), np.float32))
    text = (
        JOB.replace("{camera}.png", "{camera}.{frame:03d}.{item}.png")
        + 'frames = "1..2"\nvertices = "v.npy"\n'
    )
    found = items(text, tmp_path)
    assert [(item.scene, item.frame, item.camera_name) for item in found] == [
        (scene, frame, camera)
        for scene in ("cube", "icosphere:2")
        for frame in (1, 2)
        for camera in ("default", "near")
    ]
    assert found[5].outputs == (str(tmp_path / "out/icosphere_2.near.001.5.png"),)
    with pytest.raises(InputError, match=r"no frame 5, .*v.npy has 0..4"):
        items(text.replace("1..2", "1..5"), tmp_path)
    assert len(items(text.replace("1..2", "all"), tmp_path)) == 20


def test_exceptions_change_the_items_that_they_fit_and_the_last_wins(tmp_path):
    text = (
        JOB
        + '[[item]]\nscene = "ico*"\nsamples = 4\nsize = [3, 3]\n[[item]]\ncamera = "near"\nsize = [9, 9]\n'
    )
    assert [(each.settings.size, each.settings.samples) for each in items(text, tmp_path)] == [
        ((8, 6), None), ((9, 9), None), ((3, 3), 4), ((9, 9), 4),
    ]  # fmt: skip


@pytest.mark.parametrize("count", [1, 3, 4, 7])
def test_shards_are_disjoint_and_together_the_whole(tmp_path, count):
    whole = items(JOB, tmp_path)
    shards = [parse_shard(f"{k}/{count}").of(whole) for k in range(1, count + 1)]
    assert sorted(item.number for shard in shards for item in shard) == [item.number for item in whole]
    assert max(map(len, shards)) - min(map(len, shards)) <= 1


@pytest.mark.parametrize("text", ["0/3", "4/3", "1", "a/b", "1/0", "-1/3", "1/3/5"])
def test_other_shards_are_refused(text):
    with pytest.raises(InputError, match="--shard"):
        parse_shard(text)


def test_files_are_found_by_patterns_in_the_order_of_their_names(tmp_path):
    for name in ("b.ply", "a.ply", "c.obj"):
        (tmp_path / name).write_text("")
    found = planning.find_scenes(["*.ply", "a.ply", "cube"], tmp_path)
    assert found == [str(tmp_path / "a.ply"), str(tmp_path / "b.ply"), "cube"]


def test_the_key_follows_what_pixels_depend_on_and_nothing_else(tmp_path):
    (tmp_path / "a.obj").write_text("mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "a.mtl").write_text("newmtl m\nmap_Kd -s 1 1 t.png\n")
    base = 'scenes = ["a.obj"]\noutput = "a.png"\nsize = [8, 6]\n'

    def key(text: str = base) -> str:
        return Hashes().with_key(items(text, tmp_path)[0]).key

    first = key()
    assert key() == first
    same = ("time_limit = 3", "retries = 2", 'device = "0"', "max_memory = 5", 'cameras = ["default"]')
    assert {key(f"{base}{line}\n") for line in same} == {first}
    assert key(base.replace("a.png", "b.png")) == first
    other = ("seed = 1", "half = true", 'aovs = ["id"]', 'layout = "hashed"', "cameras = [{ fov = 30 }]")
    keys = [key(f"{base}{line}\n") for line in other]
    (tmp_path / "t.png").write_text("texture")
    keys.append(key())
    (tmp_path / "a.mtl").write_text("newmtl n\n")
    keys.append(key())
    (tmp_path / "a.obj").write_text("v 0 0 0\n")
    keys.append(key())
    assert len({first, *keys}) == len(keys) + 1
    fast = base + 'accuracy = "fast"\n'
    assert key(fast) != key(fast + 'device = "0"\n')
