"""Records of every kind that reports are for, small and made up, with names that no page may trust."""

from __future__ import annotations

import msgspec
import numpy as np

from clgrid.compare_record import (
    CompareDevice,
    ComparePair,
    CompareRays,
    CompareRecord,
    CompareRow,
    DifferingRay,
    HeatMap,
    ImageDifferences,
    RayDifferences,
)
from clgrid.driver_record import ArithmeticRecord, DriverRecord, SpeedRecord
from clgrid.record import (
    BenchRecord,
    DeviceRecord,
    Failure,
    FrameMedians,
    FrameRow,
    FramesRecord,
    Header,
    HostRecord,
    RayKind,
    RenderRecord,
    Row,
    WorkloadRecord,
    WorkloadRow,
    schema,
)
from clgrid.tradeoff_record import (
    DistanceErrors,
    LeftOut,
    Need,
    PictureErrors,
    RayErrors,
    Recommendation,
    ReferenceCheck,
    Spread,
    TradeoffRecord,
    TradeoffRow,
)
from clgrid.verify_record import FailedRay, VerifyRecord, VerifyRow

UNTRUSTED = "</script><img src=x onerror=alert(1)>\"'&.ply"
ROW_ONLY = Failure("s", "e")
INTEL = DeviceRecord("AMD EPYC", "2026.22", "Intel(R) OpenCL")
POCL = DeviceRecord("pthread-AMD EPYC", "3.0-rc2", "Portable Computing Language")


HOST = HostRecord(
    processor="AMD EPYC", cores=2, system="Linux 6.1", memory=24 << 30, versions={"Python": "3.11.7"}
)


def times(middle: float, count: int = 5, seed: int = 0) -> list[float]:
    """Repetitions within two per cent of a time."""
    spread = np.random.default_rng(seed).uniform(0.98, 1.02, count)
    return [middle * float(each) for each in spread]


def header(verb: str, device: DeviceRecord = INTEL) -> dict[str, object]:
    return {
        "schema": schema(verb), "clgrid": "0.1.0", "device": device, "compiled": ("render.cl -DX=1",),
        "seeds": {"rays": 3}, "command": ("clgrid", verb, UNTRUSTED), "host": HOST,
    }  # fmt: skip


def row(scene: str = UNTRUSTED, **changes: object) -> Row:
    build, render = times(0.2, seed=1), times(0.3, seed=2)
    made = Row(
        scene=scene, triangles=871_414, layout="compact", accuracy="robust", density=4.0,
        resolution=(90, 80, 70),
        references=2_000_000, empty_share=0.9, load_factor=0.0,
        nbytes={"cells": 2_000_004, "references": 8_000_000},
        parts=1, grid_bytes=10_000_004, bytes_per_triangle=11.5, peak_bytes=30_000_000, load_s=[0.5],
        first_compile_s=[1.5], build_s=build, build_stages_s={"count": times(0.12), "bin": times(0.02)},
        render_s=render, time_to_image_s=[a + b for a, b in zip(build, render, strict=True)], width=640,
        height=480,
        rays=307_200, hits=123_456, device="intel",
    )  # fmt: skip
    return msgspec.structs.replace(made, **changes)


def bench(*rows: Row, device: DeviceRecord = INTEL) -> BenchRecord:
    return BenchRecord(
        **header("bench", device), process_peak_bytes=1 << 29,
        rows=[*(rows or (row(), row("b/other.ply")))],
        failures=[Failure("bad.ply", "bad.ply: truncated")],
    )  # fmt: skip


def picture() -> RenderRecord:
    return RenderRecord(**header("render"), row=row(), outputs=(UNTRUSTED,), save_s={"x.png": 0.1})


