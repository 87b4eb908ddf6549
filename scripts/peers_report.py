"""Tables, record and ratios of scripts/peers."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import re
import subprocess
import sys
from collections.abc import Callable, Sequence
from datetime import date
from pathlib import Path
from typing import Any

from figure1_child import processors
from peers_measure import LOW, ROBUST, Measurer
from peers_results import CLGRID, EMBREE, GRID, PYTHON, Result, SceneResult

PACKAGES = ("clgrid", "numpy", "pyopencl", "embreex", "open3d", "trimesh", "rtree")


def machine(threads: int) -> dict[str, Any]:
    """What the figures were measured on."""
    versions = {}
    for name in PACKAGES:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return {
        "date": date.today().isoformat(),
        "processor": _processor(),
        "processors": len(processors()) or os.cpu_count(),
        "threads": threads,
        "memory_gib": round(_memory() / 2**30, 1),
        "system": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
        "packages": versions,
    }


def _processor() -> str:
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        return platform.processor() or platform.machine()
    found = {
        key: re.search(rf"^{key}\s*:\s*(.+)$", text, re.MULTILINE)
        for key in ("model name", "cpu family", "model")
    }
    name, family, model = (match.group(1) if match else "?" for match in found.values())
    return f"{name} (family {family}, model {model})"


def _memory() -> int:
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (ValueError, OSError):
        return 0


def embree_version(program: Path | None) -> str:
    """Of the library that the peer in C++ is linked to, empty if the system does not tell."""
    if program is None:
        return ""
    try:
        said = subprocess.run(["ldd", str(program)], capture_output=True, text=True).stdout
    except OSError:
        return ""
    found = re.search(r"=> (\S*libembree\S*)", said)
    return Path(found.group(1)).resolve().name.partition(".so.")[2] if found else ""


def head(command: str, facts: dict[str, Any], measurer: Measurer) -> str:
    """What was run, where, and who took part."""
    versions = ", ".join(f"{name} {version}" for name, version in facts["packages"].items())
    lines = [
        "# clgrid and its peers",
        "",
        f"    {command}",
        "",
        f"{facts['date']}; {facts['processor']}, {facts['processors']} processors, {facts['threads']} used by"
        f" everybody; {facts['memory_gib']} GiB; {facts['system']}; Python {facts['python']}; {versions}"
        + (f"; Embree in C++ {facts['embree_cpp']}" if facts["embree_cpp"] else "")
        + ".",
        "",
    ]
    for name, about in measurer.facts.items():
        if "driver" in about:
            lines.append(f"- {name}: {about['name']} of {about['platform']}, driver {about['driver']}")
    lines += [f"- left out: {line}" for line in measurer.left_out]
    return "\n".join([*lines, "", _EXPLAINED, ""])


_EXPLAINED = """\
Everybody has the same triangles, camera, light and random rays. Primary rays are those of one picture,
nearest hit, shaded, to a float image; the time to image is build and picture. clgrid's build begins at the
host's arrays and includes their checks and the upload; its shadow and random rays are arrays of the host, in
and out, while the peers in C++ keep theirs. Builds are warm: kernels compiled, memory of an earlier frame
released. Figures are medians over rounds in which all take turns; of a round, the median of the repetitions
in which no thread waited for a processor, or the least where all did. Embree's variants are builder / scene
flag / rays per call; those that fall behind leave after the first round. Hits are counted, beside those of
the first clgrid."""


def _table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    ruler = "|" + "|".join("---" if k < 1 else "--:" for k in range(len(columns))) + "|"
    return "\n".join([f"| {' | '.join(columns)} |", ruler, *(f"| {' | '.join(row)} |" for row in rows)])


def _text(value: float | None, digits: int = 1, scale: float = 1.0) -> str:
    return "" if value is None else f"{value * scale:.{digits}f}"


def _ratio(mine: float | None, other: float | None) -> float | None:
    return None if not mine or other is None else other / mine


def _rate(count: int | None, seconds: float | None) -> float | None:
    """Millions a second."""
    return count / seconds / 1e6 if count and seconds else None


def scene_tables(scene: SceneResult) -> str:
    """The rows of a scene."""
    if scene.failure:
        return f"## {scene.name}\n\nfailed: {scene.failure}\n"
    what = (
        f"{scene.frames} frames, each built and drawn" if scene.frames else f"{scene.pixels:,} primary rays"
    )
    parts = [f"## {scene.name}\n\n{scene.triangles:,} triangles, {what}\n", _main_table(scene)]
    if scene.of(PYTHON):
        parts.append("\nFrom Python, arrays in, arrays out, nearest hits:\n\n" + _python_table(scene))
    failed = [f"- {each.name}: {each.failure}" for each in scene.results if each.failure]
    parts += ["\n" + "\n".join(failed)] if failed else []
    return "\n".join(parts) + "\n"


def _main_table(scene: SceneResult) -> str:
    best = scene.embrees_best
    rows = []
    for each in scene.results:
        if each.kind == PYTHON or each.failure:
            continue
        build, primary, facts = each.seconds("build"), each.seconds("primary"), each.facts
        ratio = None if best is None or each.time_to_image is None else each.time_to_image / best
        rows.append(
            [
                each.name,
                str(len(each.rounds)),
                _text(build, 1, 1e3),
                _text(_rate(scene.triangles, build)),
                _text(primary, 1, 1e3),
                _text(_rate(scene.pixels, primary)),
                _text(each.time_to_image, 1, 1e3),
                _text(ratio, 2),
                _text(_rate(facts.get("shadow_rays"), each.seconds("shadow")), 2),
                _text(_rate(scene.rays, each.seconds("random")), 2),
                _text(each.bytes_per_triangle),
                *(_count(each, name) for name in ("hits", "occluded", "random_hits")),
            ]
        )
    columns = [
        "library",
        "rounds",
        "build ms",
        "Mtri/s",
        "primary ms",
        "Mrays/s",
        "time to image ms",
        "/ Embree's best",
    ]
    columns += ["shadow Mrays/s", "random Mrays/s", "bytes/triangle", "hits", "occluded", "random hits"]
    return _table(columns, rows)


def _count(result: Result, name: str) -> str:
    """A count, or how far it is from the first clgrid's."""
    if name in result.differs:
        return f"{result.differs[name]:+,}" if result.differs[name] else "same"
    value = result.facts.get(name)
    if isinstance(value, list):
        return f"{min(value):,} to {max(value):,}"
    return "" if value is None else f"{value:,}"


