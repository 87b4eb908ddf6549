"""The file of a grid: a header, then arrays, each from a page's start on so that they can be mapped.

::

    0    magic, 8 bytes              16   bytes of the header, uint64
    8    format version, uint32      24   bytes of the file, uint64
    12   0, uint32                   32   checksum of all else up to the first array, uint32
    36   the header, JSON (``Header``), then zeros up to the next page; then the arrays in its order

Numbers are little-endian. Every array is followed by zeros up to the next page, which its checksum (CRC-32)
covers, so that no byte can change unseen. There is no time in it: the same grid gives the same bytes.
Checksums tell damage, not malice: who can write a file can write its checksums.
"""

from __future__ import annotations

import os
import struct
import threading
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import msgspec
import numpy as np
import numpy.typing as npt

from clgrid.errors import GridFileError

MAGIC = b"clgrid\r\n"
FORMAT = 1
"""Of the file and of what the arrays mean; to be raised with any change of either."""

# Arrays start at such multiples: drivers take memory from a page's start on without a copy.
_PAGE = 4096
_START = struct.Struct("<8sIIQQ")
_CHECKSUM = struct.Struct("<I")
_HEADER_AT = _START.size + _CHECKSUM.size


class Frame(msgspec.Struct, frozen=True):
    """The local frame (``LocalFrame``)."""

    offset: tuple[float, float, float]
    exponent: int


class Part(msgspec.Struct, frozen=True):
    """A part of the mesh with its grid (``MeshPart``, ``CellLists``); ``arrays`` are names in order."""

    first: int
    count: int
    arrays: tuple[str, ...]
    resolution: tuple[int, int, int]
    references: int
    full_cells: int
    slots: int
    wide: bool
    cells: int


class Facts(msgspec.Struct, frozen=True):
    """What a file says beside its arrays: how the grid was built, of what, and its counts."""

    clgrid: str
    structs: str
    layout: str
    accuracy: str
    density: float
    resolution: tuple[int, int, int] | None
    max_memory: int | None
    skipping: bool
    source: str
    geometry_names: tuple[str, ...]
    warnings: tuple[str, ...]
    vertices: int
    triangles: int
    frame: Frame | None
    parts: tuple[Part, ...]


class Section(msgspec.Struct, frozen=True):
    """An array in the file: where it starts, from the first one on, and the checksum of its pages."""

    name: str
    dtype: str
    shape: tuple[int, ...]
    start: int
    checksum: str


class Header(msgspec.Struct, frozen=True):
    """All that is known before the arrays are read."""

    facts: Facts
    arrays: tuple[Section, ...]


@dataclass(frozen=True)
class Source:
    """An array to be written: asked for when its turn comes, so that one at a time is in memory."""

    name: str
    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    read: Callable[[], npt.NDArray[Any]]

    @property
    def nbytes(self) -> int:
        """Bytes of the array."""
        return int(np.prod(self.shape, dtype=np.int64)) * self.dtype.itemsize