def workload() -> WorkloadRecord:
    kinds = [
        RayKind(kind=kind, rays=1000, hits=700, steps_per_ray=12.5, cast_s=times(0.01), mrays_per_s=0.1)
        for kind in ("primary", "shadow")
    ]
    made = WorkloadRow(
        scene=UNTRUSTED, triangles=100, workload="shadow", bounces=0, layout="compact", accuracy="robust",
        density=4.0,
        resolution=(5, 5, 5), references=300, grid_bytes=2000, bytes_per_triangle=20.0, peak_bytes=9000,
        width=32,
        height=32, eye=(0.0, 0.5, 2.0), skipping=False, kinds=kinds, rays=2000, hits=1400,
        steps_per_ray=12.5,
        cast_s=times(0.02), mrays_per_s=0.1, checked=100, differing=0, differing_share=0.0, device="intel",
    )  # fmt: skip
    return WorkloadRecord(**header("bench.workload"), process_peak_bytes=None, rows=[made], failures=[])


def frames() -> FramesRecord:
    rows = [
        FrameRow(
            frame=k, resolution=(5, 5, 5), references=300 + k, grid_bytes=2000, peak_bytes=9000,
            build_s=times(0.01 + k),
            render_s=times(0.1), time_to_image_s=times(0.11 + k), hits=50,
        )
        for k in range(4)
    ]  # fmt: skip
    return FramesRecord(
        **header("bench.frames"), process_peak_bytes=1 << 28, scene=UNTRUSTED, frames="f.npy",
        frames_bytes=4800,
        triangles=100, vertices=50, layout="compact", accuracy="robust", width=32, height=32, rays=1024,
        load_s=[0.1],
        first_compile_s=[1.0], rows=rows,
        medians=FrameMedians(build_s=1.5, render_s=0.1, time_to_image_s=1.6),
    )  # fmt: skip


def verify(escapes: int = 0) -> VerifyRecord:
    failed = FailedRay(
        check="escapes", rays=escapes, kind="from inside", origin=(0.0, 0.0, 0.0),
        direction=(1.0, 0.0, 0.0),
        found="a miss", expected="a hit",
    )  # fmt: skip
    rows = [
        VerifyRow(
            accuracy=accuracy, resolution=(5, 5, 5), references=300, grid_bytes=2000, rays=1000, hits=600,
            inside=250,
            escapes=escapes if accuracy == "robust" else 0, odd_lines=0, even_inside=0, checked=1000,
            bits=0, counts=0,
            exact_checked=100, wrong_hits=1, wrong_ids=2, wrong_counts=3, exact_hits=50, late=0,
            worst_ulps=3.5,
            worst_share=0.2, median_share=0.01,
            broken=("escapes",) if escapes and accuracy == "robust" else (),
            first=[failed] if escapes and accuracy == "robust" else [],
        )
        for accuracy in ("robust", "exact")
    ]  # fmt: skip
    return VerifyRecord(
        **header("verify"), scene=UNTRUSTED, triangles=100, open_edges=0, layout="compact", density="auto",
        skipping=False, kinds={"from inside": 250}, rows=rows,
    )  # fmt: skip


def compare(differing: int = 0) -> CompareRecord:
    devices = [_device("intel", INTEL, 1.0), _device("pocl-3.0", POCL, 1.7), _crashed()]
    pairs = [_pair("robust", differing, True), _pair("fast", 17, False)]
    return CompareRecord(
        **header("compare"),
        accuracies=("robust", "fast"), width=640, height=480, rays=1000, time_limit=60.0, devices=devices,
        pairs=pairs, failures=[],
    )  # fmt: skip


def _device(label: str, device: DeviceRecord, slower: float) -> CompareDevice:
    widths = dict.fromkeys(("char", "short", "int", "long", "float", "double"), 16)
    return CompareDevice(
        label=label, device=device, units=2, limited_by="", status="completed", reason="", last_words="",
        step="",
        seconds=[12.0 * slower],
        driver=DriverRecord(
            type="CPU", version="OpenCL 3.0", c_version="OpenCL C 1.2", compute_units=2,
            global_memory=20 << 30,
            max_allocation=8 << 30, local_memory=1 << 20, fp64=True,
            correctly_rounded_divide=label == "intel",
            denormals=True, preferred_widths=widths, native_widths=widths, note="",
        ),
        arithmetic=[
            ArithmeticRecord(
                type="float8", operands=4096, wrong_quotients=0, wrong_roots=0, quotient_ulps=0,
                root_ulps=0,
                contracted="always" if label != "intel" else "never", contracted_when_forbidden="never",
                mad="once",
                fma="once", denormals_read="kept", denormals_made="kept",
            )
        ],
        speed=SpeedRecord(
            launches=100, launch_s=times(0.002 * slower), copied_bytes=1 << 26, copy_s=times(0.01 * slower),
            upload_s=times(0.02), download_s=times(0.02),
        ),
        compiled=(), process_peak_bytes=1 << 29,
        rows=[_work(accuracy, slower) for accuracy in ("robust", "fast")],
        failures=[],
    )  # fmt: skip


