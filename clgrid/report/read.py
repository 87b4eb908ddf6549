"""Records from files, refused in a line where they are damaged or not ours."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from clgrid.compare_record import CompareRecord
from clgrid.errors import InputError
from clgrid.record import BenchRecord, FramesRecord, Header, RenderRecord, WorkloadRecord
from clgrid.tradeoff_record import TradeoffRecord
from clgrid.verify_record import VerifyRecord

KINDS: dict[str, type[Header]] = {
    "clgrid.bench/1": BenchRecord,
    "clgrid.bench.workload/1": WorkloadRecord,
    "clgrid.bench.frames/1": FramesRecord,
    "clgrid.render/1": RenderRecord,
    "clgrid.verify/1": VerifyRecord,
    "clgrid.compare/1": CompareRecord,
    "clgrid.tradeoff/1": TradeoffRecord,
}
_LARGEST = 1 << 30
# What is a median wherever it is shown.
_MEASURED = ("build_s", "render_s", "time_to_image_s", "cast_s")


@dataclass(frozen=True)
class Run:
    """A record, and where it comes from.

    Attributes
    ----------
    name : str
        Of the file, or of the verb that has just made the record.
    document : dict
        The record as JSON has it.
    """

    name: str
    record: Header
    document: dict[str, Any]

    @classmethod
    def of(cls, record: Header, name: str) -> Run:
        """Return the run of a record that is in memory."""
        return cls(name, record, json.loads(msgspec.json.encode(record)))


def read(path: str | Path) -> Run:
    """Read a record that ``--json`` wrote.

    Raises
    ------
    InputError
        If the file cannot be read, is no JSON, or is not a record of a kind and version that is known: with
        the first field that is wrong.
    """
    try:
        with open(path, "rb") as file:
            data = file.read(_LARGEST + 1)
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read ({error.strerror}); give a file that --json wrote"
        ) from error
    if len(data) > _LARGEST:
        raise InputError(f"{path}: beyond 1 GiB; a record of clgrid is smaller")
    try:
        document = msgspec.json.decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(f"{path}: no JSON: {error}; give a file that --json wrote") from error
    schema = document.get("schema") if isinstance(document, dict) else None
    if not isinstance(schema, str):
        raise InputError(
            f"{path}: no field `$.schema`: not a record of clgrid; give a file that --json wrote"
        )
    if schema not in KINDS:
        known = ", ".join(KINDS)
        raise InputError(f"{path}: `$.schema` is {schema!r}, which no report is for; reports are for {known}")
    try:
        record = msgspec.json.decode(data, type=KINDS[schema])
    except (msgspec.ValidationError, RecursionError) as error:
        raise InputError(
            f"{path}: not a whole {schema}: {error}; measure anew, or use the clgrid that wrote it"
        ) from error
    wrong = next(_wrong_times(document, "$"), None) or _wrong_numbers(record)
    if wrong:
        raise InputError(f"{path}: {wrong}; the record is damaged")
    return Run(Path(path).name, record, document)


def _wrong_times(value: Any, place: str) -> Iterator[str]:
    """Seconds of which nothing can be said: below 0, or none where something was measured."""
    name = place.rpartition(".")[2]
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _wrong_times(inner, f"{place}.{key}")
    elif isinstance(value, list):
        if not value and name in _MEASURED:
            yield f"no repetitions - at `{place}`"
        for number, inner in enumerate(value):
            yield from _wrong_times(inner, f"{place}[{number}]")
    elif isinstance(value, (int, float)) and value < 0 and "_s" in name:
        yield f"a time below 0 - at `{place}`"


def _wrong_numbers(record: Header) -> str:
    """The first number of a row that is not there, or list of another length than is said; mostly empty."""
    if isinstance(record, TradeoffRecord):
        count, turns = len(record.rows), len(record.slowness)
        chosen = record.recommendation
        if chosen is not None and not all(0 <= row < count for row in (chosen.row, chosen.rival or 0)):
            return "no such row - at `$.recommendation`"
        for number, row in enumerate(record.rows):
            if not 0 <= row.errors_of < count:
                return f"no such row - at `$.rows[{number}].errors_of`"
            if {len(row.turns)} != {len(row.build_s), len(row.render_s), len(row.time_to_image_s)}:
                return f"not a turn for each repetition - at `$.rows[{number}].turns`"
            if not all(0 <= turn < turns and record.slowness[turn] > 0 for turn in row.turns):
                return f"no such turn - at `$.rows[{number}].turns`"
    if isinstance(record, CompareRecord):
        for number, pair in enumerate(record.pairs):
            heat = pair.heat_map
            if heat is not None and {heat.width * heat.height} != {len(heat.rays), len(heat.image)}:
                return f"not a value for each block - at `$.pairs[{number}].heat_map`"
    return ""
