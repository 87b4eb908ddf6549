"""Numbers written as text, many at a time."""

from __future__ import annotations

import warnings
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from clgrid.errors import MeshError
from clgrid.mesh import FloatArray

Number = TypeVar("Number", np.float64, np.int64)

FAR = 16.0
"""Largest coordinate over largest extent from which float32 rounding costs shape: 4 of its 24 bits."""


def float_tokens(text: bytes, what: str, count: int | None = None) -> npt.NDArray[np.float64]:
    """Parse whitespace-separated decimal numbers, NaN and infinities included.

    Parameters
    ----------
    text : bytes
        Nothing but numbers and whitespace.
    what : str
        Names the text in the error.
    count : int, optional
        How many numbers there must be.

    Returns
    -------
    (N,) float64

    Raises
    ------
    MeshError
        If anything else is in the text, with the first such word, or another number of numbers.
    """
    numbers = _tokens(text, np.float64)
    if numbers is None or count not in (None, len(numbers)):
        raise MeshError(f"{what}: {_first_bad_word(text)}; correct or re-export the file")
    return numbers


def int_tokens(text: bytes) -> npt.NDArray[np.int64] | None:
    """Parse whitespace-separated whole numbers; None if anything else is in the text.

    Numbers beyond 64 bits become the largest or smallest that fits.
    """
    return _tokens(text, np.int64)


def _tokens(text: bytes, dtype: type[Number]) -> npt.NDArray[Number] | None:
    if not text.strip():
        return np.zeros(0, dtype)
    with warnings.catch_warnings():
        # numpy up to 2.3 warns about the rest it could not read, later ones raise ValueError
        warnings.simplefilter("error", DeprecationWarning)
        try:
            return np.fromstring(text, dtype=dtype, sep=" ")
        except (DeprecationWarning, ValueError):
            return None


def _first_bad_word(text: bytes) -> str:
    for number, word in enumerate(text.split()):
        try:
            # Python also reads 1_000, which is no number in a mesh file
            if b"_" not in word:
                float(word)
                continue
        except ValueError:
            pass
        return f"number {number} is {word[:40]!r}"
    return "a number cannot be parsed"


def narrowed_exact(vertices: npt.NDArray[np.float64]) -> FloatArray:
    """Hand back float32 where it holds every value exactly, else the doubles."""
    with np.errstate(over="ignore", invalid="ignore"):
        narrow = vertices.astype(np.float32)
    return narrow if np.array_equal(narrow, vertices, equal_nan=True) else vertices


def narrowed_text(vertices: npt.NDArray[np.float64], faces: npt.NDArray[np.uint32]) -> FloatArray:
    """Hand back float32 unless rounding costs shape: the rule for formats that do not state a type.

    The doubles stay where the largest coordinate exceeds `FAR` times the largest extent, and where a
    coordinate or the extent is outside the normal range of float32; unless float32 holds all of them exactly.
    Only finite vertices that a triangle uses count.

    Parameters
    ----------
    vertices : (V, 3) float64
    faces : (F, 3) uint32
        All below ``V``.

    Returns
    -------
    (V, 3) float32 or float64
    """
    limits = np.finfo(np.float32)
    counted = np.zeros(len(vertices), np.bool_)
    counted[faces.reshape(-1)] = True
    counted &= np.isfinite(vertices).all(axis=1)
    if counted.any():
        corners = vertices[counted]
        extent = float((corners.max(axis=0) - corners.min(axis=0)).max())
        largest = float(np.abs(corners).max())
        outside = largest > float(limits.max) or extent < float(limits.tiny)
        if outside or largest > FAR * extent:
            return narrowed_exact(vertices)
    with np.errstate(over="ignore", invalid="ignore"):
        return vertices.astype(np.float32)
