"""Two runs compared: noise is told from change, rows are matched, and what is planted is found."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import numpy as np
import pytest
import report_records as made

from clgrid.errors import InputError
from clgrid.record import BenchRecord, Header
from clgrid.report.difference import compare, regressions
from clgrid.report.difference_record import BETTER, OTHER, SAME, UNJUDGED, WORSE, DifferenceRecord
from clgrid.report.entries import SCHEMAS, Entry
from clgrid.report.match import match
from clgrid.report.noise import FASTER, SLOWER, band, change
from clgrid.report.read import KINDS, Run
from clgrid.tradeoff.intervals import CONFIDENCE

with_ = msgspec.structs.replace


def against(first: Header, second: Header, **options: float) -> DifferenceRecord:
    return compare(Run.of(first, "a.json"), Run.of(second, "b.json"), **options)


def verdicts(result: DifferenceRecord, *wanted: str) -> set[str]:
    return {each.field for each in result.findings if each.verdict in wanted}


# Noise


@pytest.mark.parametrize("count", [6, 9, 20])
def test_bands_hold_the_median_as_often_as_they_say(count: int) -> None:
    drawn = np.random.default_rng(count).lognormal(size=(4000, count))
    bands = [band(list(each)) for each in drawn]
    held = np.mean([each.low <= 1.0 <= each.high for each in bands])
    assert bands[0].confidence >= CONFIDENCE
    assert abs(held - bands[0].confidence) < 0.012


def test_bands_of_many_repetitions_are_narrower_than_all_of_them() -> None:
    assert (band([3.0, 1.0, 2.0]).low, band([3.0, 1.0, 2.0]).high) == (1.0, 3.0)
    found = band([float(k) for k in range(20)])
    assert (found.low, found.high, found.median) == (5.0, 14.0, 9.5)
    assert band([1.0]).confidence == 0.0


def test_equal_runs_are_rarely_told_apart_and_slower_ones_nearly_always() -> None:
    rng = np.random.default_rng(4)
    same = [change(list(a), list(b), 0.0, 0.25).verdict for a, b in rng.lognormal(0, 0.05, (2000, 2, 5))]
    assert sum(each != SAME for each in same) < 0.02 * len(same)
    slower = [
        change(list(a), list(1.5 * b), 0.1, 0.25).verdict for a, b in rng.lognormal(0, 0.05, (200, 2, 5))
    ]
    assert slower.count(SLOWER) > 195
    assert change([3.0] * 5, [2.0] * 5, 0.1, 0.25).verdict == FASTER


def test_a_change_counts_beyond_the_threshold_only() -> None:
    first, second = made.times(1.0, 9, 1), made.times(1.07, 9, 2)
    assert change(first, second, 0.10, 0.25).verdict == SAME
    assert change(first, second, 0.05, 0.25).verdict == SLOWER


def test_single_repetitions_are_judged_by_the_default_and_said_to_be() -> None:
    near, far = change([1.0], [1.2], 0.1, 0.25), change([1.0], [1.3], 0.1, 0.25)
    assert (near.verdict, near.known, far.verdict, far.known) == (SAME, False, SLOWER, False)
    assert change([1.0], [1.2], 0.1, 0.15).verdict == SLOWER


# Whole records


@pytest.mark.parametrize("kind", list(made.every()))
def test_a_record_against_itself_has_nothing_to_say(kind: str) -> None:
    record = made.every()[kind]
    result = against(record, record)
    assert verdicts(result, WORSE, BETTER, OTHER) == set()
    assert (result.circumstances, result.only_first, result.only_second) == ([], [], [])
    assert result.matched > 0
    assert msgspec.json.decode(msgspec.json.encode(result), type=DifferenceRecord) == result


def test_every_kind_that_is_read_has_rows() -> None:
    assert set(SCHEMAS) == set(KINDS) == {record.schema for record in made.every().values()}


def slowed(field: str, factor: float) -> BenchRecord:
    row = made.row()
    return made.bench(with_(row, **{field: [factor * each for each in getattr(row, field)]}))


def test_planted_slowness_is_found_where_it_is_and_nowhere_else() -> None:
    base = made.bench(made.row())
    assert verdicts(against(base, slowed("render_s", 1.3)), WORSE, BETTER) == {"render_s"}
    result = against(base, slowed("render_s", 0.7))
    assert verdicts(result, BETTER) == {"render_s"}
    assert regressions(result) == []
    assert regressions(against(base, slowed("render_s", 1.03))) == []
    assert regressions(against(base, slowed("render_s", 1.3), threshold=0.5)) == []


def test_what_caches_decide_is_not_judged() -> None:
    base = made.bench(made.row())
    for field in ("load_s", "first_compile_s"):
        result = against(base, slowed(field, 50.0))
        assert field in verdicts(result, UNJUDGED)
        assert regressions(result) == []


def test_a_stage_counts_for_what_it_is_of_the_whole() -> None:
    base = made.row()

    def stages(bin_: float) -> BenchRecord:
        times = {"count": base.build_stages_s["count"], "bin": [bin_ * t for t in base.build_stages_s["bin"]]}
        return made.bench(with_(base, build_stages_s=times))

    # Of 200 ms, "bin" takes 20.
    assert regressions(against(stages(1.0), stages(1.5))) == []
    assert verdicts(against(stages(1.0), stages(3.0)), WORSE) == {"build_stages_s.bin"}


@pytest.mark.parametrize(
    ("changes", "worse"),
    [
        ({"grid_bytes": 10_000_005}, {"grid_bytes"}),
        ({"grid_bytes": 10_000_003}, set()),
        ({"hits": 123_457}, {"hits"}),
        ({"references": 1_999_999}, set()),
        # Another grid: its bytes are its own.
        ({"grid_bytes": 12_000_000, "resolution": (90, 80, 71)}, set()),
        ({"hits": 123_457, "resolution": (90, 80, 71)}, {"hits"}),
        ({"bytes_per_triangle": 99.0, "load_factor": 0.5}, set()),
    ],
)
def test_counts_and_bytes_are_compared_exactly(changes: dict[str, object], worse: set[str]) -> None:
    base = made.row()
    assert verdicts(against(made.bench(base), made.bench(with_(base, **changes))), WORSE) == worse


def test_the_rung_fast_promises_no_hits() -> None:
    base = made.row(accuracy="fast")
    result = against(made.bench(base), made.bench(with_(base, hits=1)))
    assert (verdicts(result, WORSE), verdicts(result, OTHER)) == (set(), {"hits"})


@pytest.mark.parametrize(
    ("kind", "change", "field"),
    [
        ("verify", lambda: made.verify(4), "escapes"),
        ("compare", lambda: made.compare(6), "differing"),
    ],
)
def test_faults_that_grow_are_regressions(kind: str, change: Callable[[], Header], field: str) -> None:
    result = against(made.every()[kind], change())
    assert field in verdicts(result, WORSE)
    assert field in verdicts(against(change(), made.every()[kind]), BETTER)


def test_samples_of_two_sizes_are_not_judged() -> None:
    base = made.tradeoff()
    row = base.rows[6]
    errors = [with_(each, rays=50_000, hits=30_000, missed=7) for each in row.errors]
    other = with_(base, rows=[*base.rows[:6], with_(row, errors=errors), *base.rows[7:]])
    result = against(base, other)
    assert verdicts(result, WORSE) == set()
    assert {"hits", "missed", "rays"} <= verdicts(result, OTHER)
    same_size = [with_(each, missed=7) for each in row.errors]
    worse = with_(base, rows=[*base.rows[:6], with_(row, errors=same_size), *base.rows[7:]])
    assert verdicts(against(base, worse), WORSE) == {"missed"}


def test_devices_may_differ_on_fast() -> None:
    base = made.compare()
    more = made.compare(9).pairs[0]
    other = with_(base, pairs=[base.pairs[0], with_(more, accuracy="fast", promised=False)])
    result = against(base, other)
    assert (verdicts(result, WORSE), "differing" in verdicts(result, OTHER)) == (set(), True)


def test_another_digest_is_a_fault_within_a_version_and_a_change_between_two() -> None:
    base = made.compare()
    device = base.devices[0]
    row = with_(device.rows[0], image_digest="other")
    other = with_(base, devices=[with_(device, rows=[row, *device.rows[1:]]), *base.devices[1:]])
    assert verdicts(against(base, other), WORSE) == {"image_digest"}
    assert verdicts(against(base, with_(other, clgrid="0.2.0")), WORSE) == set()


# Circumstances and matching


def test_what_the_runs_do_not_share_is_named() -> None:
    first = made.bench(made.row(), made.row("only/in_a.ply"))
    second = with_(made.bench(made.row(), made.row("only/in_b.ply"), device=made.POCL), seeds={"rays": 4})
    result = against(first, with_(second, clgrid="0.2.0"))
    said = {each.name: (each.first, each.second) for each in result.circumstances}
    assert said["driver"] == ("2026.22", "3.0-rc2")
    assert said["clgrid"] == ("0.1.0", "0.2.0")
    assert said["seed of rays"] == ("3", "4")
    assert (result.only_first, result.only_second) == (["in_a.ply"], ["in_b.ply"])


def test_two_machines_are_told_apart() -> None:
    base = made.compare()
    other = with_(base, host=with_(base.host, processor="another", versions={"Python": "3.12"}))
    assert {each.name for each in against(base, other).circumstances} == {"processor", "Python"}


def entry(**words: object) -> Entry:
    marks = {name: words.pop(name) for name in ("device", "density") if name in words}
    return Entry(dict(words), marks)


def test_rows_are_matched_across_devices_only_where_each_run_has_one() -> None:
    one, two = entry(scene="s", device="a"), entry(scene="s", device="b")
    assert len(match([one], [two]).pairs) == 1
    several = match([one, two], [two, entry(scene="s", device="c")])
    assert [label for label, _, _ in several.pairs] == ["s, b"]
    assert (several.only_first, several.only_second) == (["s, a"], ["s, c"])


def test_rows_are_told_apart_by_as_few_marks_as_do() -> None:
    first = [entry(scene="s", device="a", density=density) for density in (1.0, 2.0)]
    second = [entry(scene="s", device="b", density=density) for density in (2.0, 4.0)]
    found = match(first, second)
    assert [(label, a.marks["density"]) for label, a, _ in found.pairs] == [("s, density 2", 2.0)]
    twice = match([entry(scene="s"), entry(scene="s")], [entry(scene="s")])
    assert (len(twice.pairs), twice.only_first) == (1, ["s, number 2"])


def test_folders_of_scenes_do_not_matter_and_their_triangles_do() -> None:
    first, second = made.bench(made.row("/here/s.ply")), made.bench(made.row("C/there/s.ply"))
    assert against(first, second).matched == 1
    with pytest.raises(InputError, match="no row in common"):
        against(first, made.bench(made.row("/here/s.ply", triangles=5)))


def test_records_of_two_kinds_are_refused() -> None:
    with pytest.raises(InputError, match=r"a\.json is a record of clgrid\.bench/1, b\.json one of clg"):
        against(made.bench(), made.verify())
