"""Corners of OBJ faces: ``v``, ``v/vt``, ``v//vn`` and ``v/vt/vn`` words into indices."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgrid.errors import MeshError
from clgrid.meshfile.numbers import int_tokens

NO_NORMAL = -1
FLUSH = 1 << 20
"""Corners kept as Python objects before they become numbers: bounds the scratch memory."""

IntArray = npt.NDArray[np.int64]

_ABSENT = np.iinfo(np.int64).min


@dataclass(frozen=True)
class Resolved:
    """Faces by index.

    Attributes
    ----------
    counts : (P,) int64
        Corners of each face.
    positions : (C,) int64
        Vertex of each corner.
    normals : (C,) int64
        Normal of each corner, `NO_NORMAL` where it has none.
    """

    counts: npt.NDArray[np.int64]
    positions: npt.NDArray[np.int64]
    normals: npt.NDArray[np.int64]


class Corners:
    """Faces in the order of the file, with what relative indices need: how much stood before each."""

    def __init__(self) -> None:
        self.count = 0
        self._words: list[bytes] = []
        self._rows: list[tuple[int, int, int, int, int]] = []
        self._done: list[tuple[IntArray, IntArray]] = []

    def add(self, words: list[bytes], line: int, positions: int, normals: int, coordinates: int) -> None:
        """Add one face from line ``line``, where so many of each have been read."""
        self._words += words
        self._rows.append((len(words), line, positions, normals, coordinates))
        self.count += 1
        if len(self._words) > FLUSH:
            self._flush()

    def resolved(self, positions: int, normals: int) -> Resolved:
        """All faces with indices that count from 0, checked against the numbers of positions and normals.

        Raises
        ------
        MeshError
            For a word that is no index and for an index that is 0 or names nothing; with its line.
        """
        rows, written = self._all()
        counts = rows[:, 0]
        lines = np.repeat(rows[:, 1], counts)
        position_of = _absolute(written[:, 0], np.repeat(rows[:, 2], counts), positions, lines, "vertex")
        normal_of = np.full(len(written), NO_NORMAL, np.int64)
        given = written[:, 2] != _ABSENT
        before = np.repeat(rows[:, 3], counts)[given]
        normal_of[given] = _absolute(written[given, 2], before, normals, lines[given], "normal")
        return Resolved(counts, position_of, normal_of)

    def coordinates(self, count: int) -> tuple[IntArray, int]:
        """Texture coordinates of each corner of all faces.

        Parameters
        ----------
        count : int
            How many there are; a corner that has none, or one that is missing, gets this number.

        Returns
        -------
        (C,) int64, int
            Rows, and how many corners name a missing one.
        """
        rows, written = self._all()
        named = written[:, 1]
        found = np.where(named > 0, named - 1, np.repeat(rows[:, 4], rows[:, 0]) + named)
        absent = named == _ABSENT
        bad = (named == 0) | (found < 0) | (found >= count)
        return np.where(bad | absent, count, found), int(np.count_nonzero(bad & ~absent))

    def _all(self) -> tuple[IntArray, IntArray]:
        """(P, 5) of the faces, and (C, 3) of the corners: indices as written."""
        self._flush()
        if not self._done:
            return np.zeros((0, 5), np.int64), np.zeros((0, 3), np.int64)
        rows, written = (np.concatenate(part) for part in zip(*self._done, strict=True))
        self._done = [(rows, written)]
        return rows, written

    def _flush(self) -> None:
        if self._rows:
            rows = np.array(self._rows, np.int64)
            self._done.append((rows, _indices(self._words, rows)))
            self._words.clear()
            self._rows.clear()


def _absolute(
    written: npt.NDArray[np.int64],
    before: npt.NDArray[np.int64],
    count: int,
    lines: npt.NDArray[np.int64],
    what: str,
) -> npt.NDArray[np.int64]:
    """Indices from 0: positive ones count from 1, negative ones back from the statement."""
    index = np.where(written > 0, written - 1, before + written)
    bad = np.flatnonzero((written == 0) | (index < 0) | (index >= count))
    if len(bad):
        reason = "0, and OBJ counts from 1" if written[bad[0]] == 0 else f"{written[bad[0]]} of {count}"
        raise MeshError(
            f"OBJ line {lines[bad[0]]} names {what} {reason} ({len(bad)} such corners); "
            "repair or re-export the file"
        )
    return index


def _indices(words: list[bytes], rows: IntArray) -> IntArray:
    """(C, 3) position, texture coordinates and normal of each corner as written, `_ABSENT` for none."""
    text = b" ".join(words)
    table = np.full((len(words), 3), _ABSENT, np.int64)
    if b"/" not in text:
        numbers = int_tokens(text)
        if numbers is not None and len(numbers) == len(words):
            table[:, 0] = numbers
            return table
        return _indices_by_word(words, rows)
    # the common case: all corners written alike
    slashes = words[0].count(b"/")
    if slashes in (1, 2) and _all_have(text, slashes):
        double = text.count(b"//")
        numbers = int_tokens(text.replace(b"//", b" ").replace(b"/", b" "))
        if (
            numbers is not None
            and double in (0, len(words))
            and slashes + 1 - (double > 0) == len(numbers) / len(words)
        ):
            places = [0, 2] if double else [0, 1, 2][: slashes + 1]
            table[:, places] = numbers.reshape(len(words), -1)
            return table
    return _indices_by_word(words, rows)


def _all_have(text: bytes, slashes: int) -> bool:
    """Whether every word of ``text`` holds exactly so many slashes."""
    letters = np.frombuffer(text + b" ", np.uint8)
    so_far = np.cumsum(letters == ord("/"))[letters == ord(" ")]
    return bool((so_far == slashes * np.arange(1, len(so_far) + 1)).all())


def _indices_by_word(words: list[bytes], rows: IntArray) -> IntArray:
    table = []
    for number, word in enumerate(words):
        fields = word.split(b"/")
        try:
            if len(fields) > 3 or b"_" in word:
                raise ValueError
            third = _bounded(fields[2]) if len(fields) == 3 and fields[2] else _ABSENT
            table.append((_bounded(fields[0]), _coordinate(fields), third))
        except ValueError:
            face = int(np.searchsorted(np.cumsum(rows[:, 0]), number, side="right"))
            raise MeshError(
                f"OBJ line {rows[face, 1]}: {word[:40]!r} is no corner of a face; correct it"
            ) from None
    return np.array(table, np.int64).reshape(-1, 3)


def _coordinate(fields: list[bytes]) -> int:
    """Texture coordinates as written; what is no number names none, for triangles do not need them."""
    try:
        return _bounded(fields[1]) if len(fields) > 1 and fields[1] else _ABSENT
    except ValueError:
        return 0


def _bounded(word: bytes) -> int:
    """Index as written, brought into 64 bits: what is beyond names nothing anyway."""
    return max(-(2**62), min(2**62, int(word)))
