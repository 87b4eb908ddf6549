"""The fit of the cost model's constants: what it finds, what it keeps, what it does when it cannot."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from clgrid import cache, calibrate
from clgrid.calibrate import Kind, Measured
from clgrid.device import Device
from clgrid.errors import GridTooLargeError
from clgrid.grid import build
from clgrid.procedural import icosphere
from clgrid.tiles import division_of

COMPACT, HASHED = ("compact", False), ("hashed", False)
CASTS = [(layout, skip) for layout in ("compact", "hashed") for skip in (False, True)]
START = calibrate.typical(COMPACT).build
AMOUNTS = np.array(
    [
        [1, 12, 96, 48],
        [1, 131072, 230000, 65536],
        [1, 131072, 380000, 524288],
        [1, 131072, 620000, 2097152],
        [1, 16384, 160000, 8192],
        [1, 16384, 330000, 65536],
    ],
    np.float64,
)


def fitted_alone(measured: Measured) -> list[float]:
    """Constants of a build, of one kind by itself."""
    (found,) = calibrate.fit([measured], [START])
    return found


@pytest.fixture
def empty_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache folder with nothing in it, and nothing remembered."""
    monkeypatch.setattr(cache, "folder", lambda: tmp_path)
    monkeypatch.setattr(calibrate, "_known", {})
    return tmp_path


@pytest.fixture
def measured(monkeypatch: pytest.MonkeyPatch) -> list[list[Kind]]:
    """What was measured, by instruments that need no device."""
    calls: list[list[Kind]] = []

    def measure(device: Device, kinds: Sequence[Kind]) -> dict[Kind, tuple[Measured, Measured]]:
        calls.append(list(kinds))
        casts = np.array([[30000, 4e5, 1e6], [30000, 1e6, 3e5], [30000, 2e6, 1e5]])
        return {
            kind: (
                Measured(AMOUNTS, 2 * AMOUNTS @ np.array(START)),
                Measured(casts, casts @ np.array(calibrate.typical(COMPACT).cast)),
            )
            for kind in kinds
        }

    monkeypatch.setattr(calibrate, "measure", measure)
    return calls


