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
        self._rows: list[tuple[int, int, int, int]] = []
        self._done: list[tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], npt.NDArray[np.int64]]] = []

    def add(self, words: list[bytes], line: int, positions: int, normals: int) -> None:
        """Add one face from line ``line``, where so many positions and normals have been read."""
        self._words += words
        self._rows.append((len(words), line, positions, normals))
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
        self._flush()
        if not self._done:
            nothing = np.zeros(0, np.int64)
            return Resolved(nothing, nothing, nothing)
        rows, first, third = (np.concatenate(column) for column in zip(*self._done, strict=True))
        counts = rows[:, 0]
        lines = np.repeat(rows[:, 1], counts)
        position_of = _absolute(first, np.repeat(rows[:, 2], counts), positions, lines, "vertex")
        normal_of = np.full(len(third), NO_NORMAL, np.int64)
        given = third != _ABSENT
        before = np.repeat(rows[:, 3], counts)[given]
        normal_of[given] = _absolute(third[given], before, normals, lines[given], "normal")
        return Resolved(counts, position_of, normal_of)

    def _flush(self) -> None:
        if self._rows:
            rows = np.array(self._rows, np.int64)
            self._done.append((rows, *_indices(self._words, rows)))
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


def _indices(
    words: list[bytes], rows: npt.NDArray[np.int64]
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Position and normal of each corner as written, `_ABSENT` for no normal."""
    text = b" ".join(words)
    absent = np.full(len(words), _ABSENT, np.int64)
    if b"/" not in text:
        numbers = int_tokens(text)
        if numbers is not None and len(numbers) == len(words):
            return numbers, absent
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
            table = numbers.reshape(len(words), -1)
            return table[:, 0], table[:, -1] if slashes == 2 else absent
    return _indices_by_word(words, rows)


def _all_have(text: bytes, slashes: int) -> bool:
    """Whether every word of ``text`` holds exactly so many slashes."""
    letters = np.frombuffer(text + b" ", np.uint8)
    so_far = np.cumsum(letters == ord("/"))[letters == ord(" ")]
    return bool((so_far == slashes * np.arange(1, len(so_far) + 1)).all())


def _indices_by_word(
    words: list[bytes], rows: npt.NDArray[np.int64]
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    first, third = [], []
    for number, word in enumerate(words):
        fields = word.split(b"/")
        try:
            if len(fields) > 3 or b"_" in word:
                raise ValueError
            first.append(_bounded(fields[0]))
            third.append(_bounded(fields[2]) if len(fields) == 3 and fields[2] else _ABSENT)
        except ValueError:
            face = int(np.searchsorted(np.cumsum(rows[:, 0]), number, side="right"))
            raise MeshError(
                f"OBJ line {rows[face, 1]}: {word[:40]!r} is no corner of a face; correct it"
            ) from None
    return np.array(first, np.int64), np.array(third, np.int64)


def _bounded(word: bytes) -> int:
    """Index as written, brought into 64 bits: what is beyond names nothing anyway."""
    return max(-(2**62), min(2**62, int(word)))
