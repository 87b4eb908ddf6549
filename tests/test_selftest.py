"""The start-up self-test: its digests without a device, its refusals, its memory."""

from __future__ import annotations

import math
import shutil
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import oracle
import planted
import precise_twin
import pytest

import clgrid
from clgrid import cache, procedural, program, rational, selftest
from clgrid.closed import open_edges
from clgrid.device import Device
from clgrid.doctor import Finding, trial
from clgrid.errors import DeviceError
from clgrid.hits import Hits
from clgrid.mesh import Mesh
from clgrid.rungs import RUNGS

F64 = npt.NDArray[np.float64]
OF = selftest.mesh()
ORIGINS, DIRECTIONS = selftest.rays(OF)


def hits(t: F64, ids: npt.NDArray[np.int64], uvs: npt.NDArray[Any]) -> Hits:
    return Hits(t, ids, 0, OF, ORIGINS, DIRECTIONS, {"primitive_uvs": uvs})


def leading(value: Fraction) -> tuple[float, int]:
    """Twin of ``leading`` in cl/big.h: the first 64 digits, rounded to a double, and their exponent."""
    numerator, bits = abs(value.numerator), abs(value.numerator).bit_length()
    top = numerator >> (bits - 64) if bits > 64 else numerator << (64 - bits)
    return float(top), bits - 64 - (value.denominator.bit_length() - 1)


def quotient(a: Fraction, b: Fraction) -> float:
    """Twin of ``quotient`` in cl/big.h, for a and b that are integers times powers of two."""
    if a == 0:
        return 0.0
    (x, above), (y, below) = leading(a), leading(b)
    return math.copysign(1.0, a * b) * math.ldexp(x / y, above - below)


def cross(p: list[Any], q: list[Any]) -> list[Any]:
    return [p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]]


def dot(p: list[Any], q: list[Any]) -> Any:
    return p[0] * q[0] + p[1] * q[1] + p[2] * q[2]


def from_integers(corners: F64, origin: F64, direction: F64) -> tuple[float, float, float]:
    """T, u, v of a crossing that integers decide."""
    d = [Fraction(x) for x in direction.tolist()]
    p = [
        [Fraction(x) - Fraction(o) for x, o in zip(c, origin.tolist(), strict=True)] for c in corners.tolist()
    ]
    edges = [dot(d, cross(p[(i + 1) % 3], p[(i + 2) % 3])) for i in range(3)]
    under = sum(edges, Fraction(0))
    return quotient(dot(p[0], cross(p[1], p[2])), under), quotient(edges[1], under), quotient(edges[2], under)


def crossing_twin(corners: F64, origin: F64, direction: F64) -> tuple[float, float, float, bool]:
    """Twin of ``crosses`` in cl/triangle_exact.h, local t: t, u, v, and whether the filter decided."""
    z = int(np.argmax(np.abs(direction)))
    x, y = (z + 1) % 3, (z + 2) % 3
    if direction[z] < 0:
        x, y = y, x
    sx, sy, sz = direction[x] / direction[z], direction[y] / direction[z], 1.0 / direction[z]
    pz = corners[:, z] - origin[z]
    (ax, bx, cx) = (corners[:, x] - origin[x]) - sx * pz
    (ay, by, cy) = (corners[:, y] - origin[y]) - sy * pz
    u, v, w = cx * by - cy * bx, ax * cy - ay * cx, bx * ay - by * ax
    det = (u + v) + w
    doubt = 2.0**-46 * max(map(abs, (ax, ay, bx, by, cx, cy))) + 2.0**-95
    # No triangle is seen so nearly edge-on that the error of t decides.
    assert abs(det) > 1e-3
    if min(abs(u), abs(v), abs(w)) <= doubt:
        return *from_integers(corners, origin, direction), False
    return ((u / det * pz[0] + v / det * pz[1]) + w / det * pz[2]) * sz, v / det, w / det, True


@pytest.fixture(scope="module")
def crossings() -> list[list[rational.Crossing]]:
    triangles = OF.vertices[OF.faces]
    lines = [rational.crossings(triangles, o, d) for o, d in zip(ORIGINS, DIRECTIONS, strict=True)]
    return [[crossing for crossing in line if crossing.t >= 0] for line in lines]


def test_about_a_thousand_rays_from_within_a_closed_convex_mesh(
    crossings: list[list[rational.Crossing]],
) -> None:
    assert 1000 <= len(ORIGINS) <= 1200
    assert open_edges(OF) == 0
    assert {len(line) for line in crossings} == {1}
    # Most go exactly to a vertex or a point of an edge: the two or more triangles there are as near.
    vertices = OF.vertices[OF.faces]
    touched = [_touched(vertices, o, d) for o, d in zip(ORIGINS, DIRECTIONS, strict=True)]
    assert sum(number >= 2 for number in touched) == 3 * (42 + 240)