def _work(accuracy: str, slower: float) -> CompareRow:
    kinds = [
        CompareRays(
            kind=kind, rays=count, hits=count // 2, cast_s=times(0.1 * slower), mrays_per_s=3.0, digest="ab"
        )
        for kind, count in (
            ("primary", 307_200),
            ("shadow", 153_600),
            ("incoherent", 153_600),
            ("structured", 1000),
        )
    ]
    return CompareRow(
        scene=UNTRUSTED, triangles=871_414, accuracy=accuracy, layout="compact", skipping=False,
        density=4.0,
        resolution=(90, 80, 70), cells=504_000, references=2_000_000, parts=1, nbytes={"cells": 2_000_004},
        grid_bytes=10_000_004, bytes_per_triangle=11.5, peak_bytes=30_000_000, load_s=[0.5],
        first_compile_s=[1.5],
        build_s=times(0.2 * slower), build_stages_s={"count": times(0.1 * slower)},
        grid_digests={"cells": "cd"},
        kinds=kinds, render_s=times(0.3 * slower), image_hits=123_456, image_digest="ef", self_test="",
    )  # fmt: skip


def _crashed() -> CompareDevice:
    return CompareDevice(
        label="pocl-3.1", device=POCL, units=2, limited_by="", status="crashed", reason="ended by signal 6",
        last_words="LLVM ERROR: Cannot select <b>", step="build robust", seconds=[3.0], driver=None,
        arithmetic=[],
        speed=None, compiled=(), process_peak_bytes=None, rows=[], failures=[],
    )  # fmt: skip


def _pair(accuracy: str, differing: int, promised: bool) -> ComparePair:
    rays = [
        RayDifferences(
            kind=kind, rays=count, differing=differing, id=differing // 2, t=differing, u=0, v=0,
            only_first=differing // 4, only_second=0, t_ulps=3.0 if differing else 0.0, u_ulps=0.0,
            v_ulps=0.0,
        )
        for kind, count in (("primary", 307_200), ("shadow", 153_600))
    ]  # fmt: skip
    image = ImageDifferences(
        pixels=307_200, differing=differing, ids=differing // 2, largest=0.2 if differing else 0.0,
        mean=1e-6 if differing else 0.0, psnr=61.0 if differing else None,
        perceptual=1e-5 if differing else 0.0,
        largest_perceptual=0.3 if differing else 0.0, measure="FLIP",
    )  # fmt: skip
    heat = np.zeros((48, 64))
    heat[20:28, 30:44] = np.random.default_rng(1).integers(0, 4, (8, 14))
    first = DifferingRay(
        kind="primary", index=42, origin=("0x0p+0",) * 3, direction=("0x1p+0",) * 3, t_min="0x0p+0",
        t_max="inf",
        differs=("t",), first="triangle 5, t 1.5", second="triangle 5, t 1.5000001",
    )  # fmt: skip
    return ComparePair(
        scene=UNTRUSTED, accuracy=accuracy, first="intel", second="pocl-3.0", promised=promised,
        equal=not differing,
        grids=True, arrays=(), references=(2_000_000, 2_000_000), rays=rays, image=image,
        heat_map=HeatMap(
            width=64, height=48, block=10, rays=[int(each) for each in heat.ravel()],
            image=[float(each) / 10 for each in heat.ravel()],
        ) if differing else None,
        ray=first if differing else None,
    )  # fmt: skip


