from __future__ import annotations

import json
import os
import pty
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import clgrid
from clgrid import image as image_module
from clgrid.cli import main, options, output
from clgrid.errors import InputError
from clgrid.image import read_image
from clgrid.info_record import InfoRecord
from clgrid.record import BenchRecord, RenderRecord, decode

ROOT = Path(__file__).parent.parent
HEAVY = ("numpy", "pyopencl", "trimesh", "OpenImageIO", "msgspec", "clgrid.device")


@dataclass
class Result:
    code: int
    out: str
    err: str


@pytest.fixture
def run(capsys, monkeypatch, tmp_path):
    """Run the command line in this process, in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def call(*words: str) -> Result:
        with pytest.raises(SystemExit) as exit_:
            main(words)
        streams = capsys.readouterr()
        return Result(exit_.value.code, streams.out, streams.err)

    return call


def start(*words: str, **streams: object) -> subprocess.Popen[bytes]:
    path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    return subprocess.Popen(
        [sys.executable, "-m", "clgrid", *words], env={**os.environ, "PYTHONPATH": path}, **streams
    )


def assert_one_line_error(result: Result, code: int = 1) -> None:
    assert result.code == code
    assert result.out == ""
    assert re.fullmatch(r"clgrid: error: [^\n]+\n", result.err), result.err


def test_help_is_light():
    script = (
        "import sys\nfrom clgrid.cli import main\n"
        "try:\n    main(['render', '--help'])\nexcept SystemExit:\n    pass\n"
        f"print([name for name in {HEAVY!r} if name in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert done.stderr.strip() == "[]"
    assert "--look-at" in done.stdout


def test_help_and_version(run):
    everything = run()
    assert everything.code == 0
    for verb in ("render", "bench", "info", "report", "devices", "doctor"):
        assert verb in everything.out
        assert run(verb, "--help").code == 0
    assert run("--version").out == f"clgrid {clgrid.__version__}\n"


def test_render_writes_pictures_and_a_summary(run, device):
    done = run(
        "render", "cube", "-o", "a.exr", "--output", "a.png", "--aov", "depth,id",
        "--size", "64x48", "--device", device.label,
    )  # fmt: skip
    assert (done.code, done.err) == (0, "")
    for word in (
        "load",
        "first compile",
        "build",
        "render",
        "time to image",
        "Mtri/s",
        "Mrays/s",
        "bytes per",
    ):
        assert word in done.out
    assert "a.exr" in done.out
    assert "a.png" in done.out
    image = read_image("a.exr")
    assert (image.width, image.height) == (64, 48)
    assert image.depth is not None
    assert image.primitive_id is not None
    assert image.normal is None
    assert {"clgrid:build_s", "clgrid:load_s", "clgrid:time_to_image_s", "clgrid:driver"} <= set(
        image.metadata
    )
    assert sorted(path.name for path in Path().iterdir()) == ["a.exr", "a.png"]


def test_render_json_is_one_strict_document(run, device):
    done = run("render", "cube", "-o", "a.png", "--size", "32x32", "--json", "--device", device.label)
    found = decode(done.out, RenderRecord)
    assert (done.code, done.err) == (0, "")
    assert (found.row.scene, found.row.rays, found.outputs) == ("cube", 1024, ("a.png",))
    assert found.device.driver == device.driver_version


def test_quiet_says_nothing(run, device):
    done = run("render", "cube", "-o", "a.png", "--size", "8x8", "-q", "--device", device.label)
    assert (done.code, done.out, done.err) == (0, "", "")


def test_camera_and_grid_options_arrive(run, device):
    done = run(
        "render", "cube", "-o", "a.exr", "--size", "20x10", "--aov", "depth", "--eye=-7,0,0",
        "--look-at", "0,0,0", "--up=-z", "--fov", "30", "--resolution", "2x3x4",
        "--background", "#ff0000", "--json",
        "--device", device.label,
    )  # fmt: skip
    assert decode(done.out, RenderRecord).row.resolution == (2, 3, 4)
    image = read_image("a.exr")
    assert image.metadata["clgrid:camera_eye"] == "-7.0 0.0 0.0"
    assert image.metadata["clgrid:camera_up"] == "0.0 0.0 -1.0"
    assert image.metadata["clgrid:camera_fov"] == 30
    assert image.depth.min() == 6
    assert image.rgba[0, 0].tolist() == [1, 0, 0, 0]


def test_eye_alone_looks_at_the_middle(run, device):
    done = run("render", "cube", "-o", "a.exr", "--size", "8x8", "--eye", "0,0,9", "--device", device.label)
    assert done.code == 0
    assert read_image("a.exr").metadata["clgrid:camera_forward"] == "0.0 0.0 -1.0"


def test_camera_file_and_its_fov(run, device):
    Path("c.json").write_text('{"eye": [0, 0, 5], "look_at": [0, 0, 0], "fov": 30}')
    common = (
        "render",
        "cube",
        "-o",
        "a.exr",
        "--size",
        "8x8",
        "--camera",
        "c.json",
        "--device",
        device.label,
    )
    assert run(*common).code == 0
    assert read_image("a.exr").metadata["clgrid:camera_fov"] == 30
    assert run(*common, "--fov", "50").code == 0
    assert read_image("a.exr").metadata["clgrid:camera_fov"] == 50
    assert_one_line_error(run(*common, "--eye", "1,2,3"))


def test_an_empty_mesh_is_an_empty_picture_with_a_warning(run, device):
    Path("empty.off").write_text("OFF\n0 0 0\n")
    done = run("render", "empty.off", "-o", "a.exr", "--size", "8x8", "--aov", "id", "--device", device.label)
    assert done.code == 0
    assert re.fullmatch(r"clgrid: warning: .*empty\.off.*\n", done.err)
    assert (read_image("a.exr").rgba[..., 3] == 0).all()


@pytest.mark.parametrize(
    "words",
    [
        ["frobnicate"],
        ["render"],
        ["render", "cube"],
        ["render", "cube", "-o", "a.png", "--frobnicate"],
        ["render", "nosuch.ply", "-o", "a.png"],
        ["render", "icosphere:99", "-o", "a.png"],
        ["render", "cube", "-o", "a.gif"],
        ["render", "cube", "-o", "no/such/a.png"],
        ["render", "cube", "-o", "a.png", "--aov", "depth"],
        ["render", "cube", "-o", "a.exr", "--aov", "uvw"],
        ["render", "cube", "-o", "a.png", "--size", "0x5"],
        ["render", "cube", "-o", "a.png", "--size", "99999x99999"],
        ["render", "cube", "-o", "a.png", "--density", "x"],
        ["render", "cube", "-o", "a.png", "--density", "-1"],
        ["render", "cube", "-o", "a.png", "--resolution", "3x3"],
        ["render", "cube", "-o", "a.png", "--layout", "octree"],
        ["render", "cube", "-o", "a.png", "--accuracy", "perfect"],
        ["render", "cube", "-o", "a.png", "--max-memory", "lots"],
        ["render", "cube", "-o", "a.png", "--max-memory", "10"],
        ["render", "cube", "-o", "a.png", "--camera", "0"],
        ["render", "cube", "-o", "a.png", "--eye", "1,2"],
        ["render", "cube", "-o", "a.png", "--eye", "0,0,0"],
        ["render", "cube", "-o", "a.png", "--fov", "180"],
        ["render", "cube", "-o", "a.png", "--background", "puce"],
        ["bench", "cube", "--reps", "0"],
        ["info", "nosuch.ply"],
    ],
)
def test_mistakes_end_in_one_line_and_exit_code_1(run, words):
    assert_one_line_error(run(*words))
    assert list(Path().iterdir()) == []


def test_an_unknown_device_is_exit_code_3(run):
    assert_one_line_error(run("render", "cube", "-o", "a.png", "--device", "abacus"), code=3)


def test_debug_shows_the_traceback_wherever_it_stands(run):
    with pytest.raises(InputError):
        main(["info", "icosphere:99", "--debug"])
    with pytest.raises(InputError):
        main(["--debug", "info", "icosphere:99"])


def test_what_nobody_foresaw_is_one_line_too(run, monkeypatch):
    def broken(*_: object) -> None:
        raise RuntimeError("two\nlines")

    monkeypatch.setattr(output, "emit_pairs", broken)
    result = run("info", "cube")
    assert_one_line_error(result)
    assert "RuntimeError: two lines; --debug shows where" in result.err


def test_ctrl_c_is_exit_code_130_and_leaves_no_half_file(run, device, monkeypatch):
    write = image_module.write_parts

    def interrupted(path: Path, *rest: object) -> None:
        write(path, *rest)
        assert len(list(Path().iterdir())) == 1
        raise KeyboardInterrupt

    monkeypatch.setattr(image_module, "write_parts", interrupted)
    done = run("render", "cube", "-o", "a.exr", "--size", "8x8", "--device", device.label)
    assert done.code == 130
    assert "Traceback" not in done.err
    assert list(Path().iterdir()) == []


def test_a_reader_that_leaves_ends_the_program_quietly():
    process = start("info", "cube", stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stderr is not None
    process.stdout.close()
    assert process.stderr.read() == b""
    assert process.wait() == 141


def test_progress_shows_on_a_terminal_and_only_there(tmp_path, device):
    try:
        terminal, stderr = pty.openpty()
    except OSError as error:
        pytest.skip(f"no terminal can be made here ({error}): /dev/pts is not mounted")
    process = start(
        "render", "icosphere:6", "-o", str(tmp_path / "a.png"), "--json", "--device", device.label,
        stdout=subprocess.PIPE, stderr=stderr,
    )  # fmt: skip
    os.close(stderr)
    seen = b""
    while True:
        try:
            part = os.read(terminal, 4096)
        except OSError:  # how Linux says that the other end closed
            break
        if not part:
            break
        seen += part
    out = process.stdout.read() if process.stdout else b""
    assert process.wait() == 0
    assert decode(out, RenderRecord).row.triangles == 20 * 4**6
    assert b"render" in seen
    assert b"build" in seen or b"compile" in seen


def test_bench_prints_a_table(run, device):
    done = run("bench", "cube", "icosphere:2", "--reps", "2", "--size", "16x16", "--device", device.label)
    assert (done.code, done.err) == (0, "")
    for word in ("icosphere:2", "Mtri/s", "time to image", "medians of 2"):
        assert word in done.out


def test_bench_goes_on_after_a_bad_scene_and_exits_1(run, device):
    words = "bench nosuch.ply cube --reps 1 --size 8x8 --json --html b.html --csv b.csv --device"
    done = run(*words.split(), device.label)
    assert done.code == 1
    found = decode(done.out, BenchRecord)
    assert found.command == ("clgrid", *sys.argv[1:])
    assert found.host is not None
    assert found.host.cores > 0
    assert "nosuch.ply" in Path("b.html").read_text()
    assert Path("b.csv").read_text().count("\n") == 2
    assert [row.scene for row in found.rows] == ["cube"]
    assert found.failures[0].scene == "nosuch.ply"
    assert re.fullmatch(r"clgrid: error: .*nosuch\.ply.*\n", done.err)


def test_info_in_words_and_in_json(run):
    words = run("info", "icosphere:3")
    assert "1,280" in words.out
    assert "exact" in words.out
    found = decode(run("info", "icosphere:3", "--json").out, InfoRecord)
    assert found.triangles == 1280
    assert found.resolution is not None
    assert int(np.prod(found.resolution)) == found.cells


def test_devices_json_is_one_document(run):
    done = run("devices", "--json")
    assert done.code == 0
    assert json.loads(done.out)["devices"]


@pytest.mark.parametrize(
    ("text", "expected"),
    [("", None), ("12", 12), ("500M", 500_000_000), ("2GiB", 2**31), ("1.5 kB", 1500), ("3ki", 3072)],
)
def test_bytes_are_read_with_units(text, expected):
    assert options.parse_bytes(text) == expected


@pytest.mark.parametrize("text", ["x", "-1", "1T", "1.5.2G", "i", "GiB"])
def test_other_bytes_are_input_errors(text):
    with pytest.raises(InputError, match="--max-memory"):
        options.parse_bytes(text)


def test_colours():
    assert options.parse_colour("0.25") == (0.25, 0.25, 0.25)
    assert options.parse_colour("1,0,0.5") == (1, 0, 0.5)
    assert options.parse_colour("#00ff80") == pytest.approx((0, 1, 0.2158605))
