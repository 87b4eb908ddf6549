"""Numbers written as text, many at a time."""

from __future__ import annotations

import warnings

import numpy as np
import numpy.typing as npt

from clgrid.errors import MeshError
from clgrid.mesh import FloatArray

FAR = 16.0
"""Largest coordinate over largest extent beyond which float32 rounding of text costs shape (4 of its 24 bits)."""


def float_tokens(text: bytes, what: str) -> npt.NDArray[np.float64]:
    """Parse whitespace-separated decimal numbers, NaN and infinities included.

    Parameters
    ----------
    text : bytes
        Nothing but numbers and whitespace.
    what : str
        Names the text in the error.

    Returns
    -------
    (N,) float64

    Raises
    ------
    MeshError
        If anything else is in the text, with the first such word.
    """
    if not text.strip():
        return np.zeros(0, np.float64)
    with warnings.catch_warnings():
        # numpy before 2.3 warns about the rest it could not read, later ones raise ValueError
        warnings.simplefilter("error", DeprecationWarning)
        try:
            return np.fromstring(text, dtype=np.float64, sep=" ")
        except (DeprecationWarning, ValueError) as error:
            raise MeshError(f"{what}: {_first_bad_word(text)}; correct or re-export the file") from error


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


def narrowed_text(vertices: npt.NDArray[np.float64]) -> FloatArray:
    """Hand back float32 unless rounding to it would cost shape: the rule for formats without a stated type.

    The doubles stay where the largest coordinate exceeds `FAR` times the largest extent, and where a coordinate
    or the extent is outside the normal range of float32. Vertices that are not finite do not count.

    Parameters
    ----------
    vertices : (V, 3) float64

    Returns
    -------
    (V, 3) float32 or float64
    """
    limits = np.finfo(np.float32)
    finite = vertices[np.isfinite(vertices).all(axis=1)]
    if len(finite):
        extent = float((finite.max(axis=0) - finite.min(axis=0)).max())
        largest = float(np.abs(finite).max())
        outside = largest > float(limits.max) or 0.0 < extent < float(limits.tiny)
        if outside or (largest > FAR * extent > 0.0):
            return narrowed_exact(vertices)
    with np.errstate(over="ignore", invalid="ignore"):
        return vertices.astype(np.float32)