def tradeoff() -> TradeoffRecord:
    rows = [
        _point(number, accuracy, layout, density)
        for number, (accuracy, layout, density) in enumerate(
            (accuracy, layout, density)
            for accuracy in ("fast", "robust", "precise", "exact")
            for layout in ("compact", "hashed", "nested")
            for density in (1.0, 4.0)
        )
    ]
    return TradeoffRecord(
        **header("tradeoff"), scene=UNTRUSTED, source=UNTRUSTED, triangles=871_414, size=12.5,
        max_rounding=1e-7,
        width=640, height=480, eye=(0.0, 1.0, 3.0), clock="wall", auto_layout="nested", auto_density=4.0,
        aim=(90, 80, 70), rays=100_000, confidence=0.95, margin=0.03, fast_pays=0.2,
        methods={"front": "nothing is better in all"},
        budget_s=120.0, load_s=[0.5], first_compile_s=[2.0], spent_s={"errors": [20.0, 21.0]},
        need=Need(
            measure="pixels", max_error=1e-6, max_time_s=None, max_memory=None, frames=1, rebuild=False,
            stated=True
        ),
        rows=rows,
        left_out=[LeftOut(accuracy="exact", layout="compact", density=32.0, samples=None, reason="large")],
        reference=ReferenceCheck(asked=2000, rays=2000, wrong=0, wrong_most=0.0015, late=0, rational_s=[9.0]),
        slowness=[1.0] * 5,
        front=[5, 11],
        recommendation=Recommendation(
            row=11, support=0.98, rival=10, sentence="Take robust, nested, density 4.", proven=True
        ),
        nearest="", broken=[], process_peak_bytes=1 << 29,
    )  # fmt: skip


def _point(number: int, accuracy: str, layout: str, density: float) -> TradeoffRow:
    rung = ("fast", "robust", "precise", "exact").index(accuracy)
    middle = (0.3, 0.5, 0.6, 0.65)[rung] * {"compact": 1.0, "hashed": 1.2, "nested": 0.8}[layout]
    middle *= 1.0 if density == 4 else 1.25
    wrong = 9 + number if accuracy == "fast" else 0
    build, render = times(0.4 * middle, seed=number), times(0.6 * middle, seed=number + 50)
    whole = [a + b for a, b in zip(build, render, strict=True)]
    hits = DistanceErrors(
        hits=60_000,
        median_ulps=0.3,
        p999_ulps=1.5,
        worst_ulps=4.0,
        median=1e-8,
        p999=1e-7,
        worst=3e-7,
        floor=0.0,
    )
    errors = [
        RayErrors(
            kind=kind, reference="exact rung", rays=100_000, hits=60_000, missed=wrong, false_hits=0,
            wrong_triangles=2 * wrong, missed_most=3e-5 + wrong * 2e-5, false_hits_most=3e-5,
            wrong_triangles_most=3e-5 + wrong * 3e-5, distance=hits,
        )
        for kind in ("camera", "structured")
    ]  # fmt: skip
    return TradeoffRow(
        accuracy=accuracy, layout=layout, density=density, samples=None, resolution=(90, 80, 70),
        references=2_000_000,
        grid_bytes=int(1e7 * {"compact": 1.0, "hashed": 0.45, "nested": 1.3}[layout] * density),
        bytes_per_triangle=11.5,
        peak_bytes=30_000_000, turns=[0, 1, 2, 3, 4], build_s=build, render_s=render, time_to_image_s=whole,
        cost_s=Spread(median=middle, low=min(whole), high=max(whole)),
        picture=PictureErrors(
            pixels=307_200, other_triangles=wrong, other_share=wrong / 307_200,
            other_share_most=(wrong + 3) / 307_200,
            largest=0.3 if wrong else 0.0, rms=1e-4 if wrong else 0.0, psnr=70.0 if wrong else None,
        ),
        errors=errors, errors_of=6 * rung if rung else number, error=wrong / 307_200,
        error_most=(wrong + 3) / 307_200,
        refused=["error"] if wrong else [], on_front=number in (4, 5, 8, 11), verify="clgrid verify scene",
    )  # fmt: skip


def every() -> dict[str, Header]:
    """One of each kind, with something to find in each."""
    return {
        "bench": bench(), "render": picture(), "workload": workload(), "frames": frames(),
        "verify": verify(3),
        "compare": compare(5), "tradeoff": tradeoff(),
    }  # fmt: skip
