"""What is counted as wrong, and what a survey makes of it: on made-up answers and pictures."""

from __future__ import annotations

from dataclasses import dataclass, field
from fractions import Fraction
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from clgrid.errors import GridTooLargeError, InputError
from clgrid.rational import Crossing
from clgrid.tradeoff.errors import Answers, against_exact_rung, against_rational, nearest_ids
from clgrid.tradeoff.intervals import rate_most
from clgrid.tradeoff.pictures import picture_errors, same_colours
from clgrid.tradeoff.plan import DENSITIES, LAYOUTS, SIMPLICITY, Plan, Point, Wish
from clgrid.tradeoff.report import broken_promises, error_of
from clgrid.tradeoff.survey import Survey
from clgrid.tradeoff_record import ReferenceCheck

pytestmark = pytest.mark.host

INF = np.inf
TRUTH = Answers(np.array([1.0, 2.0, INF, INF, 5.0, 6.0]), np.array([0, 1, -1, -1, 4, 5]))
# A miss, another triangle, a false hit, a right miss, and two right hits of which one is a little off.
FOUND = Answers(np.array([INF, 2.5, 3.0, INF, 5.0, 6.5]), np.array([-1, 7, 9, -1, 4, 5]))
LAST, LENGTHS = np.full(6, 0.25), np.full(6, 10.0)


def test_wrong_answers_are_told_apart() -> None:
    found = against_exact_rung("camera", FOUND, TRUTH, np.full(6, 1e-3), LAST, LENGTHS)
    assert (found.kind, found.reference, found.rays, found.hits) == ("camera", "exact rung", 6, 4)
    assert (found.missed, found.false_hits, found.wrong_triangles) == (1, 1, 1)
    assert found.missed_most == rate_most(1, 6)
    distance = found.distance
    assert distance is not None
    # Of two hits on the right triangle, one is off by 0.5: 2 last places, 5 scene units.
    assert (distance.hits, distance.worst_ulps, distance.worst, distance.median) == (2, 2.0, 5.0, 5.0)
    assert distance.floor == pytest.approx(1e-2)


def test_rational_arithmetic_says_the_same() -> None:
    lines = [
        [Crossing(0, Fraction(1))],
        [Crossing(3, Fraction(-1)), Crossing(1, Fraction(2)), Crossing(7, Fraction(5, 2))],
        [Crossing(9, Fraction(-3))],
        [],
        [Crossing(4, Fraction(5))],
        [Crossing(5, Fraction(6))],
    ]
    np.testing.assert_array_equal(nearest_ids(lines), TRUTH.ids)
    found = against_rational("camera", FOUND, lines, LAST, LENGTHS)
    assert (found.missed, found.false_hits, found.wrong_triangles) == (1, 1, 1)
    assert found.distance is not None
    assert (found.distance.hits, found.distance.worst, found.distance.floor) == (2, 5.0, 0.0)


def test_without_a_right_hit_there_is_no_distance() -> None:
    first = slice(3)
    found = against_exact_rung("camera", FOUND.at(first), FOUND.at(first), *[np.ones(3)] * 3)
    assert found.distance is not None
    none = against_exact_rung("camera", TRUTH.at(first), FOUND.at(first), *[np.ones(3)] * 3)
    assert (none.rays, none.hits, none.distance) == (3, 2, None)


def test_pictures_are_compared_pixel_by_pixel() -> None:
    ids, colours = np.zeros((2, 4), np.uint32), np.full((2, 4, 4), 0.5, np.float32)
    same = picture_errors(ids, ids, colours, colours)
    assert (same.pixels, same.other_triangles, same.largest, same.rms, same.psnr) == (8, 0, 0.0, 0.0, None)
    other_ids, other = ids.copy(), colours.copy()
    other_ids[1, 2], other[1, 2, 0], other[0, 0, 3] = 5, 1.0, 0.0
    found = picture_errors(other_ids, ids, other, colours)
    assert (found.other_triangles, found.other_share, found.largest) == (1, 1 / 8, 0.5)
    # One channel of 24 is off by a half; alpha is not compared.
    assert found.rms == pytest.approx(np.sqrt(0.25 / 24))
    assert found.psnr == pytest.approx(-10 * np.log10(0.25 / 24))
    assert same_colours(colours, colours.copy())
    assert not same_colours(colours, np.nextafter(colours, np.float32(1)))
    assert not same_colours(np.zeros(1, np.float32), -np.zeros(1, np.float32))