def _touched(corners: npt.NDArray[np.float32], origin: F64, direction: F64) -> int:
    """How many triangles have the end of the ray in their plane and on their border or inside, exactly."""
    end = [Fraction(o) + Fraction(d) for o, d in zip(origin.tolist(), direction.tolist(), strict=True)]
    about = origin + direction
    near = ((corners.min(1) <= about + 1e-6) & (corners.max(1) >= about - 1e-6)).all(axis=1)
    return sum(_holds([[Fraction(x) for x in p] for p in c.tolist()], end) for c in corners[near])


def _holds(triangle: list[list[Fraction]], point: list[Fraction]) -> bool:
    a, b, c = triangle
    n = cross([q - p for p, q in zip(a, b, strict=True)], [q - p for p, q in zip(a, c, strict=True)])
    sides = [
        dot(
            n,
            cross([y - x for x, y in zip(p, q, strict=True)], [y - x for x, y in zip(p, point, strict=True)]),
        )
        for p, q in ((a, b), (b, c), (c, a))
    ]
    return dot(n, [y - x for x, y in zip(a, point, strict=True)]) == 0 and min(sides) >= 0


def test_robust_is_what_the_numpy_twin_says() -> None:
    frame, vertices = oracle.local_mesh(OF)
    twin = oracle.closest(oracle.prepare_rays(ORIGINS, DIRECTIONS, frame), vertices, OF.faces)
    assert (twin.ids >= 0).all()
    assert selftest.digest(hits(twin.t_hit, twin.ids, twin.uvs)) == selftest.EXPECTED["robust"]


def test_precise_is_what_the_numpy_twin_says() -> None:
    twin = precise_twin.closest(OF, ORIGINS, DIRECTIONS)
    assert (twin.ids >= 0).all()
    assert selftest.digest(hits(twin.t_hit, twin.ids, twin.uvs)) == selftest.EXPECTED["precise"]


def test_exact_is_what_rational_arithmetic_says(crossings: list[list[rational.Crossing]]) -> None:
    frame, _ = oracle.local_mesh(OF)
    assert not frame.offset.any()
    ids = np.array([line[0].id for line in crossings])
    t, uvs, certain = np.zeros(len(ids)), np.zeros((len(ids), 2)), 0
    for i, id_ in enumerate(ids.tolist()):
        unit = 2.0 ** -int(np.frexp(np.abs(DIRECTIONS[i]).max())[1])
        local = OF.vertices[OF.faces[id_]].astype(np.float64) * 2.0**-frame.exponent
        at, u, v, decided = crossing_twin(local, ORIGINS[i] * 2.0**-frame.exponent, DIRECTIONS[i] * unit)
        t[i], uvs[i] = at * 2.0**frame.exponent * unit, (u, v)
        certain += decided
        assert abs(Fraction(t[i]) - crossings[i][0].t) <= 2.0**-48
    # Both ways of deciding are tested.
    assert 100 < certain < len(ids) - 100
    assert selftest.digest(hits(t, ids, uvs)) == selftest.EXPECTED["exact"]


class Recorded:
    """A grid whose answers are spoilt."""

    def __init__(self, grid: clgrid.Grid, miss: int = 0, count: int = 1, ulp: bool = False) -> None:
        self.grid, self.miss, self.number, self.ulp = grid, miss, count, ulp

    def cast(self, origins: npt.ArrayLike, directions: npt.ArrayLike) -> Hits:
        found = self.grid.cast(origins, directions)
        found.primitive_ids[: self.miss] = -1
        if self.ulp:
            found.t_hit[7] = np.nextafter(found.t_hit[7], 0)
        return found

    def count(self, origins: npt.ArrayLike, directions: npt.ArrayLike) -> npt.NDArray[np.uint32]:
        counts = self.grid.count(origins, directions)
        counts[3] = self.number
        return counts


@pytest.fixture
def fresh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """No memory of earlier tests."""
    monkeypatch.setattr(cache, "folder", lambda: tmp_path / "clgrid")
    monkeypatch.setattr(selftest, "_passed", set())
    return tmp_path / "clgrid"


def told(device: Device) -> list[Finding]:
    """What the doctor says without testing again."""
    compiled = Finding("compile", "ok", device.label, "")
    found = list(trial.verdicts(device.description, compiled, run=False, progress=None))
    return list(trial.findings(device.description, found))


