"""From repetitions to the recommended point: intervals, turns, front, choice, on made-up times."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from clgrid.tradeoff.choose import FAST_PAYS, MARGIN, Candidate, choose, choose_by
from clgrid.tradeoff.contest import FEW, FEWEST_LAST_TURNS, LEAST_TURNS, MOST_TURNS, OF_RUNG, TURNS, Contest
from clgrid.tradeoff.front import front
from clgrid.tradeoff.intervals import CONFIDENCE, incomplete_beta, median_interval, rate_most
from clgrid.tradeoff.turns import Turns, medians

RNG = np.random.Generator


def at_most(count: int, of: int, rate: float) -> float:
    """The chance of at most so many, summed term by term."""
    terms = (
        math.lgamma(of + 1) - math.lgamma(k + 1) - math.lgamma(of - k + 1)
        + k * math.log(rate) + (of - k) * math.log1p(-rate)
        for k in range(count + 1)
    )  # fmt: skip
    return math.fsum(map(math.exp, terms))


@pytest.mark.parametrize(
    ("count", "of"), [(0, 1), (0, 3000), (1, 10), (5, 100), (7, 8), (23, 2**20), (400, 100_000), (990, 1000)]
)
def test_the_bound_of_a_rate_is_where_so_few_are_just_still_seen(count: int, of: int) -> None:
    most = rate_most(count, of)
    assert at_most(count, of, most) == pytest.approx(1 - CONFIDENCE, rel=1e-6)
    assert count / of < most <= 1


def test_known_bounds() -> None:
    assert rate_most(0, 2**20) == pytest.approx(2.857e-6, rel=1e-3)
    assert rate_most(0, 300) == pytest.approx(3 / 300, rel=0.01)  # the rule of three
    assert rate_most(1, 10) == pytest.approx(0.3942, abs=1e-4)
    assert rate_most(5, 5) == rate_most(0, 0) == 1.0
    assert incomplete_beta(2, 3, 0.0) == 0.0
    assert incomplete_beta(2, 3, 1.0) == 1.0
    assert incomplete_beta(1, 1, 0.25) == pytest.approx(0.25)


def test_intervals_of_medians_are_order_statistics() -> None:
    assert median_interval([3.0]) == (3.0, 3.0, 3.0)
    assert median_interval([4.0, 1.0, 2.0, 8.0]) == (3.0, 1.0, 8.0)
    assert median_interval(range(1, 10)) == (5, 2, 8)
    assert median_interval(range(1, 16)) == (8, 4, 12)


def test_intervals_hold_the_median_as_often_as_they_say() -> None:
    rng = np.random.default_rng(0)
    found = [median_interval(row) for row in rng.exponential(size=(2000, 15)).tolist()]
    held = np.mean([low <= math.log(2) <= high for _, low, high in found])
    assert held > CONFIDENCE - 0.01


def test_slow_turns_slow_no_point() -> None:
    rng = np.random.default_rng(1)
    points, slow = rng.uniform(1, 2, 12), rng.uniform(1, 10, 9)
    turns = Turns.of_lists(np.outer(points, slow).tolist())
    np.testing.assert_allclose(turns.evened() / points, np.median(slow))
    np.testing.assert_allclose(turns.slowness(), slow / np.median(slow))


def test_one_outlier_changes_no_median() -> None:
    seconds = np.outer([1.0, 1.5, 2.0, 4.0], np.ones(7))
    seconds[1, 3] = 100.0
    np.testing.assert_allclose(Turns.of_lists(seconds.tolist()).medians(), [1.0, 1.5, 2.0, 4.0])


def test_points_that_left_early_are_evened_by_their_turns() -> None:
    turns = Turns(3)
    for slow in (1.0, 4.0, 4.0):
        turns.add(np.array([1.0, 2.0, 3.0]) * slow, 0)
    for _ in range(20):
        turns.add(np.array([1.0, 2.0, np.nan]), 1)
    np.testing.assert_allclose(turns.medians(), [1.0, 2.0, 3.0])


def test_medians_leave_out_what_was_not_measured() -> None:
    values = np.array([[1.0, np.nan, 5.0], [np.nan, np.nan, 7.0], [3.0, np.nan, 6.0]])
    np.testing.assert_array_equal(medians(values), [2.0, np.nan, 6.0])


def test_draws_are_those_of_the_seed() -> None:
    turns = Turns.of_lists(np.random.default_rng(2).lognormal(0, 0.3, (4, 9)).tolist())
    np.testing.assert_array_equal(turns.resampled(20, 5), turns.resampled(20, 5))
    assert (turns.resampled(20, 5) != turns.resampled(20, 6)).any()


FAST, ROBUST, PRECISE, EXACT = (Candidate(k, 100) for k in range(4))


@pytest.mark.parametrize(
    ("costs", "candidates", "expected"),
    [
        # The rung by its errors: stricter ones are not weighed, however little they cost.
        ([1.0, 1.0], [PRECISE, EXACT], 0),
        ([1.0, 0.9, 2.0], [Candidate(1, 100, fits=False), EXACT, PRECISE], 2),
        # Fast has to pay.
        ([1.0 - 1.1 * FAST_PAYS, 1.0, 1.0], [FAST, ROBUST, EXACT], 0),
        ([1.0 - 0.9 * FAST_PAYS, 1.0, 1.0], [FAST, ROBUST, EXACT], 1),
        ([9.0], [FAST], 0),
        # Of points of a rung: fewer bytes, the simpler layout, the density nearer to auto's, the first.
        ([1.0, 1.0 + 1.1 * MARGIN], [ROBUST, Candidate(1, 90)], 0),
        # By the margin of points beside its rung's fastest, not beside that of all.
        ([0.9, 1.0, 1.09], [FAST, ROBUST, Candidate(1, 90)], 2),
        ([1.0, 1.05], [ROBUST, Candidate(1, 90)], 1),
        ([1.0, 1.05], [Candidate(1, 100, simplicity=1), ROBUST], 1),
        ([1.0, 1.05], [Candidate(1, 100, off_auto=1.0), ROBUST], 1),
        ([1.0, 1.05], [ROBUST, ROBUST], 0),
        # What is too wrong or too large is not taken, nor what was never measured.
        ([1.0, 3.0], [Candidate(0, 100, fits=False), ROBUST], 1),
        ([float("nan"), 3.0], [ROBUST, FAST], 1),
        ([1.0], [Candidate(0, 100, fits=False)], None),
    ],
)
def test_the_order_of_the_choice(
    costs: list[float], candidates: list[Candidate], expected: int | None
) -> None:
    assert choose_by(np.array(costs), candidates) == expected


def test_within_a_time_the_least_error_is_taken() -> None:
    candidates = [Candidate(0, 100, error=3.0), Candidate(1, 100), Candidate(2, 100), Candidate(3, 100)]
    costs = np.array([1.0, 2.0, 3.0, 4.0])
    for most, expected in ((4.0, 3), (3.5, 2), (1.5, 0), (0.5, None)):
        assert choose_by(costs, candidates, most, least_error=True) == expected
    assert choose_by(costs, candidates, 3.5) == 0  # fast pays


def test_an_answer_that_hangs_on_one_turn_is_a_near_thing() -> None:
    small = Candidate(1, 90)
    sure = choose(Turns.of_lists([[1.0] * 9, [1.5] * 9]), [ROBUST, small])
    assert (sure.point, sure.support, sure.rival) == (0, 1.0, None)
    # Five turns of nine say that the second is within the margin.
    near = choose(Turns.of_lists([[1.0] * 9, [1.14] * 5 + [1.18] * 4]), [ROBUST, small])
    assert near.point == 1
    assert near.rival == 0
    assert 0.5 < near.support < 0.9
    none = choose(Turns.of_lists([[1.0] * 3]), [Candidate(0, 1, fits=False)])
    assert (none.point, none.support, none.rival) == (None, 1.0, None)


def test_points_with_few_turns_are_not_taken_by_chance() -> None:
    turns = Turns.of_lists([[1.0] * 5, [0.8] * 5])
    assert choose(turns, [ROBUST, ROBUST]).point == 1
    assert choose(turns, [ROBUST, ROBUST], among=[0]).point == 0


def test_what_is_chosen_keeps_to_the_time_by_all_turns() -> None:
    seconds = [[1.0, 1.0, 1.0, 1.0, 1.0], [1.9, 1.9, 2.05, 2.05, 2.05]]
    found = choose(Turns.of_lists(seconds), [FAST, ROBUST], 2.0, least_error=True)
    assert found.point == 0
    assert found.rival == 1


def test_the_front() -> None:
    costs, errors, nbytes = [1.0, 2.0, 2.1, 3.0, 9.0, 2.0], [5.0, 0.0, 0.0, 0.0, 0.0, 5.0], [9, 9, 5, 9, 1, 9]
    # Second: within the margin of the third, which has fewer bytes. The fourth and the last gain nothing.
    assert front(costs, errors, nbytes) == [0, 2, 4]


def test_noise_within_the_margin_does_not_change_the_front() -> None:
    errors, nbytes = [2.0, 1.0, 1.0, 0.0, 0.0], [10, 10, 8, 10, 8]
    rng = np.random.default_rng(3)
    fronts = {
        tuple(sorted(front(costs, errors, nbytes)))
        for costs in (np.array([1.0, 1.5, 1.52, 2.0, 2.5]) * rng.uniform(0.97, 1.03, (50, 5))).tolist()
    }
    assert fronts == {(0, 2, 3, 4)}


def test_what_is_off_the_front_pushes_nothing_off() -> None:
    step = 1 + 0.9 * MARGIN
    # The second is within the margin of the first, the third of the second alone.
    assert front([step**3, step**2, step, 1.0], [0.0] * 4, [1, 2, 3, 4]) == [2, 0]


# Noise that a busy machine makes: factors of the true seconds, by draw and by turn.
def quiet(rng: RNG, turn: int) -> float:
    return float(rng.normal(1, 0.02))


def spikes(rng: RNG, turn: int) -> float:
    return float(rng.normal(1, 0.02)) * (4.0 if rng.random() < 0.15 else 1.0)


def slow_half(rng: RNG, turn: int) -> float:
    return float(rng.normal(1, 0.03)) * (2.0 if (turn // 3) % 2 else 1.0)


def drift(rng: RNG, turn: int) -> float:
    return float(rng.normal(1, 0.03)) * (1 + 0.1 * turn)


def heavy_tail(rng: RNG, turn: int) -> float:
    return 1 + 0.05 * float(rng.pareto(1.5))


RUNGS = (0.7, 1.0, 1.08, 1.3)
# By layout and density: seconds, bytes. The fastest has 8 bytes; one within the margin has 5.
GRIDS = ((1.3, 3), (1.04, 5), (1.0, 8), (1.2, 13), (1.7, 2), (1.45, 4), (1.3, 7), (1.5, 11))


class Machine:
    """Points that take known times, on a clock of its own."""

    def __init__(self, noise: Callable[[RNG, int], float], seed: int, slow: tuple[int, ...] = ()) -> None:
        self.now, self.measured = 0.0, [0] * (len(RUNGS) * len(GRIDS))
        self.candidates = [
            Candidate(rung, nbytes, fits=rung > 0, grid=nbytes)
            for rung in range(len(RUNGS))
            for _, nbytes in GRIDS
        ]
        self._seconds = [0.05 * rung * grid for rung in RUNGS for grid, _ in GRIDS]
        for point in slow:
            self._seconds[point] *= 4
        self._noise, self._rng = noise, np.random.default_rng(seed)
        self.contest = Contest(self.candidates, self.measure, clock=lambda: self.now)

    def measure(self, point: int) -> float:
        taken = self._seconds[point] * self._noise(self._rng, len(self.contest.turns.costs))
        self.now += taken
        self.measured[point] += 1
        return taken


@pytest.mark.parametrize("noise", [quiet, spikes, slow_half, drift, heavy_tail])
def test_every_run_recommends_the_same_point(noise: Callable[[RNG, int], float]) -> None:
    # Robust is the first rung that fits; of its grids the second has fewer bytes than the third, and takes
    # 1.04 of its time.
    expected = len(GRIDS) + 1
    for seed in range(3):
        machine = Machine(noise, seed)
        found = machine.contest.run(60.0)
        assert (noise.__name__, seed, found.point) == (noise.__name__, seed, expected)
        assert found.support > 0.8


def test_repetitions_go_to_the_contenders() -> None:
    machine = Machine(spikes, 0)
    found = machine.contest.run(60.0)
    assert found.point is not None
    assert min(machine.measured) == 1 + TURNS
    assert machine.measured[found.point] >= FEWEST_LAST_TURNS
    often = [count for count in machine.measured if count > FEWEST_LAST_TURNS]
    assert FEW <= len(often) <= FEW + OF_RUNG * len(RUNGS)
    assert max(machine.measured) <= MOST_TURNS + 2 * TURNS
    # The fastest of each rung is among them, the one that does not fit too.
    for rung in range(len(RUNGS)):
        assert machine.measured[rung * len(GRIDS) + 2] > FEWEST_LAST_TURNS


def test_grids_that_are_slow_on_every_rung_have_one_turn() -> None:
    # The first grid is slow on all rungs, the fourth on one: that may have been chance.
    first, fourth = [tuple(rung * len(GRIDS) + grid for rung in range(len(RUNGS))) for grid in (0, 3)]
    machine = Machine(quiet, 0, slow=(*first, fourth[1]))
    machine.contest.run(60.0)
    assert {machine.measured[point] for point in first} == {1}
    assert min(machine.measured[point] for point in fourth) > 1


def test_a_short_time_is_kept() -> None:
    machine = Machine(quiet, 0)
    machine.contest.run(3.0)
    assert min(machine.measured) >= 1
    # A turn of all takes 2.2 s, and each stage has one; the last has more where there is time.
    assert machine.now < 10.0
    assert max(machine.measured) == 3 + LEAST_TURNS


def test_the_order_of_a_turn_changes_from_turn_to_turn() -> None:
    order: list[int] = []
    contest = Contest([FAST] * 6, lambda point: order.append(point) or 1.0, clock=lambda: 0.0)
    contest.run(1.0)
    rounds = {tuple(order[k : k + 6]) for k in range(0, len(order), 6)}
    assert len(rounds) > FEWEST_LAST_TURNS / 2
    assert all(sorted(each) == list(range(6)) for each in rounds)
