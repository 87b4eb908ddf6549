"""The rungs of the accuracy ladder, as kernels are compiled for them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Rung:
    """A rung of the accuracy ladder.

    Attributes
    ----------
    name : str
    defines : dict
        The options with which kernels are compiled.
    real : numpy dtype
        Of a ray's local t and of weights.
    wide : bool
        Whether vertices keep the digits of float64.
    lossless : bool
        Whether a grid's hits are those of brute force, bit for bit.
    nearest_reals : int
        Of ``real`` that a nearest hit takes on its way from one part of a mesh to the next (cl/parts.h).
    """

    name: str
    defines: dict[str, int | str]
    real: type[np.floating[Any]]
    wide: bool
    lossless: bool
    nearest_reals: int = 1


_ALL = (
    Rung("fast", {"RUNG_FAST": 1}, np.float32, wide=False, lossless=False),
    Rung("robust", {}, np.float32, wide=False, lossless=True),
    Rung("precise", {"RUNG_PRECISE": 1}, np.float64, wide=True, lossless=True),
    Rung("exact", {"RUNG_EXACT": 1}, np.float64, wide=True, lossless=True, nearest_reals=11),
)
RUNGS = {rung.name: rung for rung in _ALL}
ACCURACIES = tuple(RUNGS)
LOSSLESS = tuple(rung.name for rung in _ALL if rung.lossless)
"""Rungs whose hits through a grid are those of brute force, bit for bit."""
