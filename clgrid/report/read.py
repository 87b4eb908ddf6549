"""Records from files, refused in a line where they are damaged or not ours."""

from __future__ import annotations

import json
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
    _check_times(path, document, "$")
    return Run(Path(path).name, record, document)


def _check_times(path: str | Path, value: Any, place: str) -> None:
    """Refuse seconds below 0: nothing can be said of them."""
    if isinstance(value, dict):
        for name, inner in value.items():
            _check_times(path, inner, f"{place}.{name}")
    elif isinstance(value, list):
        for number, inner in enumerate(value):
            _check_times(path, inner, f"{place}[{number}]")
    elif isinstance(value, float) and value < 0 and "_s" in place.rpartition(".")[2]:
        raise InputError(f"{path}: a time below 0 - at `{place}`; the record is damaged")