def whole_pages(nbytes: int) -> int:
    """Bytes of the pages that so many bytes take."""
    return -(-nbytes // _PAGE) * _PAGE


def write(path: Path, facts: Facts, sources: Sequence[Source]) -> None:
    """Write a file; it appears under its name only when complete.

    Raises
    ------
    GridFileError
        If it cannot be written; a file that was there is then as it was.
    """
    try:
        with _beside(path) as file:
            _write(file, facts, sources)
    except OSError as error:
        raise GridFileError(
            f"{path}: cannot be written ({error.strerror or error}); choose another path"
        ) from error


@contextmanager
def _beside(path: Path) -> Iterator[BinaryIO]:
    """A file that takes the place of ``path`` when all is written."""
    if path.is_dir():
        raise GridFileError(f"{path}: is a folder; name a file in it")
    if not path.parent.is_dir():
        raise GridFileError(f"{path}: no such folder {path.parent}; create it or choose another path")
    partial = path.with_name(f".{path.name}.{os.getpid()}.{threading.get_ident()}.partial")
    try:
        with partial.open("xb") as file:
            yield file
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def _write(file: BinaryIO, facts: Facts, sources: Sequence[Source]) -> None:
    starts = np.cumsum([0, *(whole_pages(source.nbytes) for source in sources)]).tolist()
    blank = _text(0)
    sections = [
        Section(source.name, source.dtype.str, source.shape, start, blank)
        for source, start in zip(sources, starts[:-1], strict=True)
    ]
    # Checksums are of one length, so that the header's size is known before them.
    first = whole_pages(_HEADER_AT + len(msgspec.json.encode(Header(facts, tuple(sections)))))
    file.seek(first)
    for k, source in enumerate(sources):
        sections[k] = msgspec.structs.replace(sections[k], checksum=_write_array(file, source))
    header = msgspec.json.encode(Header(facts, tuple(sections)))
    start = _START.pack(MAGIC, FORMAT, 0, len(header), first + starts[-1])
    padded = header.ljust(first - _HEADER_AT, b"\0")
    file.seek(0)
    file.write(start + _CHECKSUM.pack(zlib.crc32(start + padded)) + padded)


def _write_array(file: BinaryIO, source: Source) -> str:
    """Write an array and the zeros after it; their checksum."""
    array = np.ascontiguousarray(source.read())
    assert (array.dtype, array.shape) == (source.dtype, source.shape), source.name
    data = array.reshape(-1).view(np.uint8).data
    zeros = bytes(whole_pages(array.nbytes) - array.nbytes)
    file.write(data)
    file.write(zeros)
    return _text(zlib.crc32(zeros, zlib.crc32(data)))


def _text(checksum: int) -> str:
    return f"{checksum:08x}"


def read(path: Path) -> tuple[Facts, dict[str, npt.NDArray[Any]]]:
    """What a file says, and its arrays by name, mapped: pages are read when they are used.

    What is written to the arrays stays in this process.

    Raises
    ------
    GridFileError
        If there is no such file, or it is not as it was written.
    """
    pages = _mapped(path)
    header, first = _checked_header(path, pages)
    arrays = {section.name: _checked_array(path, pages[first:], section) for section in header.arrays}
    return header.facts, arrays


def _mapped(path: Path) -> npt.NDArray[np.uint8]:
    if path.is_dir():
        raise GridFileError(f"{path}: is a folder; name the file of a grid")
    if not path.exists():
        raise GridFileError(f"{path}: no such file; grid.save(path) writes one")
    if not path.is_file() or path.stat().st_size < _HEADER_AT:
        raise _foreign(path)
    try:
        return np.memmap(path, np.uint8, "c").view(np.ndarray)
    except OSError as error:
        raise GridFileError(f"{path}: cannot be read ({error.strerror or error})") from error


def _foreign(path: Path) -> GridFileError:
    return GridFileError(f"{path}: not the file of a grid; grid.save(path) writes one")


def _altered(path: Path, what: str) -> GridFileError:
    return GridFileError(
        f"{path}: altered since it was written ({what} differs from its checksum); save anew"
    )


def _checked_header(path: Path, pages: npt.NDArray[np.uint8]) -> tuple[Header, int]:
    """The header, and where arrays start, once both are known to be as written."""
    start = pages[: _START.size].tobytes()
    magic, version, _, header_bytes, file_bytes = _START.unpack(start)
    if magic != MAGIC:
        raise _foreign(path)
    if version != FORMAT:
        raise GridFileError(
            f"{path}: format version {version}, and this clgrid reads {FORMAT}; build the grid anew"
        )
    if len(pages) < file_bytes:
        raise GridFileError(
            f"{path}: truncated, {len(pages):,} of {file_bytes:,} bytes are there; save it anew"
        )
    first = whole_pages(_HEADER_AT + header_bytes)
    if len(pages) > file_bytes or first > file_bytes:
        raise _altered(path, "its size")
    (checksum,) = _CHECKSUM.unpack(pages[_START.size : _HEADER_AT].tobytes())
    if zlib.crc32(pages[_HEADER_AT:first].data, zlib.crc32(start)) != checksum:
        raise _altered(path, "the header")
    try:
        text = pages[_HEADER_AT : _HEADER_AT + header_bytes].tobytes()
        return msgspec.json.decode(text, type=Header), first
    except msgspec.MsgspecError:
        raise _foreign(path) from None


def _checked_array(path: Path, pages: npt.NDArray[np.uint8], section: Section) -> npt.NDArray[Any]:
    """An array, once its bytes are known to be as written."""
    dtype = np.dtype(section.dtype)
    if not dtype.isnative:
        raise GridFileError(f"{path}: written on a machine of another byte order; build the grid on this one")
    nbytes = int(np.prod(section.shape, dtype=np.int64)) * dtype.itemsize
    own = pages[section.start : section.start + whole_pages(nbytes)]
    if _text(zlib.crc32(own.data)) != section.checksum:
        raise _altered(path, section.name)
    return own[:nbytes].view(dtype).reshape(section.shape)
