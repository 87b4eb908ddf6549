from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import msgspec
import numpy as np
import pytest

from clgrid.record import (
    BenchRecord,
    DeviceRecord,
    Failure,
    Row,
    decode,
    encode,
    process_peak_bytes,
    schema,
)

ROW = Row(
    scene="s",
    triangles=3,
    layout="compact",
    accuracy="robust",
    density=4.0,
    resolution=(2, 3, 4),
    references=5,
    empty_share=0.5,
    load_factor=0.0,
    nbytes={"cells": 20, "references": 12},
    parts=1,
    grid_bytes=100,
    bytes_per_triangle=100 / 3,
    peak_bytes=300,
    load_s=[0.1],
    first_compile_s=[],
    build_s=[0.25, 0.5],
    build_stages_s={"count": [0.1, 0.2]},
    render_s=[1.0, 2.0],
    time_to_image_s=[1.25, 2.5],
    width=8,
    height=4,
    rays=32,
    hits=7,
    device="intel",
)
RECORD = BenchRecord(
    schema=schema("bench"),
    clgrid="0.1.0",
    device=DeviceRecord("n", "d", "p"),
    compiled=("render.cl -DAOV_ID=1",),
    rows=[ROW],
    process_peak_bytes=12345,
    failures=[Failure("bad.ply", "bad.ply: truncated")],
)


def test_records_come_back_as_they_were():
    assert decode(encode(RECORD), BenchRecord) == RECORD


def test_rows_carry_the_fields_that_were_promised():
    row = json.loads(encode(RECORD))["rows"][0]
    promised = (
        "scene triangles layout density resolution references build_s render_s time_to_image_s grid_bytes"
        " bytes_per_triangle rays hits device"
    )
    assert set(promised.split()) <= set(row)
    assert row["build_s"] == [0.25, 0.5]


def test_headers_carry_the_fields_that_were_promised():
    document = json.loads(encode(RECORD))
    assert {"schema", "clgrid", "device", "compiled", "seeds", "process_peak_bytes"} <= set(document)
    assert document["schema"] == "clgrid.bench/1"
    assert set(document["device"]) == {"name", "driver", "platform"}


@pytest.mark.parametrize(
    "change",
    [
        lambda d: d.update(extra=1),
        lambda d: d["rows"][0].update(extra=1),
        lambda d: d.pop("device"),
        lambda d: d["rows"][0].update(build_s=0.25),
        lambda d: d["rows"][0].update(triangles="3"),
        lambda d: d["rows"][0].update(resolution=[1, 2]),
    ],
)
def test_a_record_that_strays_from_the_schema_is_refused(change):
    document = json.loads(encode(RECORD))
    change(document)
    with pytest.raises(msgspec.ValidationError):
        decode(json.dumps(document), BenchRecord)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows does not say what a process held")
def test_a_process_counts_its_own_memory_and_not_its_parents():
    held = np.ones(300 << 20, np.uint8)
    mine = process_peak_bytes()
    assert mine is not None
    assert mine > held.nbytes
    code = "from clgrid.record import process_peak_bytes; print(process_peak_bytes())"
    root = Path(__file__).parent.parent
    done = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=True)
    assert 1 << 20 < int(done.stdout) < held.nbytes
    assert process_peak_bytes() >= mine