def _python_table(scene: SceneResult) -> str:
    truth = next(iter(scene.of(CLGRID)), None)
    rows = []
    for each in (*scene.of(CLGRID), *scene.of(PYTHON)):
        row = [each.name, _text(each.seconds("build"), 1, 1e3)]
        for rays in ("camera_cast", "random"):
            both = each.seconds("build", rays)
            ratio = _ratio(truth.seconds("build", rays) if truth else None, both)
            row += [_text(each.seconds(rays), 1, 1e3), _text(both, 1, 1e3), _text(ratio, 2)]
        counts = [
            each.differs.get(f"{kind}_{what}") for kind in ("camera", "random") for what in ("rays", "ids")
        ]
        row.append(" / ".join("-" if count is None else f"{count:,}" for count in counts))
        rows.append(row)
    columns = ["library", "build ms", f"{scene.pixels:,} camera rays ms", "with build", "/ clgrid"]
    columns += [f"{scene.rays:,} random rays ms", "with build", "/ clgrid"]
    columns += ["other answers, other triangles: camera / random"]
    note = "trimesh-rtree casts a sample of the rays; its seconds are extrapolated."
    used = any(each.name == "trimesh-rtree" for each in scene.of(PYTHON))
    return _table(columns, rows) + (f"\n\n{note}" if used else "")


Column = tuple[str, Callable[[SceneResult, Result], float | None]]


