"""Where two devices part on a ray: traces, planted differences, sides that fail."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
import planted
import pytest

from clgrid import program
from clgrid.device import Device
from clgrid.errors import DeviceError, InputError
from clgrid.frame import LocalFrame
from clgrid.grid import untested
from clgrid.layouts.lists import NESTED
from clgrid.locate import Side, child, locate, setting
from clgrid.locate.arithmetic import CORRECT, names_of
from clgrid.locate.difference import Audit, audit
from clgrid.locate.stages import BOOL, stages_of
from clgrid.locate.trace import Record, records, trace
from clgrid.mesh import Mesh
from clgrid.program import source_folder
from clgrid.rays import as_bounded_rays
from clgrid.recipe import Recipe
from clgrid.repro_record import KERNEL, NONE, OPERATION, ReproGrid, ReproRay
from clgrid.rungs import LOSSLESS

BALL = planted.MESH
FAR = Mesh(BALL.vertices.astype(np.float64) * 3.3 + np.array([1000.1, 0.3, -7.7]), BALL.faces)
# From within, along an axis, from afar, at a vertex, past the mesh.
RAYS = [
    ((0.01, 0.02, 0.03), (0.3, -0.2, 1.0)),
    ((0.01, 0.02, 0.03), (0.0, 0.0, -2.0)),
    ((100.3, 20.1, -33.0), (-100.0, -20.0, 33.1)),
    ((0.0, 0.0, 0.0), tuple(BALL.vertices[5].astype(float).tolist())),
    ((3.0, 3.0, 3.0), (1.0, 0.0, 0.0)),
]


@dataclass
class Traced:
    trace: list[Record]
    audit: Audit
    hit: tuple[int, float]


def traced(device: Device, mesh: Mesh, asked: ReproGrid, origin: object, direction: object) -> Traced:
    recipe = Recipe(asked.layout, asked.density, asked.resolution, asked.accuracy, None, asked.skipping)
    grid = untested(mesh, device, recipe)
    o, d = np.array(origin, np.float64), np.array(direction, np.float64)
    words = trace(grid.target, grid.standing[0], as_bounded_rays(o[None], d[None], 0.0, np.inf))
    found = list(records(words, stages_of(asked.accuracy, nested=asked.layout in NESTED)))
    planes = child.planes_of(recipe, grid.standing[0])
    audited = audit(found, setting.Setting.of(mesh, asked, ReproRay.of(o, d), planes, None))
    hits = grid.cast(o[None], d[None])
    return Traced(found, audited, (int(hits.primitive_ids[0]), float(hits.t_hit[0])))


CASES = [
    ("robust", "compact", False),
    ("precise", "hashed", False),
    ("exact", "nested", False),
    *(
        pytest.param(*case, marks=pytest.mark.slow)
        for case in (
            ("robust", "compact", True),
            ("robust", "nested-hashed", False),
            ("robust", "linked-list", False),
            ("robust", "dynamic-array", False),
        )
    ),
]


@pytest.mark.thorough
@pytest.mark.parametrize(("accuracy", "layout", "skipping"), CASES)
def test_a_trace_ends_at_the_hit_of_the_cast_and_each_operation_is_as_the_table_says(
    device: Device, accuracy: str, layout: str, skipping: bool
) -> None:
    asked = ReproGrid(layout=layout, accuracy=accuracy, resolution=(5, 4, 6), skipping=skipping)
    for mesh, scale, shift in ((BALL, 1.0, 0.0), (FAR, 3.3, np.array([1000.1, 0.3, -7.7]))):
        checked = []
        for origin, direction in RAYS:
            o, d = np.array(origin) * scale + shift, np.array(direction) * scale
            seen = traced(device, mesh, asked, o, d)
            number, t_hit = seen.trace[-1].bits[:2]
            assert (number if number != 0xFFFFFFFF else -1, t_hit) == (
                seen.hit[0],
                int(np.float64(seen.hit[1]).view(np.uint64)),
            )
            assert (seen.audit.off, seen.audit.off_as) == (0, ())
            checked.append(seen.audit.checked)
        assert min(checked[:4]) > 30
        assert checked[4] < 30


def constant(name: str, value: str) -> float:
    text = "".join(
        (source_folder() / file).read_text() for file in ("config.h", "walk.h", "triangle_precise.h")
    )
    found = re.findall(rf"^#define {name}\s+(.+)$", text, re.MULTILINE)
    assert value in found, name
    return float(eval(re.sub(r"0x1p([+-]\d+)f?", r"2.0**\1", value.replace("UNIT_ROUNDOFF", "2.0**-24"))))


def test_names_and_numbers_are_those_of_the_kernels() -> None:
    text = (source_folder() / "trace.h").read_text()
    numbers = {int(n) for n in re.findall(r"^#define STAGE_\w+ (\d+)u$", text, re.MULTILINE)}
    assert numbers == set(stages_of("exact", nested=False))
    written = {
        "START_LIMIT": "2.0",
        "ENTRY_CUBE": "1.5",
        "T_SLACK": "(32 * UNIT_ROUNDOFF)",
        "SMALLEST_CLIMB": "0x1p-200",
        "SMALLEST_EDGE": "0x1p-80f",
        "SMALLEST_PRODUCT": "0x1p-900",
        "TICKS": "0x1p+54",
        "MOST_TICKS": "0x1p+57",
    }
    for name, value in written.items():
        assert setting.CONSTANTS[name][0] == constant(name, value)


@pytest.mark.parametrize("rung", LOSSLESS)
def test_operations_name_only_what_is_known_before_them(rung: str) -> None:
    known = set(setting.CONSTANTS) | {f"{p}_k{a}" for p in "abc" for a in "xyz"}
    known |= {
        f"{row}_{a}"
        for row in ("caller_origin", "caller_direction", "offset", "lower", "upper")
        for a in "xyz"
    }
    known |= {f"{row}_{a}" for row in ("cell_size", "cells") for a in "xyz"}
    known |= {"scale", "inverse_scale", "first_factor", "second_factor", "t_min", "t_max"}
    for stage in stages_of(rung, nested=False).values():
        for value in stage.values:
            if not value.operation.startswith(":"):
                assert set(names_of(value.operation)) <= known, (stage.name, value.name)
            known.add(value.name)
            if value.name == "kz":
                known |= {f"{row}_k{a}" for row in ("origin", "direction") for a in "xyz"}


def test_frames_of_setting_are_those_of_the_mesh() -> None:
    asked = ReproGrid(layout="compact", accuracy="precise", resolution=(2, 3, 4))
    planes = child.Planes((0.0,) * 3, (1.0,) * 3, (0.5, 0.25, 0.125), (2, 3, 4))
    of = setting.Setting.of(FAR, asked, ReproRay.of((0, 0, 0), (0, 0, 3)), planes, None)
    frame = LocalFrame.of_bounds(FAR.bounds)
    assert float(of.constants["offset_x"].value) == frame.offset[0]
    assert float(of.constants["scale"].value) == 2.0**-frame.exponent
    assert float(of.constants["second_factor"].value) == 0.25
    assert "t_max" not in of.constants
    corner = of.corners(7, (2, 0, 1))["b_kx"]
    assert (corner.type, float(corner.value)) == (
        "double",
        frame.to_local_wide(FAR.vertices)[FAR.faces[7, 1], 2],
    )
    assert of.cell_at(1 + 2 * 1 + 6 * 3) == (1, 1, 3)
    assert of.cell_at(24) is None


@pytest.mark.slow
@pytest.mark.thorough
def test_contraction_is_located_told_and_counted(device: Device) -> None:
    located = planted.found(device, planted.aimed(planted.CONTRACTED_RAY), planted.contracted()).located
    first = located.difference
    assert located.kind == OPERATION
    assert first is not None
    assert (first.nearest, CORRECT in first.first_as) == ("first", True)
    assert planted.CONTRACTION in first.second_as
    clean, other = located.sides
    assert clean.off == 0
    assert other.off > 10
    assert planted.CONTRACTION in other.off_as
    assert planted.CONTRACTION in located.where
    assert list(other.kernels) == ["config.h"]
    assert all("CLGRID_KERNELS=" in line for line in other.compiled if line.startswith(("cast", "trace")))
    assert not any("CLGRID_KERNELS=" in line for line in clean.compiled)
    assert clean.alone != other.alone


@pytest.mark.thorough
def test_contracted_edge_functions_are_located_in_cell_and_triangle(device: Device) -> None:
    located = planted.missed(device.label).located
    first, decision = located.difference, located.decision
    assert first is not None
    assert first.stage == "triangle"
    assert first.operation in ("u = cx * by - cy * bx", "v = ax * cy - ay * cx", "w = bx * ay - by * ax")
    assert (first.type, first.nearest) == ("float", "first")
    assert planted.CONTRACTION in first.second_as
    assert first.cell_at is not None
    assert first.cell == first.cell_at[0] + 8 * (first.cell_at[1] + 8 * first.cell_at[2])
    assert first.triangle is not None
    assert f"triangle {first.triangle} in cell " in located.where
    assert len(first.inputs) == 4
    assert first.steps == ()
    # The answer changes, and where is said.
    assert located.sides[0].alone != located.sides[1].alone
    assert decision is not None
    assert decision.type in (BOOL, "course", "triangle")


@pytest.mark.thorough
def test_another_shear_constant_is_located_before_any_cell(device: Device) -> None:
    located = planted.found(device, planted.aimed(planted.SHEAR_RAY), planted.wrong()).located
    first = located.difference
    assert first is not None
    assert (first.stage, first.value, first.cell, first.triangle) == ("shear", "sx", None, None)
    assert first.operation == "sx = float(double(direction_kx) / double(direction_kz))"
    assert first.nearest == "first"
    assert "a product with a reciprocal in float32 in place of a quotient" in first.second_as
    assert first.ulps == 1


@pytest.mark.thorough
def test_what_no_trace_shows_is_told_as_the_kernels_own(device: Device) -> None:
    # Of small integers, so that no product is rounded, and contraction changes nothing.
    corners = np.array([[-4, -4, 2], [4, -4, 2], [0, 4, 2]], np.float32)
    mesh = Mesh(corners, np.arange(3, dtype=np.uint32).reshape(1, 3))
    located = planted.found(device, ReproRay.of((0.5, 0.25, -1), (0, 0, 1)), planted.wrong(), mesh).located
    assert (located.kind, located.difference, located.differing) == (KERNEL, None, 0)
    one, other = located.sides
    assert float.fromhex(other.alone.t) == 2 * float.fromhex(one.alone.t)
    assert "cast_closest.cl" in located.where
    assert "another compilation" in located.where
    assert (one.traced, other.traced) == (one.alone, one.alone)
    assert located.where.endswith("rays_in_out.h not what its trace has")


def test_devices_agree(all_devices: list[Device]) -> None:
    one, other = (Side(device.label) for device in all_devices[:2])
    located = locate(BALL, planted.GRID, planted.aimed(planted.EDGES_RAY), (one, other)).located
    assert (located.kind, located.difference, located.differing) == (NONE, None, 0)
    assert [side.off for side in located.sides] == [0, 0]
    assert located.sides[0].alone == located.sides[1].alone == located.sides[0].together
    assert "agree" in located.where
    assert located.sides[0].traced == located.sides[0].alone


def test_a_side_that_fails_is_told_in_one_line(device: Device) -> None:
    good, ray = Side(device.label), planted.aimed(0)
    with pytest.raises(DeviceError, match="no OpenCL device matches 'no such device'"):
        locate(BALL, planted.GRID, ray, (good, Side("no such device")))
    with pytest.raises(DeviceError, match="takes more than 0 s") as caught:
        locate(BALL, planted.GRID, ray, (good, good), timeout=0.01)
    assert "\n" not in str(caught.value)
    broken = Side(device.label, kernels={"trace_ray.cl": "#error of its own\n"})
    with pytest.raises(DeviceError, match=r"trace_ray\.cl does not compile"):
        locate(BALL, planted.GRID, ray, (good, broken))
    with pytest.raises(InputError, match="no name of a kernel source"):
        locate(BALL, planted.GRID, ray, (good, Side(device.label, kernels={"../x.h": ""})))


def test_a_side_whose_process_dies_is_told(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    from clgrid import probe

    code = "import os, sys; sys.stderr.write('the driver gave up\\n'); os.abort()"
    monkeypatch.setattr(probe, "child_command", lambda *words: [__import__("sys").executable, "-c", code])
    with pytest.raises(DeviceError, match=r"killed by SIGABRT\): the driver gave up"):
        locate(BALL, planted.GRID, planted.aimed(0), (Side(device.label), Side(device.label)))


def test_what_promises_nothing_is_not_located() -> None:
    fast = ReproGrid(layout="compact", accuracy="fast", resolution=(2, 2, 2))
    with pytest.raises(InputError, match="fast promises no bits"):
        locate(BALL, fast, planted.aimed(0), (Side("a"), Side("b")))
    empty = Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint32))
    with pytest.raises(InputError, match="no triangles"):
        locate(empty, planted.GRID, planted.aimed(0), (Side("a"), Side("b")))


def test_a_trace_that_is_none_is_refused() -> None:
    table = stages_of("robust", nested=False)
    for words in ([7], [13, 0], [(3 << 32) | 6, 0, 1, 2]):
        with pytest.raises(DeviceError, match="no trace"):
            list(records(np.array(words, np.uint64), table))


def test_options_and_kernels_of_this_process_are_taken_along(
    monkeypatch: pytest.MonkeyPatch, tmp_path
) -> None:
    for path in source_folder().iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    (tmp_path / "light.h").write_text("// another\n")
    monkeypatch.setattr(program, "source_folder", lambda: tmp_path)
    monkeypatch.setattr(program, "build_options", lambda: ("-Da=1", "-Db"))
    side = Side.here("intel")
    assert side == Side("intel", "-Da=1 -Db", {"light.h": "// another\n"})
