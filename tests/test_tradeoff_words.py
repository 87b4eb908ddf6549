"""The recommendation in words, on made-up rows."""

from __future__ import annotations

from typing import Any

import pytest

from clgrid.tradeoff.intervals import rate_most
from clgrid.tradeoff.plan import Wish
from clgrid.tradeoff.words import nearest, sentence
from clgrid.tradeoff_record import PictureErrors, ReferenceCheck, Spread, TradeoffRow
from clgrid.units import seconds

pytestmark = pytest.mark.host

CHECK = ReferenceCheck(asked=400, rays=400, wrong=0, wrong_most=rate_most(0, 400), late=0, rational_s=[1.0])
PIXELS = 2**20


def row(accuracy: str, cost: float, others: int, **changes: Any) -> TradeoffRow:
    share = others / PIXELS
    picture = PictureErrors(
        pixels=PIXELS, other_triangles=others, other_share=share, other_share_most=rate_most(others, PIXELS),
        largest=0.5, rms=0.25 * share, psnr=80.0 if others else None,
    )  # fmt: skip
    made: dict[str, Any] = {
        "accuracy": accuracy, "layout": "compact", "density": 1.0, "samples": None, "resolution": (4, 4, 4),
        "references": 10, "grid_bytes": 100, "bytes_per_triangle": 1.0, "peak_bytes": 200, "turns": [0, 1],
        "build_s": [cost / 2] * 2, "render_s": [cost / 2] * 2, "time_to_image_s": [cost] * 2,
        "cost_s": Spread(median=cost, low=cost, high=cost), "picture": picture, "errors": [], "errors_of": 0,
        "error": share, "error_most": picture.other_share_most, "refused": ["error"] if others else [],
        "on_front": True, "verify": "",
    }  # fmt: skip
    return TradeoffRow(**{**made, **changes})


def said(rows: list[TradeoffRow], chosen: int, wish: Wish | None = None, support: float = 1.0) -> str:
    return sentence(rows, chosen, wish or Wish(), CHECK, support, 0 if support < 1 else None)


def test_what_the_fastest_would_save_and_get_wrong() -> None:
    rows = [row("fast", 0.0069, 23), row("robust", 0.0098, 0), row("exact", 0.0118, 0)]
    assert said(rows, 1) == (
        "robust, compact, density 1: 9.8 ms, no wrong pixel in 1,048,576 (below 2.9e-06 at 95 %);"
        " fast would save 2.9 ms and show another triangle in 23 pixels"
    )


def test_what_exact_would_take_where_nothing_is_faster() -> None:
    rows = [row("fast", 0.0097, 1), row("robust", 0.0098, 0), row("exact", 0.0118, 0, density=2.0)]
    assert said(rows, 1).endswith("; exact would take 11.8 ms (exact, density 2)")
    text = said(rows, 2)
    assert "the reference itself: 0 wrong of 400 rays by rational arithmetic (below 0.0075 at 95 %)" in text


def test_points_that_had_few_turns_are_not_named() -> None:
    rows = [row("fast", 0.001, 23, turns=[0]), row("robust", 0.0098, 0)]
    assert "fast" not in said(rows, 1)


def test_a_near_thing_names_the_other() -> None:
    rows = [row("robust", 0.01, 0, density=2.0), row("robust", 0.01, 0)]
    text = said(rows, 1, None, 0.6)
    assert "a near thing: 60 % of the draws say so, others robust, compact, density 2;" in text


def test_frames_and_measures() -> None:
    rows = [row("robust", 0.01, 1)]
    assert "10 ms a picture of 50, 1 wrong pixel in 1,048,576" in said(rows, 0, Wish(frames=50))
    assert "10 ms a picture of 50, each rebuilt," in said(rows, 0, Wish(frames=50, rebuild=True))
    assert "colours off by 2.4e-07 (rms)" in said(rows, 0, Wish(measure="rms", max_error=1.0))
    assert "t off by at most 4.5e-06 scene units" in said(rows, 0, Wish(measure="distance", max_error=1.0))


def test_what_comes_nearest_where_nothing_will_do() -> None:
    rows = [row("fast", 0.005, 7), row("robust", 0.02, 0, refused=["time"])]
    text = nearest(rows, Wish(max_error=0.0, max_time_s=0.01, max_memory=1000), CHECK)
    assert text == (
        "no point keeps to pixels 0 and 10 ms and 1 kB; within the error the fastest is robust, compact,"
        " density 1, 20 ms; within the time fast, compact, density 1 has the least error, 7 wrong pixels in"
        f" 1,048,576 (below {rate_most(7, PIXELS):.2g} at 95 %)"
    )


def test_seconds_in_words() -> None:
    assert [seconds(value) for value in (0.00123, 0.5, 2.0)] == ["1.23 ms", "500 ms", "2 s"]