def _against(kind: str, part: str, *names: str) -> Callable[[SceneResult, Result], float | None]:
    """How many times faster than the best of some results."""

    def ratio(scene: SceneResult, mine: Result) -> float | None:
        return _ratio(mine.seconds(*names), scene.least(scene.of(kind, part), *names))

    return ratio


def _image(part: str) -> Callable[[SceneResult, Result], float | None]:
    """Time to image over that of Embree's best, of some."""

    def ratio(scene: SceneResult, mine: Result) -> float | None:
        other = scene.least(scene.of(EMBREE, part), "build", "primary")
        return None if not other or mine.time_to_image is None else mine.time_to_image / other

    return ratio


def _bytes(scene: SceneResult, mine: Result) -> float | None:
    low = next(iter(scene.of(EMBREE, LOW)), None)
    return _ratio(mine.bytes_per_triangle, low.bytes_per_triangle) if low else None


def _adapted_bytes(scene: SceneResult, mine: Result) -> float | None:
    low = next(iter(scene.of(EMBREE, LOW)), None)
    return _ratio(mine.facts.get("adapted_bytes_per_triangle"), low.bytes_per_triangle) if low else None


STILL: tuple[Column, ...] = (
    ("time to image / Embree's best", _image("")),
    ("build, times Embree LOW", _against(EMBREE, LOW, "build")),
    ("primary, times rtcIntersect16", _against(EMBREE, "/16", "primary")),
    ("shadow, times Embree's best", _against(EMBREE, "", "shadow")),
    ("random, times rtcIntersect1 robust", _against(EMBREE, ROBUST, "random")),
    ("primary, times C++ grid", _against(GRID, "compact/rho", "primary")),
    ("primary, times C++ packets", _against(GRID, "pkt", "primary")),
    ("Embree LOW's bytes / clgrid's", _bytes),
    ("the same after random rays", _adapted_bytes),
    ("camera rays, times embreex", _against(PYTHON, "embreex", "build", "camera_cast")),
    ("times Open3D", _against(PYTHON, "open3d", "build", "camera_cast")),
    ("times trimesh", _against(PYTHON, "trimesh", "build", "camera_cast")),
    ("random rays, times embreex", _against(PYTHON, "embreex", "build", "random")),
    ("times Open3D", _against(PYTHON, "open3d", "build", "random")),
    ("times trimesh", _against(PYTHON, "trimesh", "build", "random")),
)
MOVING: tuple[Column, ...] = (
    ("time to image / Embree's best", _image("")),
    ("/ rebuild", _image("rebuild")),
    ("/ refit", _image("refit")),
    ("build, times rebuild", _against(EMBREE, "rebuild", "build")),
    ("build, times refit", _against(EMBREE, "refit", "build")),
)


def ratios(scenes: Sequence[SceneResult]) -> str:
    """Tables over all scenes: still ones, and moving ones."""
    parts = ["## Ratios\n"]
    for columns, chosen in (
        (STILL, [scene for scene in scenes if not scene.frames]),
        (MOVING, [scene for scene in scenes if scene.frames]),
    ):
        rows = [
            [
                f"{scene.name}, {mine.name}",
                f"{scene.triangles:,}",
                *(_text(of(scene, mine), 2) for _, of in columns),
            ]
            for scene in chosen
            for mine in scene.of(CLGRID)
        ]
        kept = [k for k in range(len(columns) + 2) if any(row[k] for row in rows)]
        if rows:
            names = ["scene, clgrid on", "triangles", *(name for name, _ in columns)]
            parts.append(_table([names[k] for k in kept], [[row[k] for k in kept] for row in rows]) + "\n")
    return "\n".join(parts)


def command(words: Sequence[str]) -> str:
    """What was typed, without folders of this machine."""
    kept: list[str] = []
    skip = False
    for word in words:
        if skip or word.startswith(("--cpp=", "--out=")):
            skip = False
        elif word in ("--cpp", "--out"):
            skip = True
        else:
            kept.append(Path(word).name if os.sep in word else word)
    return " ".join([f"scripts/{Path(sys.argv[0]).name}", *kept])