def forget(monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a new process."""
    monkeypatch.setattr(calibrate, "_known", {})


@pytest.mark.parametrize("speed", [1e-3, 1, 50])
def test_a_device_that_is_typical_but_for_its_speed_is_found(speed: float) -> None:
    fitted = fitted_alone(Measured(AMOUNTS, speed * AMOUNTS @ np.array(START)))
    np.testing.assert_allclose(fitted, speed * np.array(START), rtol=1e-6)


def test_another_mixture_is_found_from_its_seconds() -> None:
    truth = np.array([1e-3, 6e-9, 3e-8, 1e-9])
    fitted = fitted_alone(Measured(AMOUNTS, AMOUNTS @ truth))
    np.testing.assert_allclose(AMOUNTS @ np.array(fitted), AMOUNTS @ truth, rtol=0.25)
    assert fitted[0] > 1.5 * START[0]
    assert fitted[3] > 1.5 * START[3]


def test_noise_does_not_derail_the_fit() -> None:
    rng = np.random.default_rng(5)
    for _ in range(50):
        noisy = AMOUNTS @ np.array(START) * (1 + 0.3 * rng.random(len(AMOUNTS)))
        fitted = np.array(fitted_alone(Measured(AMOUNTS, noisy)))
        ratio = (AMOUNTS @ fitted) / (AMOUNTS @ np.array(START))
        assert (ratio > 0.8).all()
        assert (ratio < 1.5).all()


def test_constants_stay_in_a_sane_range() -> None:
    rng = np.random.default_rng(6)
    for _ in range(50):
        seconds = 10.0 ** rng.uniform(-6, 2, len(AMOUNTS))
        fitted = np.array(fitted_alone(Measured(AMOUNTS, seconds))) / np.array(START)
        assert (fitted > 0).all()
        assert fitted.max() / fitted.min() <= 100 * (1 + 1e-9)


@pytest.mark.parametrize("wrong", [0.0, -1.0, np.nan, np.inf])
def test_a_clock_that_gives_nonsense_is_refused(wrong: float) -> None:
    seconds = AMOUNTS @ np.array(START)
    seconds[2] = wrong
    with pytest.raises(ArithmeticError, match="clock"):
        fitted_alone(Measured(AMOUNTS, seconds))


def test_fitted_once_then_read(
    device: Device, empty_cache: Path, measured: list[list[Kind]], monkeypatch: pytest.MonkeyPatch
) -> None:
    first = calibrate.constants(device, [COMPACT])
    assert calibrate.constants(device, [COMPACT]) == first
    assert len(list(empty_cache.iterdir())) == 1
    forget(monkeypatch)
    assert calibrate.constants(device, [COMPACT]) == first
    assert measured == [[COMPACT]]
    assert first[COMPACT].source.startswith(f"fitted on {device.label}")
    assert str(empty_cache) in first[COMPACT].source


def test_what_is_compared_is_measured_together(
    device: Device, empty_cache: Path, measured: list[list[Kind]], monkeypatch: pytest.MonkeyPatch
) -> None:
    calibrate.constants(device, [COMPACT])
    calibrate.constants(device, [COMPACT, HASHED])
    forget(monkeypatch)
    calibrate.constants(device, [COMPACT, HASHED])
    calibrate.constants(device, [HASHED])
    assert measured == [[COMPACT], [COMPACT, HASHED]]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        "{}",
        json.dumps({"build": [1e-3, 1e-8, 1e-8], "cast": [1e-7, 1e-9, 1e-9]}),
        json.dumps({"build": [1e-3, 1e-8, -1e-8, 1e-9], "cast": [1e-7, 1e-9, 1e-9]}),
        json.dumps({"build": [1e-3, 1e-8, "x", 1e-9], "cast": [1e-7, 1e-9, 1e-9]}),
        json.dumps({"build": [1e-3, 1e-8, 1e-8, 1e-9], "cast": [1e-7, float("inf"), 1e-9]}),
        json.dumps({"build": [1e-3, 1e-8, 1e-8, 1e-9]}),
    ],
)
def test_damaged_and_foreign_files_are_fitted_anew(
    text: str,
    device: Device,
    empty_cache: Path,
    measured: list[list[Kind]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found = calibrate.constants(device, [COMPACT])
    (file,) = empty_cache.iterdir()
    sound = file.read_text(encoding="utf-8")
    file.write_text(text, encoding="utf-8")
    forget(monkeypatch)
    assert calibrate.constants(device, [COMPACT]) == found
    assert measured == [[COMPACT]] * 2
    assert file.read_text(encoding="utf-8") == sound


def test_other_kernels_and_layouts_have_files_of_their_own(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = {
        calibrate.cache_name(device, layout, skipping)
        for layout in ("compact", "hashed", "linked-list", "dynamic-array")
        for skipping in (False, True)
    }
    assert len(names) == 8
    monkeypatch.setattr(calibrate, "source_digest", lambda file: f"other {file}")
    assert calibrate.cache_name(device, *COMPACT) not in names


def test_where_the_fit_fails_typical_constants_say_why(
    device: Device, empty_cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise GridTooLargeError("no room")

    monkeypatch.setattr(calibrate, "measure", fail)
    found = calibrate.constants(device, [COMPACT, ("hashed", True)])
    assert found[COMPACT].build == calibrate.typical(COMPACT).build
    assert found["hashed", True].cast == calibrate.typical(("hashed", True)).cast
    assert "typical" in found[COMPACT].source
    assert "no room" in found[COMPACT].source
    assert list(empty_cache.iterdir()) == []


def test_a_cache_that_cannot_be_written_costs_time_alone(
    device: Device, measured: list[list[Kind]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(cache, "folder", lambda: tmp_path / "file" / "below")
    forget(monkeypatch)
    found = calibrate.constants(device, [COMPACT])
    np.testing.assert_allclose(found[COMPACT].build, 2 * np.array(START), rtol=1e-6)
    forget(monkeypatch)
    assert calibrate.constants(device, [COMPACT]) == found
    assert len(measured) == 2


def test_scenes_are_built_and_cast_and_counted(device: Device) -> None:
    kinds = [COMPACT, ("compact", True)]
    found = calibrate.measure(device, kinds)
    (built, casts), (leaping_built, leaping) = (found[kind] for kind in kinds)
    assert built.amounts.shape == (8, 4)
    assert casts.amounts.shape == (8, 5)
    for one in (built, casts, leaping_built, leaping):
        assert np.isfinite(one.seconds).all()
        assert (one.seconds > 0).all()
    np.testing.assert_array_equal(built.amounts, leaping_built.amounts)
    # The same lists are met; steps are fewer.
    np.testing.assert_array_equal(casts.amounts[:, [0, 1, 2, 4]], leaping.amounts[:, [0, 1, 2, 4]])
    assert leaping.amounts[:, 3].sum() < casts.amounts[:, 3].sum() / 2
    scene = calibrate.mountains()
    stats = build(scene, density=4, device=device).stats
    assert built.amounts[3].tolist() == [1, stats.triangles, stats.references, stats.cells]
    # Unknowns can be told apart.
    assert np.linalg.matrix_rank(built.amounts) == 4
    assert np.linalg.matrix_rank(casts.amounts) == 5


def test_slow_rays_of_one_mesh_are_not_held_against_its_cells() -> None:
    rng = np.random.default_rng(7)
    rays = 1e5 * np.eye(2)[[0, 0, 0, 1, 1, 1]]
    measured = {}
    for kind in CASTS:
        amounts = np.concatenate([rays, rng.uniform(1e5, 4e6, (6, 2))], axis=1)
        ray, cell, reference = calibrate.typical(kind).cast
        casts = Measured(amounts, amounts @ np.array([ray, 4 * ray, cell, reference]))
        measured[kind] = (Measured(AMOUNTS, AMOUNTS @ np.array(calibrate.typical(kind).build)), casts)
    found = calibrate.fit_all(measured, "here")
    for kind, constants in found.items():
        np.testing.assert_allclose(constants.build, calibrate.typical(kind).build, rtol=1e-6)
        np.testing.assert_allclose(constants.cast[1:], calibrate.typical(kind).cast[1:], rtol=0.25)
        assert constants.cast[0] > 1.1 * calibrate.typical(kind).cast[0]
        assert constants.source == "here"


def test_what_no_layout_changes_has_one_constant_for_all() -> None:
    rng = np.random.default_rng(8)
    measured = {
        kind: (
            Measured(AMOUNTS, AMOUNTS @ np.array(START) * rng.uniform(1, 1.3, 6)),
            Measured(1e6 * rng.uniform(1, 9, (6, 3)), rng.uniform(1e-3, 2e-3, 6)),
        )
        for kind in CASTS
    }
    found = calibrate.fit_all(measured, "here").values()
    assert len({constants.build[1] for constants in found}) == 1
    assert len({constants.cast[0] for constants in found}) == 1
    assert len({constants.build[2] for constants in found}) == len(CASTS)
    assert len({constants.cast[1] for constants in found}) == len(CASTS)


def test_rays_come_in_tiles_of_a_large_picture(device: Device) -> None:
    for mesh in (calibrate.mountains(), icosphere(4)):
        rays = calibrate.view(mesh)
        assert division_of(rays).row == rays.directions.shape[1]
        middle = mesh.bounds.mean(axis=0)
        across = np.linalg.norm(rays.directions - (middle - rays.origins), axis=-1)
        assert across.max() == pytest.approx(np.linalg.norm(np.ptp(mesh.bounds, axis=0)) / 2**0.5, rel=0.1)
        hits = build(mesh, density=4, device=device).cast(rays.origins, rays.directions)
        assert 0.1 < hits.mask.mean() < 0.9
