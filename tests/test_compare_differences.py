"""Differences between answers are counted by what differs, whatever devices gave them."""

from __future__ import annotations

import numpy as np
import pytest

from clgrid.compare.differences import first_ray, heat_map, image_differences, most_ulps, ray_differences
from clgrid.compare.files import Answers
from clgrid.difference import difference, distances, flip
from clgrid.wavefront import Batch, pixel_order

WIDTH, HEIGHT = 20, 12
MISS = 0xFFFFFFFF


def answers(real: type = np.float32) -> Answers:
    """All rays hit, but for the last."""
    count = WIDTH * HEIGHT
    t = np.linspace(1.0, 2.0, count)
    t[-1] = np.inf
    ids = np.arange(count, dtype=np.uint32)
    ids[-1] = MISS
    return Answers(
        {"primary": t},
        {"primary": ids},
        {"primary": np.full((count, 2), 0.25, real)},
        np.full((HEIGHT, WIDTH, 4), 0.5, np.float32),
        ids.reshape(HEIGHT, WIDTH),
    )


def rays() -> dict[str, Batch]:
    numbers = np.arange(WIDTH * HEIGHT * 3, dtype=np.float64).reshape(-1, 3)
    return {"primary": Batch("primary", numbers, numbers + 0.1, 1.0)}


def test_equal_answers_differ_in_nothing() -> None:
    found = ray_differences(answers(), answers(), "primary", "robust")
    assert found.differing == found.id == found.t == found.u == found.v == 0
    assert found.t_ulps == found.u_ulps == found.only_first == found.only_second == 0
    assert first_ray(answers(), answers(), rays()) is None
    assert heat_map(answers(), answers()) is None
    same = image_differences(answers(), answers())
    assert (same.differing, same.ids, same.largest, same.psnr, same.perceptual) == (0, 0, 0.0, None, 0.0)


@pytest.mark.parametrize(("accuracy", "real"), [("robust", np.float32), ("precise", np.float64)])
def test_rays_are_counted_by_what_differs(accuracy: str, real: type) -> None:
    one, other = answers(real), answers(real)
    t, ids, uvs = other.t["primary"], other.ids["primary"], other.uvs["primary"]
    last = np.spacing(real(t[3]))
    t[3] += 3 * float(last)  # 3 last places
    uvs[4, 0] = np.nextafter(uvs[4, 0], real(1))
    uvs[5, 1] += 2 * np.spacing(real(0.25))
    uvs[4, 1] = -uvs[4, 1]
    ids[6] = 99
    ids[7], t[7] = MISS, np.inf
    ids[-1], t[-1] = 5, 1.5
    found = ray_differences(one, other, "primary", accuracy)
    assert (found.rays, found.differing) == (WIDTH * HEIGHT, 6)
    assert (found.id, found.t, found.u, found.v) == (3, 3, 1, 2)
    assert (found.only_first, found.only_second) == (1, 1)
    assert (found.t_ulps, found.u_ulps) == (3.0, 1.0)
    assert found.v_ulps == 0.5 / float(np.spacing(real(0.25)))
    back = ray_differences(other, one, "primary", accuracy)
    assert (back.only_first, back.only_second, back.differing) == (1, 1, 6)

    told = first_ray(one, other, rays())
    assert told is not None
    ray, alone = told
    assert (ray.kind, ray.index, ray.differs) == ("primary", 3, ("t",))
    assert [float.fromhex(value) for value in ray.direction] == [9.1, 10.1, 11.1]
    assert (ray.t_min, float.fromhex(ray.t_max)) == ((0.0).hex(), 1.0)
    assert alone.origins.tolist() == [9.0, 10.0, 11.0]
    assert ray.first.startswith(f"t {one.t['primary'].item(3)!r}, triangle 3, u 0.25")
    t[0], ids[0] = np.inf, MISS
    assert first_ray(one, other, rays())[0].second == "a miss"  # type: ignore[index]


