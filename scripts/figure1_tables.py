"""What was measured, as Markdown, CSV and JSON, beside the paper's own numbers."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from figure1_measure import Measured
from figure1_paper import LABEL, PAPER, UNEVEN

MIB = 2.0**20


def flat(measured: Measured) -> dict[str, Any]:
    """Everything about one measurement in one level, medians of times; None where there is nothing."""
    m, paper, scene = measured, PAPER[measured.row], measured.scene
    triangles = scene.triangles if scene else None
    build, render = m.median("build_s"), m.median("render_s")
    references, resolution = m.value("references"), m.value("resolution")
    return {
        "row": m.row,
        "stand_in": scene.label if scene else None,
        "triangles": triangles,
        "mesh_bytes": scene.mesh_bytes if scene else None,
        "layout": m.layout,
        "threads": m.threads,
        "repetitions": len(m.seconds("build_s")) or None,
        "density": m.value("density"),
        "resolution": "x".join(str(n) for n in resolution) if resolution else None,
        "references": references,
        "references_per_triangle": _over(references, triangles),
        "empty_share": m.value("empty_share"),
        "load_factor": m.value("load_factor") or None,
        "grid_bytes": m.value("grid_bytes"),
        "bytes_per_triangle": m.value("bytes_per_triangle"),
        "peak_bytes": m.value("peak_bytes"),
        "process_peak_bytes": m.largest("process_peak_bytes"),
        "load_s": m.median("load_s"),
        "first_compile_s": m.median("first_compile_s"),
        "build_s": build,
        "build_ns_per_triangle": _over(build, triangles, 1e9),
        "render_s": render,
        "mrays_per_s": _over(m.value("rays"), render, 1e-6),
        "time_to_image_s": m.median("time_to_image_s"),
        "rays": m.value("rays"),
        "hits": m.value("hits"),
        "failure": m.failure or None,
        "paper_triangles": paper.triangles,
        "paper_references_per_triangle": paper.references,
        "paper_empty_share": paper.empty_share(),
        "paper_bytes_per_triangle": paper.bytes_per_triangle(m.layout),
        "paper_build_s": paper.build_s(m.layout),
        "paper_build_ns_per_triangle": _over(paper.build_s(m.layout), paper.triangles, 1e9),
        "paper_render_s": paper.render_s(m.layout),
        "paper_time_to_image_s": paper.time_to_image_s(m.layout),
    }


def _over(a: float | None, b: float | None, scale: float = 1.0) -> float | None:
    return a / b * scale if a is not None and b else None


def csv_text(rows: Iterable[dict[str, Any]]) -> str:
    """One line a measurement, medians."""
    buffer = io.StringIO()
    writer: csv.DictWriter[str] | None = None
    for row in rows:
        if writer is None:
            writer = csv.DictWriter(buffer, list(row), lineterminator="\n")
            writer.writeheader()
        writer.writerow(row)
    return buffer.getvalue()


def markdown(
    rows: Sequence[dict[str, Any]], processors: int, head: Sequence[str], notes: Sequence[str]
) -> str:
    """All tables: times, bytes, layouts against compact, threads, failures and notes."""
    full = [row for row in rows if row["threads"] == processors]
    good = [row for row in full if not row["failure"]]
    parts = [
        *head,
        _section("Scenes", _scenes(full)),
        _section("Time", _times(full)),
        _section("Memory", _memory(full)),
        _section("Against the compact grid", _against(good)),
        _section("Threads", _threads(rows)),
        _section("Not measured", _failures(rows)),
        _section("Notes", [f"- {note}" for note in notes]),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def _section(title: str, lines: Sequence[str]) -> str:
    return f"## {title}\n\n" + "\n".join(lines) if lines else ""


def _table(columns: Sequence[str], rows: Sequence[Sequence[str]], words: int) -> list[str]:
    """Markdown lines; the first ``words`` columns to the left, numbers to the right."""
    if not rows:
        return []
    rule = ["---"] * words + ["---:"] * (len(columns) - words)
    return [_line(columns), "|" + "|".join(rule) + "|", *(_line(row) for row in rows)]


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _scenes(rows: Sequence[dict[str, Any]]) -> list[str]:
    columns = ("row", "stand-in", "triangles", "of the paper's", "mesh MiB")
    one_each = {row["row"]: row for row in rows if row["triangles"] is not None}
    return _table(
        columns,
        [
            (
                row["row"],
                row["stand_in"],
                f"{row['triangles']:,}",
                f"{row['triangles'] / row['paper_triangles']:.0%}",
                _mib(row["mesh_bytes"]),
            )
            for row in one_each.values()
        ],
        2,
    )


def _times(rows: Sequence[dict[str, Any]]) -> list[str]:
    columns = (
        "row",
        "layout",
        "triangles",
        "build ms",
        "ns/triangle",
        "render ms",
        "Mrays/s",
        "time to image ms",
    )
    paper = ("paper: build ms", "ns/triangle", "render ms", "time to image ms")
    lines = [
        (
            row["row"],
            row["layout"],
            _count(row["triangles"]),
            _or_failed(row, _ms(row["build_s"])),
            _digits(row["build_ns_per_triangle"]),
            _ms(row["render_s"]),
            _digits(row["mrays_per_s"]),
            _ms(row["time_to_image_s"]),
            _ms(row["paper_build_s"], 2),
            _digits(row["paper_build_ns_per_triangle"], 2),
            _ms(row["paper_render_s"], 2),
            _ms(row["paper_time_to_image_s"], 2),
        )
        for row in rows
    ]
    return _table([*columns, *paper], lines, 2)


def _memory(rows: Sequence[dict[str, Any]]) -> list[str]:
    columns = ("row", "layout", "grid MiB", "B/triangle", "references/triangle", "empty cells", "load factor")
    more = ("most on the device MiB", "most of the process MiB")
    paper = ("paper: B/triangle", "references/triangle", "empty cells")
    lines = [
        (
            row["row"],
            row["layout"],
            _or_failed(row, _mib(row["grid_bytes"])),
            _digits(row["bytes_per_triangle"]),
            _digits(row["references_per_triangle"]),
            _share(row["empty_share"]),
            _digits(row["load_factor"]),
            _mib(row["peak_bytes"]),
            _mib(row["process_peak_bytes"]),
            _digits(row["paper_bytes_per_triangle"]),
            _digits(row["paper_references_per_triangle"]),
            _share(row["paper_empty_share"]),
        )
        for row in rows
    ]
    return _table([*columns, *more, *paper], lines, 2)


def _against(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Ratios to the compact grid of the same row, measured and the paper's."""
    compact = {row["row"]: row for row in rows if row["layout"] == "compact"}
    keys = ("bytes_per_triangle", "build_s", "render_s", "time_to_image_s")
    columns = ("row", "layout", "bytes", "build", "render", "time to image")
    paper = ("paper: bytes", "build", "render", "time to image")
    lines = []
    for row in rows:
        base = compact.get(row["row"])
        if base is None or row is base:
            continue
        measured = [_digits(_over(row[key], base[key])) for key in keys]
        printed = [_digits(_over(row[f"paper_{key}"], _paper_compact(row, key)), 2) for key in keys]
        lines.append((row["row"], row["layout"], *measured, *printed))
    return _table([*columns, *paper], lines, 2)


