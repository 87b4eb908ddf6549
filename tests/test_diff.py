"""``clgrid diff``: pictures compared group by group."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from clgrid import record
from clgrid.cli import main
from clgrid.difference_record import DiffRecord
from clgrid.errors import InputError
from clgrid.image import Image
from clgrid.picture_difference import compare_pictures

Run = Callable[..., tuple[int, str, str]]
H, W = 18, 24


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    """``clgrid diff`` in this process, in an empty folder: exit code, stdout, stderr."""
    monkeypatch.chdir(tmp_path)

    def call(*words: str) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as exit_:
            main(["diff", *words])
        streams = capsys.readouterr()
        return int(exit_.value.code or 0), streams.out, streams.err

    return call


def picture() -> Image:
    rgba = np.zeros((H, W, 4), np.float32)
    rgba[..., :3] = np.linspace(0.1, 0.9, W)[:, None]
    rgba[..., 3] = 1
    depth = np.full((H, W), 3.0, np.float32)
    depth[0] = np.inf
    ids = np.arange(H * W, dtype=np.uint32).reshape(H, W)
    return Image(rgba, depth=depth, primitive_id=ids, geometry_id=np.zeros((H, W), np.uint32))


def saved(image: Image, name: str) -> str:
    image.save(name)
    return name


def test_the_same_picture(run: Run) -> None:
    a, b = saved(picture(), "a.exr"), saved(picture(), "b.exr")
    code, out, err = run(a, b)
    assert (code, err) == (0, "")
    assert out.count(f"0 of {H * W}") == 3
    assert "FLIP 0" in out
    code, out, _ = run(a, b, "--json")
    found = record.decode(out, DiffRecord)
    assert (code, found.schema, found.within, found.missing) == (0, "clgrid.diff/1", True, ())
    assert [each.group for each in found.groups] == ["rgba", "depth", "id"]
    assert all(each.psnr is None and each.largest == 0 for each in found.groups)
    assert run(a, b, "--quiet") == (0, "", "")


def test_what_is_beyond_the_tolerance_is_exit_code_2(run: Run) -> None:
    other = picture()
    other.rgba[2, 3, 1] += 0.125
    a, b = saved(picture(), "a.exr"), saved(other, "b.exr")
    assert run(a, b, "-q")[0] == 2
    assert run(a, b, "-q", "--tolerance", "0.12")[0] == 2
    assert run(a, b, "-q", "--tolerance", "0.13")[0] == 0
    assert run(a, b, "-q", "--groups", "depth,id")[0] == 0
    found = compare_pictures(a, b)
    rgba = found.groups[0]
    assert (rgba.differing, rgba.beyond) == (1, 1)
    assert rgba.largest == pytest.approx(0.125)
    assert rgba.psnr == pytest.approx(10 * np.log10(4 * H * W / 0.125**2), abs=1e-3)
    assert found.flip is not None
    assert found.flip > 0
    # Colours may be judged by what is seen of the difference.
    assert run(a, b, "-q", "--max-flip", str(found.flip * 1.01))[0] == 0
    assert run(a, b, "-q", "--max-flip", str(found.flip * 0.99))[0] == 2
    assert run(a, b, "-q", "--tolerance", "1", "--max-flip", str(found.flip * 0.99))[0] == 2


def test_ids_know_no_tolerance_and_infinite_depths_are_alike(run: Run) -> None:
    other = picture()
    assert other.primitive_id is not None
    assert other.depth is not None
    other.primitive_id[4, 4] += 1
    a, b = saved(picture(), "a.exr"), saved(other, "b.exr")
    assert run(a, b, "-q", "--tolerance", "9")[0] == 2
    other.primitive_id[4, 4] -= 1
    other.depth[0, 0] = 3
    b = saved(other, "b.exr")
    code, out, _ = run(a, b, "--tolerance", "9")
    assert (code, "infinite" in out) == (2, True)
    (depth,) = (each for each in compare_pictures(a, b).groups if each.group == "depth")
    assert (depth.differing, depth.beyond, depth.largest, depth.psnr) == (1, 1, None, None)


def test_a_group_that_one_lacks_is_a_difference(run: Run) -> None:
    a, b = saved(picture(), "a.exr"), saved(replace(picture(), depth=None), "b.exr")
    code, out, _ = run(a, b)
    assert (code, "only one of them has the group depth" in out) == (2, True)
    assert run(a, b, "-q", "--groups", "rgba,id")[0] == 0


def test_8_bits_beside_an_exr_are_decoded(run: Run) -> None:
    a, b = saved(picture(), "a.exr"), saved(picture(), "b.png")
    # Half a step of 8 bits is at most 0.0045 of linear light; undecoded it would be 0.2.
    assert run(a, b, "-q", "--groups", "rgba")[0] == 2
    assert run(a, b, "-q", "--groups", "rgba", "--tolerance", "0.005")[0] == 0
    saved(picture(), "c.png")
    assert run("b.png", "c.png", "-q")[0] == 0


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("a.exr", "small.exr"), "give pictures of the same pixels"),
        (("a.exr", "gone.exr"), "gone.exr: cannot be read"),
        (("a.exr", "a.exr", "--groups", "colour"), "unknown group 'colour'"),
        (("a.exr", "a.exr", "--groups", "normal"), "neither picture has the group 'normal'"),
        (("a.exr", "a.exr", "--tolerance", "-1"), "--tolerance"),
        (("a.exr",), "Missing argument"),
    ],
)
def test_wrong_words_are_one_line(run: Run, words: tuple[str, ...], said: str) -> None:
    saved(picture(), "a.exr")
    saved(Image(np.zeros((4, 4, 4), np.float32)), "small.exr")
    code, out, err = run(*words)
    assert (code, out) == (1, "")
    assert said in err
    assert err.count("\n") == 1


def test_numbers_below_0_are_refused() -> None:
    with pytest.raises(InputError, match="none below 0"):
        compare_pictures("a", "b", tolerance=float("nan"))
