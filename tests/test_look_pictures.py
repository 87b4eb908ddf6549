from __future__ import annotations

import numpy as np
import OpenImageIO as oiio  # noqa: N813
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pictures import CORNERS, bomb, png

from clgrid.colour import linear, srgb
from clgrid.lookfile.names import find_beside
from clgrid.lookfile.pictures import (
    MAX_PIXELS,
    Allowance,
    PictureError,
    read_picture,
    unpack_picture,
)

pytestmark = pytest.mark.host


def rgba(pixels, alpha=255):
    return np.concatenate([pixels, np.full((*pixels.shape[:2], 1), alpha, np.uint8)], axis=2)


def unpacked(data):
    return unpack_picture(data, Allowance())


def test_every_kind_of_png_becomes_rgba_with_row_0_on_top():
    grey = CORNERS[..., :1]
    assert np.array_equal(unpacked(png(CORNERS)), rgba(CORNERS))
    assert np.array_equal(unpacked(png(grey)), rgba(np.repeat(grey, 3, 2)))
    assert np.array_equal(unpacked(png(CORNERS.astype(np.uint16) * 257)), rgba(CORNERS))
    both = np.concatenate([grey, grey], axis=2)
    assert np.array_equal(unpacked(png(both)), np.repeat(grey, 4, 2))


def test_colours_are_kept_under_an_alpha_of_zero():
    pixels = rgba(CORNERS, 0)
    pixels[0, 0, 3] = 128
    assert np.array_equal(unpacked(png(pixels)), pixels)


def test_palettes_are_looked_up():
    palette = np.array([[10, 20, 30, 255], [200, 100, 50, 7]], np.uint8)
    rows = np.array([[[0], [1]], [[1], [0]]], np.uint8)
    assert np.array_equal(unpacked(png(rows, palette)), palette[rows[..., 0]])
    assert np.array_equal(unpacked(png(rows, palette[:, :3])), rgba(palette[rows[..., 0]][..., :3]))


def test_jpeg_and_float_pictures(tmp_path):
    flat = np.full((16, 16, 3), (200, 100, 50), np.uint8)
    oiio.ImageBuf(flat).write(str(tmp_path / "a.jpg"))
    read = unpacked((tmp_path / "a.jpg").read_bytes())
    assert read.shape == (16, 16, 4)
    assert np.abs(read.astype(int) - [200, 100, 50, 255]).max() <= 3
    # half of the light is 188 of 255 in sRGB
    oiio.ImageBuf(np.full((4, 4, 3), 0.5, np.float32)).write(str(tmp_path / "a.exr"))
    assert np.array_equal(
        read_picture(tmp_path / "a.exr", Allowance()), np.full((4, 4, 4), (188, 188, 188, 255))
    )


@pytest.mark.parametrize(
    "data",
    [b"", b"no picture", png(CORNERS)[:50], b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff\xe0", b"RIFF\0\0\0\0WEBP"],
)
def test_what_is_no_picture_is_said(data):
    with pytest.raises(PictureError):
        unpacked(data)


def test_pictures_too_large_are_refused_by_their_header():
    side = int(MAX_PIXELS**0.5)
    with pytest.raises(PictureError, match="make it smaller"):
        unpacked(bomb(side + 1, side))
    # OpenImageIO has a limit of its own, for files as small as this
    with pytest.raises(PictureError, match=r"60000|header"):
        unpacked(bomb(60_000, 60_000))
    allowance = Allowance(7)
    unpack_picture(png(CORNERS), allowance)
    with pytest.raises(PictureError, match="all textures"):
        unpack_picture(png(CORNERS), allowance)


def test_missing_pictures_and_folders(tmp_path):
    for name in ("nosuch.png", "."):
        with pytest.raises(PictureError, match="missing"):
            read_picture(tmp_path / name, Allowance())


@given(st.integers(0, 255))
def test_srgb_and_linear_are_inverse(byte):
    value = np.array([byte / 255])
    assert np.rint(srgb(linear(value)) * 255)[0] == byte


def test_names_of_other_systems_are_found(tmp_path):
    (tmp_path / "Textures").mkdir()
    for name in ("Textures/Wood 1.PNG", "a.png", "B.png", "b.PNG"):
        (tmp_path / name).write_bytes(b"x")
    wood = tmp_path / "Textures" / "Wood 1.PNG"
    for name in (
        "Textures/Wood 1.PNG",
        "textures\\wood 1.png",
        "WOOD 1.png",
        "C:\\work\\old\\wood 1.png",
        "/home/x/Wood 1.PNG",
        ' "Textures\\Wood 1.PNG" ',
    ):
        assert find_beside(tmp_path, name) == wood
    assert find_beside(tmp_path, "A.PNG") == tmp_path / "a.png"
    # two fit, and neither exactly
    assert find_beside(tmp_path, "b.png") is None
    for name in ("", ".", "nosuch.png", "x\0y", "y" * 5000, "Textures", "../a.png/b"):
        assert find_beside(tmp_path, name) is None
    assert find_beside(tmp_path / "Textures", "../a.png").read_bytes() == b"x"
