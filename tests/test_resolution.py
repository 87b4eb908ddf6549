"""The density rule: near-cubic cells, flat and endless scenes, limits."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clgrid.errors import GridTooLargeError, InputError
from clgrid.resolution import BOX_PAD, MOST_CELLS, by_density, checked

# Local extents come from float32.
extents = st.floats(2.0**-149, 2) | st.sampled_from([0.0, 2.0**-21, 2.0**-30, 1e-4, 2.0])


@pytest.mark.parametrize(
    ("size", "triangles", "density", "expected"),
    [
        ((1, 1, 1), 2000, 4, (20, 20, 20)),
        ((2, 1, 0.5), 2000, 4, (40, 20, 10)),
        ((1, 1, 0), 2500, 4, (100, 100, 1)),
        ((1, 0, 0), 25, 4, (100, 1, 1)),
        ((0, 0, 0), 1000, 4, (1, 1, 1)),
        ((1, 1, 2.0**-21), 2500, 4, (100, 100, 1)),
        ((1, 1, 1e-3), 2500, 4, (100, 100, 1)),
        ((1, 1e-3, 1e-3), 25, 4, (100, 1, 1)),
        ((1, 1, 1), 1, 0.001, (1, 1, 1)),
    ],
)
def test_the_rule(
    size: tuple[float, ...], triangles: int, density: float, expected: tuple[int, ...]
) -> None:  # fmt: skip
    assert by_density(np.array(size, np.float64), triangles, density) == expected


@given(st.tuples(extents, extents, extents), st.integers(1, 10**6), st.floats(0.01, 100))
def test_the_rule_gives_about_the_cells_wanted(
    size: tuple[float, float, float], triangles: int, density: float
) -> None:
    found = np.array(by_density(np.array(size), triangles, density))
    assert (found >= 1).all()
    longest = max(size)
    flat = np.array(size) <= 2.0**-20 * longest
    assert (found[flat] == 1).all()
    if longest > 0:
        # No cell is thinner than eight pads, unless the axis has but one.
        assert (np.array(size) / found >= 8 * BOX_PAD * (1 - 1e-9))[found > 1].all()
        assert found.prod() <= 3.4 * max(1.0, density * triangles)


def test_cells_never_get_thinner_than_the_pad() -> None:
    # All triangles on a line: without the cap there would be 4e9 cells along it.
    assert by_density(np.array([2.0, 0, 0]), 10**9, 4)[0] == int(2 / (8 * BOX_PAD))


@pytest.mark.parametrize("density", [0.0, -1.0, np.nan, np.inf])
def test_bad_densities_are_refused(density: float) -> None:
    with pytest.raises(InputError, match="positive number of cells per triangle"):
        by_density(np.ones(3), 10, density)


def test_more_cells_than_32_bits_are_refused_with_the_number() -> None:
    with pytest.raises(GridTooLargeError, match=r"has 8,\d{3},\d{3},\d{3} cells"):
        by_density(np.ones(3), 2 * 10**9, 4)
    with pytest.raises(GridTooLargeError, match="4,294,967,296 cells"):
        checked((65536, 65536, 1))
    with pytest.raises(GridTooLargeError, match="along an axis"):
        checked((1, 2**31, 1))


@pytest.mark.parametrize(
    "resolution",
    [(0, 1, 1), (-3, 1, 1), (1.5, 1, 1), (1, 1), (1, 1, 1, 1), "abc", None, (1, 1, np.inf), ("1", 1, 1)],
)
def test_bad_resolutions_are_refused(resolution: object) -> None:
    with pytest.raises(InputError, match="three whole numbers"):
        checked(resolution)  # type: ignore[arg-type]


def test_whole_numbers_of_any_type_are_taken() -> None:
    assert checked((np.int64(3), np.uint32(4), 5.0)) == (3, 4, 5)  # type: ignore[arg-type]
    assert MOST_CELLS < 2**32