@pytest.mark.parametrize("rung", ["robust", pytest.param("exact", marks=pytest.mark.slow)])
def test_what_is_wrong_is_said(rung: str, device: Device) -> None:
    grid = clgrid.build(OF, accuracy=rung, density=selftest.DENSITY, device=device)
    assert selftest.fault(grid, OF, rung) == ""
    assert selftest.fault(Recorded(grid, miss=2), OF, rung) == "2 of 1086 rays escape from a closed mesh"
    assert "bits" in selftest.fault(Recorded(grid, ulp=True), OF, rung)
    crossed = selftest.fault(Recorded(grid, count=2), OF, rung)
    assert crossed == ("1 of 1086 rays do not cross a convex mesh once" if rung == "exact" else "")


def test_a_device_with_other_bits_is_refused_in_one_line(
    device: Device, fresh: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(selftest.EXPECTED, "robust", "0123456789abcdef")
    for _ in range(2):  # a refusal is not taken back by asking again
        with pytest.raises(DeviceError) as caught:
            clgrid.build(procedural.cube(), device=device)
        message = str(caught.value)
        assert message.startswith(f"{device.label}: refused for accuracy 'robust'")
        assert "clgrid devices" in message
        assert "\n" not in message
    assert "bits" in str(selftest.remembered(device.description, "robust"))
    [finding] = [finding for finding in told(device) if finding.status == "fail"]
    assert (finding.check, finding.device) == ("selftest", device.label)
    assert "refused for robust" in finding.message
    assert finding.advice
    monkeypatch.undo()
    clgrid.build(procedural.cube(), device=device)


def test_a_success_is_remembered_on_disk(
    device: Device, fresh: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []
    examine = selftest.fault

    def watched(*arguments: Any) -> str:
        asked.append(arguments[2])
        return examine(*arguments)

    monkeypatch.setattr(selftest, "fault", watched)
    assert selftest.remembered(device.description, "robust") is None
    clgrid.build(procedural.cube(), device=device)
    clgrid.build(procedural.icosphere(1), device=device)
    assert asked == ["robust"]
    assert selftest.remembered(device.description, "robust") == ""
    monkeypatch.setattr(selftest, "_passed", set())  # another process
    clgrid.build(procedural.cube(), device=device)
    assert asked == ["robust"]
    for file in fresh.glob("selftest-*"):
        file.write_text("{damaged")
    monkeypatch.setattr(selftest, "_passed", set())
    clgrid.build(procedural.cube(), device=device)
    assert asked == ["robust"] * 2


def test_a_crash_in_the_test_is_found_by_the_doctor(device: Device, fresh: Path) -> None:
    def crash(of: Mesh) -> Any:
        raise KeyboardInterrupt  # the process is gone

    with pytest.raises(KeyboardInterrupt):
        selftest.require(device, RUNGS["precise"], crash)
    [finding] = [finding for finding in told(device) if finding.status == "fail"]
    assert "refused for precise: it never ended" in finding.message


def test_a_test_that_cannot_run_is_no_success(device: Device, fresh: Path) -> None:
    def fail(of: Mesh) -> Any:
        raise DeviceError("does not compile")

    for _ in range(2):
        with pytest.raises(DeviceError, match="does not compile"):
            selftest.require(device, RUNGS["robust"], fail)
    assert selftest.remembered(device.description, "robust") == "does not compile"


def test_the_doctor_says_what_passed_and_what_never_ran(device: Device, fresh: Path) -> None:
    fast, later = told(device)
    assert (fast.status, later.status) == ("ok", "ok")
    assert "may run fast: it promises nothing" in fast.message
    assert "may run robust, precise, exact: its self-test has not run yet" in later.message
    clgrid.build(procedural.cube(), device=device)
    _, passed, later = told(device)
    assert (passed.status, later.status) == ("ok", "ok")
    assert "may run robust: its self-test gives the bits" in passed.message
    assert "may run precise, exact: its self-test has not run yet" in later.message


@pytest.fixture
def loose(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Kernels whose edge functions are contracted, as a compiler does that ignores FP_CONTRACT OFF."""
    folder = tmp_path / "cl"
    shutil.copytree(program.source_folder(), folder)
    for name, text in planted.fused_edges().items():
        (folder / name).write_text(text, encoding="utf-8")
    monkeypatch.setattr(program, "source_folder", lambda: folder)
    program._digest.cache_clear()
    yield folder
    program._digest.cache_clear()


def test_a_device_that_contracts_products_is_refused(device: Device, fresh: Path, loose: Path) -> None:
    with pytest.raises(DeviceError, match="refused for accuracy 'robust'"):
        clgrid.build(procedural.cube(), device=device)


def test_an_empty_mesh_needs_no_test(device: Device, fresh: Path) -> None:
    clgrid.build(Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint32)), device=device)
    assert selftest.remembered(device.description, "robust") is None
