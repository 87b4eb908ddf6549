"""Records as flat rows: what a row is, what was timed, and everything else that is said of it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import PurePath
from typing import Any

Scalar = str | int | float | bool | None


@dataclass(frozen=True)
class Entry:
    """One row of a record.

    Attributes
    ----------
    names : dict
        What it is: rows of two records whose names differ are different rows.
    marks : dict
        What tells rows of the same names apart, if there are several: the first that does is asked.
    values : dict
        By field; parts of parts by ``field.field``.
    times : dict
        Seconds, one entry a repetition.
    """

    names: dict[str, Scalar]
    marks: dict[str, Scalar] = field(default_factory=dict)
    values: dict[str, Scalar] = field(default_factory=dict)
    times: dict[str, list[float]] = field(default_factory=dict)


def entries(document: Mapping[str, Any]) -> list[Entry]:
    """Return the rows of a record that was checked, in order.

    Parameters
    ----------
    document : dict
        As JSON has it; its schema is one of ``SCHEMAS``.
    """
    return list(_READERS[document["schema"]](document))


def _rows(document: Mapping[str, Any], names: str, marks: str, more: Mapping[str, Any]) -> Iterator[Entry]:
    for row in document["rows"]:
        yield _entry({**more, **row}, names, marks)


def _entry(row: Mapping[str, Any], names: str, marks: str = "", drop: Iterable[str] = ()) -> Entry:
    """Split a row into what it is and what is said of it."""
    values, times = _flatten({name: value for name, value in row.items() if name not in drop})
    named = {name: values.pop(name) for name in names.split() if name in values}
    marked = {name: values.pop(name) for name in marks.split() if name in values}
    if isinstance(named.get("scene"), str):
        # Folders differ from machine to machine.
        marked["path"] = named["scene"]
        named["scene"] = PurePath(str(named["scene"])).name
    return Entry(named, marked, values, times)


def _flatten(row: Mapping[str, Any], before: str = "") -> tuple[dict[str, Scalar], dict[str, list[float]]]:
    values: dict[str, Scalar] = {}
    times: dict[str, list[float]] = {}
    for name, value in row.items():
        path = before + name
        if isinstance(value, Mapping):
            inner, timed = _flatten(value, f"{path}.")
            values |= inner
            times |= timed
        elif isinstance(value, (list, tuple)):
            if _timed(path) and value:
                times[path] = [float(each) for each in value]
            elif not any(isinstance(each, (Mapping, list)) for each in value) and not _timed(path):
                joint = "x" if name == "resolution" else " " if name in ("eye", "turns") else "; "
                values[path] = joint.join(map(str, value))
        else:
            values[path] = value
    return values, times


def _timed(path: str) -> bool:
    """Whether it holds seconds; lists of parts are named for the whole: ``build_stages_s.count``."""
    return any(part.endswith("_s") or part == "seconds" for part in path.split("."))


def _bench(document: Mapping[str, Any]) -> Iterator[Entry]:
    return _rows(document, "scene triangles layout accuracy width height", "device density resolution", {})


def _render(document: Mapping[str, Any]) -> Iterator[Entry]:
    row = {**document["row"], "save_s": [*document["save_s"].values()]}
    yield _entry(row, "scene triangles layout accuracy width height", "device density")


def _workload(document: Mapping[str, Any]) -> Iterator[Entry]:
    names = "scene triangles workload bounces layout accuracy skipping width height kind"
    for row in document["rows"]:
        whole = {**row, "kind": "all"}
        shared = {name: row[name] for name in [*names.split()[:-1], "device", "density", "resolution"]}
        for kind in row["kinds"]:
            yield _entry({**shared, **kind}, names, "device density resolution")
        yield _entry(whole, names, "device density resolution")


def _frames(document: Mapping[str, Any]) -> Iterator[Entry]:
    more = {name: document[name] for name in ("scene", "triangles", "layout", "accuracy", "width", "height")}
    return _rows(document, "scene triangles layout accuracy width height frame", "", more)


def _verify(document: Mapping[str, Any]) -> Iterator[Entry]:
    more = {name: document[name] for name in ("scene", "triangles", "layout", "skipping", "density")}
    # Rays are aimed at the planes of the grid.
    return _rows(document, "scene triangles layout skipping accuracy rays resolution", "density", more)


def _compare(document: Mapping[str, Any]) -> Iterator[Entry]:
    size = {name: document[name] for name in ("width", "height")}
    names = "scene triangles layout accuracy skipping width height kind"
    for device in document["devices"]:
        label = {"device": device["label"]}
        facts = {name: device[name] for name in ("status", "step", "reason", "seconds", "process_peak_bytes")}
        failed = {"failed": len(device["failures"])}
        yield _entry(
            {"what": "device", **label, **facts, **failed, **(device["speed"] or {})}, "what", "device"
        )
        for each in device["arithmetic"]:
            yield _entry({"what": "arithmetic", **label, **each}, "what type operands", "device")
        for row in device["rows"]:
            yield _entry({**size, **label, **row}, names, "device density resolution", ("kinds", "warnings"))
            shared = {name: row[name] for name in ("scene", "triangles", "layout", "accuracy", "skipping")}
            for kind in row["kinds"]:
                yield _entry({**size, **label, **shared, **kind}, names, "device")
    names = "scene accuracy pair width height kind"
    for pair in document["pairs"]:
        shared = {**size, "scene": pair["scene"], "accuracy": pair["accuracy"]}
        shared["pair"] = f"{pair['first']} / {pair['second']}"
        shared["promised"] = pair["promised"]
        said = {name: pair[name] for name in ("equal", "grids", "arrays", "references")}
        yield _entry({**shared, **said, "image": pair["image"]}, names)
        for kind in pair["rays"]:
            yield _entry({**shared, **kind}, names)


def _tradeoff(document: Mapping[str, Any]) -> Iterator[Entry]:
    above = ("scene", "triangles", "width", "height", "clock")
    more = {name: document[name] for name in above}
    names = "scene triangles width height accuracy layout density samples kind reference clock"
    for number, row in enumerate(document["rows"]):
        # As if all turns of the run had been alike.
        slowness = [document["slowness"][turn] for turn in row["turns"]]
        evened = {
            name: [second / slow for second, slow in zip(row[name], slowness, strict=True)]
            for name in ("build_s", "render_s", "time_to_image_s")
        }
        yield _entry({**more, **row, **evened}, names, "resolution")
        point = {name: row[name] for name in ("accuracy", "layout", "density", "samples")}
        # The rows that share a measurement would say the same of it several times.
        if row["errors_of"] == number:
            for errors in row["errors"]:
                yield _entry({**more, **point, **errors}, names)


_READERS: dict[str, Callable[[Mapping[str, Any]], Iterator[Entry]]] = {
    "clgrid.bench/1": _bench,
    "clgrid.bench.workload/1": _workload,
    "clgrid.bench.frames/1": _frames,
    "clgrid.render/1": _render,
    "clgrid.verify/1": _verify,
    "clgrid.compare/1": _compare,
    "clgrid.tradeoff/1": _tradeoff,
}
SCHEMAS = tuple(_READERS)
