"""How pictures are written: the same bytes, what may be lossy, windows, tiles, what metadata tell."""

from __future__ import annotations

import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_image import picture

from clgrid.camera import Camera
from clgrid.errors import InputError
from clgrid.image import read_image
from clgrid.imagefile import COMPRESSIONS, partial_of, target_of

LOSSY = ("pxr24", "b44", "b44a", "dwaa", "dwab")


def parts(path: Path) -> dict[str, oiio.ImageSpec]:
    source = oiio.ImageInput.open(str(path))
    found = {}
    while source.seek_subimage(len(found), 0):
        spec = source.spec()
        found[spec.getattribute("oiio:subimagename") or "rgba"] = spec.copy()
    source.close()
    return found


@pytest.mark.parametrize("name", ["a.exr", "a.png", "a.jpg"])
def test_the_same_picture_gives_the_same_bytes_a_second_later(tmp_path, name):
    image = picture(40, 30)
    image.save(tmp_path / name, timings=False)
    first = (tmp_path / name).read_bytes()
    time.sleep(1.1)  # dates have seconds
    image.metadata["clgrid:render_s"] = 0.5
    image.save(tmp_path / name, timings=False)
    assert (tmp_path / name).read_bytes() == first
    image.save(tmp_path / name)
    assert (tmp_path / name).read_bytes() != first


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_depths_normals_and_ids_are_exact_in_every_compression(tmp_path, compression):
    image = picture(48, 33)
    image.save(tmp_path / "a.exr", compression=compression, half=True)
    back = read_image(tmp_path / "a.exr")
    for name in ("depth", "normal", "primitive_id", "geometry_id", "steps"):
        before, after = getattr(image, name), getattr(back, name)
        assert (before.view(np.uint32) == after.view(np.uint32)).all(), name
    halved = image.rgba.astype(np.float16).astype(np.float32)
    if compression not in LOSSY:
        assert (back.rgba == halved).all()
    found = parts(tmp_path / "a.exr")
    assert found["rgba"].getattribute("compression") == compression
    assert str(found["rgba"].format) == "half"
    assert str(found["depth"].format) == "float"
    assert found["depth"].getattribute("compression") == ("zip" if compression in LOSSY else compression)


def test_tiles_and_windows_are_those_of_every_part(tmp_path):
    image = picture(48, 33)
    image.crop, image.full_size = (5, 7), (200, 100)
    image.save(tmp_path / "a.exr", tile=16)
    for spec in parts(tmp_path / "a.exr").values():
        assert (spec.tile_width, spec.tile_height) == (16, 16)
        assert (spec.x, spec.y, spec.width, spec.height) == (5, 7, 33, 48)
        assert (spec.full_x, spec.full_y, spec.full_width, spec.full_height) == (0, 0, 200, 100)
    back = read_image(tmp_path / "a.exr")
    assert (back.rgba == image.rgba).all()
    assert (back.crop, back.full_size) == (image.crop, image.full_size)
    # A window may well be the whole.
    image.crop, image.full_size = (0, 0), (33, 48)
    image.save(tmp_path / "b.exr")
    assert read_image(tmp_path / "b.exr").full_size is None


def test_the_quality_of_a_jpeg_is_that_asked_for(tmp_path):
    image = picture(64, 64)
    sizes = []
    for quality in (10, 50, 95):
        image.save(tmp_path / "a.jpg", quality=quality)
        sizes.append((tmp_path / "a.jpg").stat().st_size)
    assert sizes == sorted(set(sizes))
    assert "clgrid:triangles: 7" in read_image(tmp_path / "a.jpg").metadata["ImageDescription"]


@pytest.mark.parametrize(
    "wrong", [{"compression": "lzw"}, {"tile": 20}, {"tile": -16}, {"quality": 0}, {"quality": 101}]
)
def test_wrong_options_are_refused_before_a_file_is_touched(tmp_path, wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        picture().save(tmp_path / "a.exr", **wrong)
    assert list(tmp_path.iterdir()) == []


def test_a_partial_file_tells_its_target():
    for name in ("a.exr", "a.b.0001.png", "ä b.jpg"):
        assert target_of(partial_of(Path("x") / name)) == Path("x") / name
    for name in ("a.exr", ".a.exr", ".a.partial.exr", ".a.12.partial.exr", "a.1-00000000.partial.exr"):
        assert target_of(Path(name)) is None


number = st.floats(-100, 100, allow_nan=False)


@given(
    eye=st.tuples(number, number, number),
    fov=st.floats(5, 150),
    size=st.tuples(st.integers(1, 900), st.integers(1, 900)),
    axis=st.sampled_from(["y", "x", "smaller"]),
    height=st.none() | st.floats(0.1, 50),
    t=st.floats(0.01, 1e3),
)
def test_world_to_ndc_takes_points_of_rays_to_their_pixels(eye, fov, size, axis, height, t):
    width, rows = size
    seen = Camera.look_at(eye, np.add(eye, (1.0, 2.0, -2.0)), fov=fov, orthographic_height=height)
    camera = Camera(seen.eye, seen.right, seen.up, seen.forward, fov, axis, "", height)
    origins, directions = camera.rays(width, rows)
    for i, j in {(0, 0), (rows - 1, width - 1), (rows // 2, 0)}:
        point = np.append(origins[i, j] + t * directions[i, j], 1.0)
        x, y, _, w = camera.world_to_ndc(width, rows) @ point
        np.testing.assert_allclose(
            [x / w, y / w], [(j + 0.5) / width, (i + 0.5) / rows], atol=1e-6 * (1 + 1e3 / t)
        )


def test_oiiotool_tells_parts_channels_and_metadata(tmp_path):
    tool = Path(sys.executable).with_name("oiiotool")
    found = str(tool) if tool.is_file() else shutil.which("oiiotool")
    if found is None:
        pytest.skip("oiiotool is not installed")
    image = picture(40, 30)
    image.metadata |= {"worldToCamera": np.eye(4), "clgrid:device": "a device", "clgrid:build_s": 0.25}
    image.save(tmp_path / "a.exr")
    told = subprocess.run(
        [found, "--info", "-v", "-a", str(tmp_path / "a.exr")], capture_output=True, text=True, check=True
    ).stdout
    for line in (
        "30 x   40, 4 channel, float openexr",
        "channel list: N.X, N.Y, N.Z",
        "2 channel, uint openexr",
        "channel list: geometry_id, primitive_id",
        "worldToCamera: 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1",
        'clgrid:device: "a device"',
        "clgrid:build_s: 0.25",
    ):
        assert line in told, told