def test_signs_of_zero_and_signs_of_numbers_are_bits() -> None:
    one, other = answers(), answers()
    one.uvs["primary"][0, 0], other.uvs["primary"][0, 0] = 0.0, -0.0
    found = ray_differences(one, other, "primary", "robust")
    assert (found.differing, found.u, found.u_ulps) == (1, 1, 0.0)


def test_last_places_of_extremes() -> None:
    most = np.finfo(np.float64).max
    assert most_ulps(np.array([]), np.array([]), np.float32) == 0
    assert most_ulps(np.array([np.inf]), np.array([np.inf]), np.float32) == 0
    assert most_ulps(np.array([most]), np.array([np.nextafter(most, 0)]), np.float64) == 2
    assert most_ulps(np.array([0.0]), np.array([5e-324]), np.float64) == 1
    none = np.array([np.nan, 1.0])
    assert most_ulps(none, none.copy(), np.float32) == 0
    # JSON has no infinite numbers.
    assert most_ulps(none, np.array([2.0, 1.0]), np.float32) == most
    assert most_ulps(np.array([1.0]), np.array([np.inf]), np.float64) == most


def test_the_heat_map_is_where_pixels_are() -> None:
    one, other = answers(), answers()
    order = pixel_order(WIDTH, HEIGHT)
    ray = int(np.flatnonzero(order == 7 * WIDTH + 13)[0])
    other.t["primary"][ray] += 1.0
    other.rgba[2, 3, 1] += 0.25
    found = heat_map(one, other)
    assert found is not None
    assert (found.width, found.height, found.block) == (WIDTH, HEIGHT, 1)
    assert np.flatnonzero(found.rays).tolist() == [7 * WIDTH + 13]
    assert np.flatnonzero(found.image).tolist() == [2 * WIDTH + 3]
    assert found.image[2 * WIDTH + 3] == 0.25


def test_the_heat_map_of_a_large_picture_is_coarse() -> None:
    width, height = 300, 130
    zeros = np.zeros((height, width), np.uint32)
    rgba = np.zeros((height, width, 4), np.float32)
    one = Answers({}, {}, {}, rgba, zeros)
    other = Answers({}, {}, {}, rgba.copy(), zeros)
    other.rgba[129, 299, 0], other.rgba[129, 298, 2] = 0.5, 1.0
    found = heat_map(one, other)
    assert found is not None
    assert (found.width, found.height, found.block) == (100, 44, 3)
    assert len(found.image) == 4400
    assert found.image[-1] == 1.0
    assert sum(found.image) == 1.0


def test_pictures() -> None:
    one, other = answers(), answers()
    other.rgba[0, 0, 0] = 0.75
    other.rgba[0, 1, 3] = 0.0
    other.primitive_id[5, 5] = 3
    found = image_differences(one, other)
    assert (found.pixels, found.differing, found.ids, found.largest) == (WIDTH * HEIGHT, 2, 1, 0.25)
    assert found.mean == pytest.approx(0.25 / (3 * WIDTH * HEIGHT))
    assert found.psnr == pytest.approx(10 * np.log10(3 * WIDTH * HEIGHT / 0.25**2))
    assert found.perceptual is not None
    assert found.largest_perceptual is not None
    assert 0 < found.perceptual < found.largest_perceptual <= 1
    assert found.measure == "FLIP"


def test_flip_grows_with_what_is_seen() -> None:
    grey = np.full((32, 32, 3), 0.5, np.float32)
    faint, strong = grey.copy(), grey.copy()
    faint[10:20, 10:20] += 0.01
    strong[10:20, 10:20] = 0.0
    (little, _), (much, most) = flip(grey, faint), flip(grey, strong)  # type: ignore[misc]
    assert 0 < little < much
    assert most > 0.5
    strong[0, 0, 0] = np.inf
    assert flip(grey, strong) is None


def test_numbers_that_are_none() -> None:
    one, other = np.array([[np.nan, np.inf, -np.inf, 1.0]]), np.array([[np.nan, np.inf, np.inf, np.nan]])
    assert distances(one, other).tolist() == [[0.0, 0.0, np.inf, np.inf]]
    found = difference(one, one.copy())
    assert (found.differing, found.largest, found.psnr) == (0, 0.0, None)
