from __future__ import annotations

import os

import numpy as np
import OpenImageIO as oiio  # noqa: N813
import pytest

from clgrid.errors import ImageError
from clgrid.image import Image, check_output, read_image, to_srgb8


def picture(height: int = 13, width: int = 7) -> Image:
    """Random groups of which the first row holds the values that go wrong."""
    rng = np.random.default_rng(5)
    depth = rng.random((height, width), np.float32)
    special = np.array([np.inf, 1e-44, -0.0, 3e38, np.nan], np.float32)
    depth[0, :5] = special[:width]
    ids = rng.integers(0, 2**32, (2, height, width), np.uint32)
    ids[0, 0, :5] = np.array([2**32 - 1, 2**24 + 1, 0, 1, 2**32 - 2], np.uint32)[:width]
    return Image(
        rng.random((height, width, 4), np.float32),
        depth=depth,
        normal=rng.standard_normal((height, width, 3), np.float32),
        primitive_id=ids[0],
        geometry_id=ids[1],
        steps=rng.integers(0, 2**32, (height, width), np.uint32),
        metadata={
            "Software": "clgrid test",
            "worldToCamera": np.arange(16.0).reshape(4, 4),
            "clgrid:triangles": 7,
            "clgrid:grid_bytes": 2**33,
            "clgrid:render_s": 0.25,
        },
    )


@pytest.mark.parametrize("size", [(13, 7), (1, 1), (8, 64), (64, 1)])
def test_exr_keeps_every_bit_of_every_group(tmp_path, size):
    image = picture(*size)
    image.save(tmp_path / "a.exr")
    back = read_image(tmp_path / "a.exr")
    for name in ("rgba", "depth", "normal", "primitive_id", "geometry_id", "steps"):
        before, after = getattr(image, name), getattr(back, name)
        assert after.dtype == before.dtype
        assert after.shape == before.shape
        assert (after.view(np.uint32) == before.view(np.uint32)).all(), name


def test_exr_has_parts_and_channels_by_their_usual_names(tmp_path):
    picture().save(tmp_path / "a.exr")
    source = oiio.ImageInput.open(str(tmp_path / "a.exr"))
    parts = {}
    while source.seek_subimage(len(parts), 0):
        spec = source.spec()
        parts[spec.getattribute("oiio:subimagename")] = (set(spec.channelnames), str(spec.format))
    assert parts == {
        "rgba": ({"R", "G", "B", "A"}, "float"),
        "depth": ({"Z"}, "float"),
        "normal": ({"N.X", "N.Y", "N.Z"}, "float"),
        "id": ({"primitive_id", "geometry_id"}, "uint"),
        "steps": ({"steps"}, "uint"),
    }


def test_exr_without_aovs_has_one_part(tmp_path):
    Image(np.ones((2, 3, 4), np.float32)).save(tmp_path / "a.exr")
    back = read_image(tmp_path / "a.exr")
    assert back.depth is None
    assert back.primitive_id is None
    assert (back.rgba == 1).all()


def test_metadata_come_back(tmp_path):
    picture().save(tmp_path / "a.exr")
    found = read_image(tmp_path / "a.exr").metadata
    assert found["Software"] == "clgrid test"
    assert found["clgrid:triangles"] == 7
    assert found["clgrid:grid_bytes"] == str(2**33)
    assert found["clgrid:render_s"] == 0.25
    # Row vectors: the transpose of ours.
    np.testing.assert_array_equal(np.reshape(found["worldToCamera"], (4, 4)).T, np.arange(16.0).reshape(4, 4))


def test_png_is_opaque_srgb_with_a_description(tmp_path):
    image = Image(np.zeros((1, 5, 4), np.float32), metadata={"clgrid:device": "someone's device"})
    image.rgba[0, :, 0] = [0.0, 0.0031308, 0.21404114, 1.0, 7.0]
    image.save(tmp_path / "a.png")
    pixels = oiio.ImageInput.open(str(tmp_path / "a.png")).read_image("uint8")
    assert pixels.shape == (1, 5, 3)
    assert pixels[0, :, 0].tolist() == [0, 10, 128, 255, 255]
    assert "someone's device" in read_image(tmp_path / "a.png").metadata["ImageDescription"]


def test_srgb_follows_the_formula_at_every_step():
    linear = np.linspace(-0.25, 1.25, 200_001).astype(np.float32)
    x = np.clip(linear.astype(np.float64), 0, 1)
    encoded = np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055) * 255
    off = np.abs(encoded - to_srgb8(linear))
    assert off.max() <= 0.5 + 1e-3
    assert set(to_srgb8(linear).tolist()) == set(range(256))
    # Grey pixels take a way of their own; with one that is not grey, none does.
    grey = np.repeat(linear[:, None], 3, axis=1)
    mixed = np.concatenate([grey, [[0.1, 0.2, 0.3]]]).astype(np.float32)
    assert (to_srgb8(grey) == to_srgb8(mixed)[:-1]).all()
    assert (to_srgb8(grey)[:, 1] == to_srgb8(linear)).all()


@pytest.mark.parametrize("name", ["a.gif", "a", "a.exr.gz"])
def test_unknown_formats_are_refused(tmp_path, name):
    with pytest.raises(ImageError, match=r"\.exr, \.png, \.jpg"):
        picture().save(tmp_path / name)


def test_missing_folder_and_folder_as_file_are_refused(tmp_path):
    with pytest.raises(ImageError, match="no such folder"):
        picture().save(tmp_path / "no" / "a.exr")
    (tmp_path / "b.exr").mkdir()
    with pytest.raises(ImageError, match="is a folder"):
        picture().save(tmp_path / "b.exr")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_unwritable_folder_is_refused(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(ImageError, match="not writable"):
        check_output(tmp_path / "a.exr")


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch):
    (tmp_path / "a.exr").write_bytes(b"old")

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(ImageError, match="No space left"):
        picture().save(tmp_path / "a.exr")
    assert [path.name for path in tmp_path.iterdir()] == ["a.exr"]
    assert (tmp_path / "a.exr").read_bytes() == b"old"


def test_an_interrupted_write_leaves_nothing(tmp_path, monkeypatch):
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", interrupt)
    with pytest.raises(KeyboardInterrupt):
        picture().save(tmp_path / "a.exr")
    assert list(tmp_path.iterdir()) == []


def test_reading_rubbish_is_an_image_error(tmp_path):
    (tmp_path / "a.exr").write_bytes(b"not an image")
    with pytest.raises(ImageError, match="cannot be read"):
        read_image(tmp_path / "a.exr")
    picture(64, 64).save(tmp_path / "b.exr")
    content = (tmp_path / "b.exr").read_bytes()
    (tmp_path / "b.exr").write_bytes(content[: len(content) // 2])
    with pytest.raises(ImageError):
        read_image(tmp_path / "b.exr")