def check(wrong: int = 0, late: int = 0) -> ReferenceCheck:
    return ReferenceCheck(
        asked=300, rays=300, wrong=wrong, wrong_most=rate_most(wrong, 300), late=late, rational_s=[1.0]
    )


def test_errors_by_every_measure() -> None:
    ids, colours = np.zeros((10, 10), np.uint32), np.zeros((10, 10, 4), np.float32)
    other = ids.copy()
    other[0, :3] = 1
    picture = picture_errors(other, ids, colours + np.float32(0.25), colours)
    answers = [
        against_exact_rung(kind, FOUND, TRUTH, np.full(6, 1e-3), LAST, LENGTHS)
        for kind in ("camera", "structured")
    ]
    found = {name: error_of("fast", picture, answers, name, check()) for name in ("pixels", "rays", "rms")}
    assert found == {
        "pixels": (0.03, rate_most(3, 100)),
        "rays": (0.5, rate_most(3, 6)),
        "rms": (0.25, 0.25),
    }
    assert error_of("fast", picture, answers, "distance", check()) == (5.0, pytest.approx(5.01))
    # The reference is wrong nowhere by definition; how sure that is, rational arithmetic says.
    assert error_of("exact", picture, answers, "pixels", check()) == (0.0, rate_most(0, 300))


def test_a_wrong_reference_is_a_broken_promise() -> None:
    assert broken_promises("ball", check()) == []
    lines = broken_promises("ball", check(wrong=2, late=1))
    assert len(lines) == 2
    assert all(line.startswith("ball: ") and "report" in line for line in lines)


@dataclass
class PaintedGrid:
    """What a survey asks of a grid."""

    nbytes: int
    peak_nbytes: int = 7
    stats: Any = field(default_factory=lambda: SimpleNamespace(resolution=(1, 1, 1), references=3))

    def __enter__(self) -> PaintedGrid:
        return self

    def __exit__(self, *error: object) -> None:
        self.nbytes = -1


class PaintedEasel:
    """Grids and pictures without a device; seconds pass on a clock of its own."""

    def __init__(self, plan: Plan, *, spoilt: Point | None = None, slow: str = "") -> None:
        self.plan, self.scene, self.now = plan, SimpleNamespace(name="made up"), 0.0
        self._spoilt, self._slow = spoilt, slow
        self._drawn: Point | None = None

    def build(self, point: Point) -> PaintedGrid:
        if point.layout == "dynamic-array":
            raise GridTooLargeError("too large by far")
        self._drawn = point
        return PaintedGrid(int(100 * point.density))

    def draw(self, grid: PaintedGrid, samples: int | None) -> Any:
        assert self._drawn is not None
        self.now += 20.0 if self._drawn.layout == self._slow else 0.1
        colours = np.zeros((4, 4, 4), np.float32)
        # Fast pictures are by grid; one point of another rung is spoilt.
        if self._drawn.accuracy == "fast":
            colours[0, 0] = self._drawn.density
        if self._drawn == self._spoilt:
            colours[0, 0] = 9.0
        return colours

    def ids(self, grid: PaintedGrid) -> Any:
        assert self._drawn is not None
        ids = np.zeros((4, 4), np.uint32)
        ids[0, 0] = self._drawn == self._spoilt or self._drawn.accuracy == "fast"
        return ids


class PaintedReference:
    recipe = ("nested", 0.5)

    def __init__(self) -> None:
        self.asked = 0

    def errors(self, grid: PaintedGrid, seconds: float) -> list[Any]:
        assert grid.nbytes >= 0
        self.asked += 1
        return [self.asked]


def survey(easel: PaintedEasel) -> tuple[Survey, PaintedReference]:
    reference = PaintedReference()
    blank = np.zeros((4, 4), np.uint32), np.zeros((4, 4, 4), np.float32)
    found = Survey(easel, reference, *blank)  # type: ignore[arg-type]
    found.run(easel.plan.points(), lambda step, share: None, clock=lambda: easel.now)
    return found, reference


