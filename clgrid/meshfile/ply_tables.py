"""The rows of a PLY element, from text or binary data, without trusting a count before the size allows it."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from clgrid.errors import MeshError
from clgrid.meshfile.content import Content
from clgrid.meshfile.ply_header import Element, Property

GATHER_CHUNK = 1 << 20
"""List entries gathered at a time: bounds the scratch memory of the slow path."""


@dataclass
class Table:
    """Columns of one element.

    Attributes
    ----------
    values : dict of str to (N,) array
        Single values by name. Binary columns are views into the file, in its byte order.
    lists : dict of str to (flat, counts)
        List entries, one row after the other, and the length of each row; a flat array may be 2-D where all
        rows are of the same length.
    """

    values: dict[str, npt.NDArray[np.generic]] = field(default_factory=dict)
    lists: dict[str, tuple[npt.NDArray[np.generic], npt.NDArray[np.int64]]] = field(default_factory=dict)


def read_binary(data: Content, offset: int, element: Element, order: str) -> tuple[Table, int]:
    """Read the rows of one element at ``offset``; also hand back the offset behind them.

    Raises
    ------
    MeshError
        If the data ends early or a list length is negative.
    """
    least = sum(np.dtype(entry.count_type or entry.type).itemsize for entry in element.properties)
    _require_room(element, element.count * least, len(data) - offset, "bytes")
    if element.count == 0 or not element.properties:
        return Table(), offset
    lengths = _first_lengths(data, offset, element, order)
    if lengths is not None:
        rows = np.dtype(_uniform_fields(element, order, lengths))
        if element.count * rows.itemsize <= len(data) - offset:
            records = np.frombuffer(data, rows, element.count, offset)
            if all((records[f"#{name}"] == length).all() for name, length in lengths.items()):
                return _uniform_table(element, records, lengths), offset + element.count * rows.itemsize
    return _walk_binary(data, offset, element, order)


def read_text(tokens: npt.NDArray[np.float64], offset: int, element: Element) -> tuple[Table, int]:
    """Read the rows of one element at token ``offset``; also hand back the token behind them.

    Raises
    ------
    MeshError
        If the numbers run out or a list length is not a whole number.
    """
    _require_room(element, element.count * len(element.properties), len(tokens) - offset, "numbers")
    if element.count == 0 or not element.properties:
        return Table(), offset
    lengths: dict[str, int] | None = {}
    position = offset
    for entry in element.properties:
        if entry.count_type is not None and lengths is not None:
            lengths[entry.name] = _whole(tokens, position, element, entry, 0)
            position += lengths[entry.name]
        position += 1
        if position > len(tokens):
            raise _truncated(element, 0)
    width = position - offset
    if element.count * width <= len(tokens) - offset:
        rows = tokens[offset : offset + element.count * width].reshape(element.count, width)
        table = _uniform_text_table(element, rows, lengths or {})
        if table is not None:
            return table, offset + element.count * width
    return _walk_text(tokens, offset, element)


def _require_room(element: Element, needed: int, left: int, unit: str) -> None:
    if needed > left:
        raise MeshError(
            f"PLY header announces {element.count} rows of {element.name!r}, at least {needed} {unit}, "
            f"and {left} are left; the file is truncated or its header lies: export it again"
        )


def _truncated(element: Element, row: int) -> MeshError:
    return MeshError(
        f"PLY data ends in row {row} of {element.count} of {element.name!r}; "
        "the file is truncated: export it again"
    )


def _first_lengths(data: Content, offset: int, element: Element, order: str) -> dict[str, int] | None:
    """Lengths of the lists of the first row; None where one of them does not make a row of fixed size."""
    lengths: dict[str, int] = {}
    for entry in element.properties:
        if entry.count_type is None:
            offset += np.dtype(entry.type).itemsize
            continue
        counter = np.dtype(order + entry.count_type)
        if offset + counter.itemsize > len(data):
            return None
        length = int(np.frombuffer(data, counter, 1, offset)[0])
        # numpy cannot describe records of 2 GiB and more
        if not 0 <= length * np.dtype(entry.type).itemsize < 2**24:
            return None
        lengths[entry.name] = length
        offset += counter.itemsize + length * np.dtype(entry.type).itemsize
    return lengths


def _uniform_fields(
    element: Element, order: str, lengths: dict[str, int]
) -> list[tuple[str, str, tuple[int, ...]]]:
    fields: list[tuple[str, str, tuple[int, ...]]] = []
    for entry in element.properties:
        if entry.count_type is None:
            fields.append((entry.name, order + entry.type, ()))
        else:
            fields.append((f"#{entry.name}", order + entry.count_type, ()))
            fields.append((entry.name, order + entry.type, (lengths[entry.name],)))
    return fields


def _uniform_table(element: Element, records: npt.NDArray[np.void], lengths: dict[str, int]) -> Table:
    table = Table()
    for entry in element.properties:
        if entry.count_type is None:
            table.values[entry.name] = records[entry.name]
        else:
            counts = np.full(len(records), lengths[entry.name], np.int64)
            table.lists[entry.name] = (records[entry.name], counts)
    return table


def _walk_binary(data: Content, offset: int, element: Element, order: str) -> tuple[Table, int]:
    """Rows of varying length, one after the other: the offset of a row is only known from the one before."""
    view = memoryview(data)
    steps, tail = _steps(element, order)
    if len(steps) == 1 and steps[0][1].size == 1 and steps[0][1].format.endswith("B"):
        return _walk_bytes(view, offset, element, order, steps[0], tail)
    places: list[list[int]] = [[] for _ in steps]
    counts: list[list[int]] = [[] for _ in steps]
    end = len(data)
    for row in range(element.count):
        for (skip, counter, item), place, count in zip(steps, places, counts, strict=True):
            offset += skip
            if offset + counter.size > end:
                raise _truncated(element, row)
            length: int = counter.unpack_from(view, offset)[0]
            if length < 0:
                raise MeshError(
                    f"PLY row {row} of {element.name!r} has a list of length {length}; repair the file"
                )
            offset += counter.size
            place.append(offset)
            count.append(length)
            offset += length * item
        offset += tail
        if offset > end:
            raise _truncated(element, row)
    table = Table()
    listed = [entry for entry in element.properties if entry.count_type is not None]
    for entry, place, count in zip(listed, places, counts, strict=True):
        sizes = np.array(count, np.int64)
        table.lists[entry.name] = (
            _gathered(data, np.array(place), sizes, np.dtype(order + entry.type)),
            sizes,
        )
    return table, offset


def _walk_bytes(
    view: memoryview,
    offset: int,
    element: Element,
    order: str,
    step: tuple[int, struct.Struct, int],
    tail: int,
) -> tuple[Table, int]:
    """Rows with one list whose length is a byte: the usual mix of polygons, several times faster."""
    skip, _, item = step
    lengths: list[int] = []
    append = lengths.append
    jumps = [1 + length * item + tail + skip for length in range(256)]
    place = offset + skip
    try:
        for _ in range(element.count):
            length = view[place]
            append(length)
            place += jumps[length]
    except IndexError:
        raise _truncated(element, len(lengths)) from None
    end = place - skip
    if end > len(view):
        raise _truncated(element, element.count - 1)
    sizes = np.array(lengths, np.int64)
    widths = skip + 1 + sizes * item + tail
    places = offset + np.cumsum(widths) - widths + skip + 1
    entry = next(entry for entry in element.properties if entry.count_type is not None)
    table = Table(lists={entry.name: (_gathered(view, places, sizes, np.dtype(order + entry.type)), sizes)})
    return table, end


def _steps(element: Element, order: str) -> tuple[list[tuple[int, struct.Struct, int]], int]:
    """For each list of a row: bytes before it, its counter, bytes of an entry; then the bytes behind all."""
    codes = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I"}
    steps: list[tuple[int, struct.Struct, int]] = []
    skip = 0
    for entry in element.properties:
        size = np.dtype(entry.type).itemsize
        if entry.count_type is None:
            skip += size
        else:
            steps.append((skip, struct.Struct(order + codes[entry.count_type]), size))
            skip = 0
    return steps, skip


def _gathered(
    data: Content | memoryview,
    places: npt.NDArray[np.int64],
    counts: npt.NDArray[np.int64],
    dtype: np.dtype[np.generic],
) -> npt.NDArray[np.generic]:
    """Collect the list entries at byte offsets ``places``, ``counts`` of them each."""
    flat = np.empty(int(counts.sum()), dtype)
    if not len(flat):
        return flat
    # an entry may begin at any byte: one overlapping, unaligned view of them all
    source: npt.NDArray[np.generic] = np.ndarray(len(data) - dtype.itemsize + 1, dtype, data, strides=(1,))
    first = np.cumsum(counts) - counts
    # a row longer than a chunk makes its chunk longer: the file is at least that long
    bounds = np.searchsorted(first, np.arange(0, len(flat) + GATHER_CHUNK, GATHER_CHUNK))
    bounds = np.unique(np.concatenate([[0], bounds, [len(counts)]]))
    for low, high in pairwise(bounds.tolist()):
        size = counts[low:high]
        # start of each row, less the entries of the rows before it
        shift = places[low:high] - (first[low:high] - first[low]) * dtype.itemsize
        within = np.arange(int(size.sum())) * dtype.itemsize
        flat[first[low] : first[low] + len(within)] = source[np.repeat(shift, size) + within]
    return flat


def _whole(tokens: npt.NDArray[np.float64], at: int, element: Element, entry: Property, row: int) -> int:
    """List length written at token ``at``."""
    if at >= len(tokens):
        raise _truncated(element, row)
    length = float(tokens[at])
    if not (length >= 0 and length.is_integer()):
        raise MeshError(
            f"PLY row {row} of {element.name!r}: length of {entry.name!r} is {length:g}; repair the file"
        )
    return int(length) if length <= len(tokens) else len(tokens)


def _uniform_text_table(
    element: Element, rows: npt.NDArray[np.float64], lengths: dict[str, int]
) -> Table | None:
    table = Table()
    column = 0
    for entry in element.properties:
        if entry.count_type is None:
            table.values[entry.name] = rows[:, column]
            column += 1
            continue
        length = lengths[entry.name]
        if not (rows[:, column] == length).all():
            return None
        counts = np.full(len(rows), length, np.int64)
        table.lists[entry.name] = (rows[:, column + 1 : column + 1 + length], counts)
        column += 1 + length
    return table


def _walk_text(tokens: npt.NDArray[np.float64], offset: int, element: Element) -> tuple[Table, int]:
    listed = [entry for entry in element.properties if entry.count_type is not None]
    places: dict[str, list[int]] = {entry.name: [] for entry in listed}
    counts: dict[str, list[int]] = {entry.name: [] for entry in listed}
    for row in range(element.count):
        for entry in element.properties:
            if entry.count_type is not None:
                length = _whole(tokens, offset, element, entry, row)
                places[entry.name].append(offset + 1)
                counts[entry.name].append(length)
                offset += length
            offset += 1
        if offset > len(tokens):
            raise _truncated(element, row)
    table = Table()
    for entry in listed:
        size = np.array(counts[entry.name], np.int64)
        within = np.arange(int(size.sum())) - np.repeat(np.cumsum(size) - size, size)
        table.lists[entry.name] = (tokens[np.repeat(np.array(places[entry.name]), size) + within], size)
    return table, offset