def _paper_compact(row: dict[str, Any], key: str) -> float | None:
    paper = PAPER[row["row"]]
    of_compact: dict[str, Callable[[str], float | None]] = {
        "bytes_per_triangle": paper.bytes_per_triangle,
        "build_s": paper.build_s,
        "render_s": paper.render_s,
        "time_to_image_s": paper.time_to_image_s,
    }
    return of_compact[key]("compact")


def _threads(rows: Sequence[dict[str, Any]]) -> list[str]:
    """One thread against two, alternating in one run."""
    good = {(row["row"], row["layout"], row["threads"]): row for row in rows if not row["failure"]}
    columns = ("row", "layout", "build ms, 1 thread", "2", "faster", "render ms, 1 thread", "2", "faster")
    lines = []
    for (name, layout, threads), one in good.items():
        two = good.get((name, layout, 2))
        if threads != 1 or two is None:
            continue
        cells = []
        for key in ("build_s", "render_s"):
            cells += [_ms(one[key]), _ms(two[key]), f"{one[key] / two[key]:.2f}x"]
        lines.append((name, layout, *cells))
    return _table(columns, lines, 2)


def _failures(rows: Sequence[dict[str, Any]]) -> list[str]:
    """A line for each row and reason, with the measurements that ended so."""
    whats: dict[tuple[str, str], list[str]] = {}
    for row in rows:
        if row["failure"]:
            kind = f"{row['layout']} on {row['threads']}"
            whats.setdefault((row["row"], row["failure"]), []).append(kind)
    return [f"- {name} ({', '.join(kinds)}): {reason}" for (name, reason), kinds in whats.items()]


def _or_failed(row: dict[str, Any], text: str) -> str:
    return "failed" if row["failure"] else text


def _count(value: int | None) -> str:
    return "" if value is None else f"{value:,}"


def _digits(value: float | None, digits: int = 3) -> str:
    """So many significant digits, never an exponent."""
    if not value:
        return "" if value is None else "0"
    places = digits - 1 - int(f"{value:.{digits - 1}e}".partition("e")[2])
    return f"{round(value, places):,.{max(0, places)}f}"


def _ms(value: float | None, digits: int = 3) -> str:
    return _digits(None if value is None else 1e3 * value, digits)


def _mib(value: float | None) -> str:
    return _digits(None if value is None else value / MIB)


def _share(value: float | None) -> str:
    return "" if value is None else f"{100 * value:.1f} %"


def linearity(rows: Sequence[dict[str, Any]], processors: int) -> list[str]:
    """Build time per triangle of the largest even row over the Dragon's, for each layout."""
    notes = []
    good = [row for row in rows if row["threads"] == processors and not row["failure"]]
    for layout in dict.fromkeys(row["layout"] for row in good):
        even = {row["row"]: row for row in good if row["layout"] == layout and row["row"] != UNEVEN}
        dragon = even.pop("Dragon", None)
        larger = max(even.values(), key=lambda row: float(row["triangles"]), default=None)
        if dragon is None or larger is None or larger["triangles"] <= dragon["triangles"]:
            continue
        ratio = larger["build_ns_per_triangle"] / dragon["build_ns_per_triangle"]
        notes.append(
            f"Build time per triangle, {layout}: {larger['row']} "
            f"{_digits(larger['build_ns_per_triangle'])} ns, Dragon "
            f"{_digits(dragon['build_ns_per_triangle'])} ns: {ratio:.2f}x."
        )
    return notes


def paper_note() -> str:
    """What the paper's columns are."""
    return (
        f"Paper: {LABEL}. Derived from the rounded figures of its Figure 1 (triangles over rate, rays over "
        "rate, 4 (4 + r) bytes a triangle at its density 4); the render times of Lucy and David are its own, "
        "Cruiser's hashed one is the compact one and 1 %, Nature's hashed time to image the compact one and "
        "58 %. Where nothing is known, nothing stands."
    )