def test_one_grid_speaks_for_a_rung_that_no_grid_changes() -> None:
    plan = Plan(("fast", "robust", "exact"), ("compact", "hashed"), (1.0, 2.0), budget_s=1000.0)
    found, reference = survey(PaintedEasel(plan))
    assert [seen.point for seen in found.seen] == list(plan.points())
    # Each of the four points of fast, and one of each of the others.
    assert reference.asked == 6
    assert [seen.errors_of for seen in found.seen] == [0, 1, 2, 3, *[4] * 4, *[8] * 4]
    assert [seen.picture.other_triangles for seen in found.seen] == [1] * 4 + [0] * 8
    assert [seen.picture.largest for seen in found.seen[:4]] == [1.0, 2.0, 1.0, 2.0]
    assert [seen.grid_bytes for seen in found.seen[:2]] == [100, 200]
    assert found.broken == found.left_out == []


def test_a_picture_that_a_grid_changes_is_a_broken_promise() -> None:
    spoilt = Point("robust", "hashed", 2.0, None)
    plan = Plan(("robust", "exact"), ("compact", "hashed"), (1.0, 2.0), budget_s=1000.0)
    found, _ = survey(PaintedEasel(plan, spoilt=spoilt))
    [line] = found.broken
    assert line.startswith("made up: robust, hashed, density 2 shows another picture")
    assert [seen.picture.other_triangles for seen in found.seen] == [
        int(s.point == spoilt) for s in found.seen
    ]


def test_what_does_not_fit_is_left_out_with_the_reason() -> None:
    found, _ = survey(PaintedEasel(Plan(("robust",), ("compact", "dynamic-array"), (1.0, 2.0))))
    assert [seen.point.layout for seen in found.seen] == ["compact", "compact"]
    assert [(each.layout, each.density) for each in found.left_out] == [
        ("dynamic-array", 1.0),
        ("dynamic-array", 2.0),
    ]
    assert {each.reason for each in found.left_out} == {"too large by far"}


def test_hopeless_points_are_left_out_where_the_budget_is_short() -> None:
    names = ("fast", "robust", "precise"), ("compact", "nested"), (1.0, 2.0)
    found, _ = survey(PaintedEasel(Plan(*names, budget_s=1000.0), slow="compact"))
    assert (len(found.seen), found.left_out) == (12, [])
    found, _ = survey(PaintedEasel(Plan(*names, budget_s=60.0), slow="compact"))
    assert {seen.point.layout for seen in found.seen if seen.point.accuracy != "fast"} == {"nested"}
    assert len(found.left_out) == 4
    assert "20 s a picture on the rung fast, 200 times the fastest" in found.left_out[0].reason


def test_points_are_in_order_and_all_there() -> None:
    points = list(Plan().points())
    assert len(points) == len(set(points)) == 4 * len(LAYOUTS) * len(DENSITIES)
    assert points[0] == Point("fast", "compact", min(DENSITIES), None)
    assert {point.samples for point in Plan(samples=(4,)).points()} == {4}
    assert points[-1].words() == "exact, nested-hashed, density 4"
    assert Point("fast", "hashed", 0.5, 4).words() == "fast, hashed, density 0.5, 4 samples"


def test_all_layouts_have_a_place() -> None:
    from clgrid.layouts import ALL_LAYOUTS

    assert sorted(SIMPLICITY) == sorted(ALL_LAYOUTS)


@pytest.mark.parametrize(
    "wrong",
    [
        {"accuracies": ("blurry",)},
        {"accuracies": ()},
        {"layouts": ("octree",)},
        {"densities": (0.0,)},
        {"densities": tuple(float(k) for k in range(1, 200))},
        {"samples": (0,)},
        {"samples": (1, 4)},
        {"rays": 0},
        {"exact": -1},
        {"budget_s": 0.0},
        {"clock": "sun"},
    ],
)
def test_plans_that_make_no_sense_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="tradeoff: "):
        Plan(**wrong)


@pytest.mark.parametrize(
    "wrong",
    [{"measure": "smell"}, {"max_error": -1.0}, {"max_error": 2.0}, {"max_time_s": 0.0}, {"frames": 0}],
)
def test_wishes_that_make_no_sense_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(InputError):
        Wish(**wrong)


def test_the_cost_of_a_picture() -> None:
    assert Wish().cost_s(10.0, 1.0) == 11.0
    assert Wish(frames=5).cost_s(10.0, 1.0) == 3.0
    assert Wish(frames=5, rebuild=True).cost_s(10.0, 1.0) == 11.0


def test_what_a_wish_allows() -> None:
    assert Wish().allowed_error == 0.0
    assert Wish(max_error=0.1).allowed_error == 0.1
    assert Wish(max_time_s=1.0).allowed_error is None
    assert Wish(max_time_s=1.0).least_error
    assert not Wish(max_time_s=1.0, max_error=0.0).least_error
