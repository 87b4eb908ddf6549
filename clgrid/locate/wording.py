"""What a trace holds as numbers and as words: bits to values, and a difference in a sentence."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence

import numpy as np

from clgrid.locate.arithmetic import Number
from clgrid.locate.stages import BOOL, DOUBLE, FLOAT, LONG, TRIANGLE
from clgrid.repro_record import AnswerRecord, Difference, NumberRecord, SideRecord

NO_HIT = 0xFFFFFFFF


def value_of(kind: str, bits: int) -> tuple[float, str]:
    """The number that the bits of a value are, and its type in arithmetic."""
    if kind == FLOAT:
        single: float = struct.unpack("<f", struct.pack("<I", bits & 0xFFFFFFFF))[0]
        return single, FLOAT
    if kind == DOUBLE:
        double: float = struct.unpack("<d", struct.pack("<Q", bits))[0]
        return double, DOUBLE
    return bits - (1 << 64) if bits >> 63 else bits, LONG


def shown(kind: str, bits: int, triangle: str = "") -> NumberRecord:
    """A value of a trace; ``triangle`` is what one is called, if it is one."""
    value, _ = value_of(kind, bits)
    if kind == FLOAT:
        return NumberRecord(f"{bits:#010x}", str(np.float32(value)))
    if kind == DOUBLE:
        return NumberRecord(f"{bits:#018x}", repr(value))
    words = triangle if kind == TRIANGLE else ("no", "yes")[bits != 0] if kind == BOOL else str(value)
    return NumberRecord(f"{bits:#x}", words)


def shown_number(known: Number) -> NumberRecord:
    """A number of arithmetic."""
    if known.type == LONG:
        return shown(LONG, int(known.value) % (1 << 64))
    if known.type == FLOAT:
        return shown(FLOAT, int(np.float32(float(known.value)).view(np.uint32)))
    return shown(DOUBLE, int(np.float64(float(known.value)).view(np.uint64)))


def ulps_between(kind: str, a: int, b: int) -> int | None:
    """Floating-point numbers from one to the other; None for what is none."""
    if kind not in (FLOAT, DOUBLE) or any(math.isnan(value_of(kind, bits)[0]) for bits in (a, b)):
        return None
    sign = 1 << (31 if kind == FLOAT else 63)
    one, other = (bits if bits < sign else sign - bits for bits in (a, b))
    return abs(one - other)


def cell_text(cell: int, at: tuple[int, int, int] | None) -> str:
    """A cell in words."""
    return str(cell) if at is None else f"({at[0]}, {at[1]}, {at[2]})"


def answer_text(answer: AnswerRecord) -> str:
    """A hit in words, every bit of it."""
    if answer.triangle < 0:
        return "a miss"
    return f"triangle {answer.triangle}, t {answer.t}, u {answer.u}, v {answer.v}"


def labels_of(first: SideRecord, second: SideRecord) -> tuple[str, str]:
    """The two sides in words, told apart where they are the same device."""
    if first.label != second.label:
        return first.label, second.label
    one, other = (f"{side.label}{_extra(side)}" for side in (first, second))
    return (one, other) if one != other else (f"{one} once", f"{other} again")


def _extra(side: SideRecord) -> str:
    options = f" with {side.build_options}" if side.build_options else ""
    return options + (f" with another {', '.join(side.kernels)}" if side.kernels else "")


def sentence(difference: Difference, sides: tuple[SideRecord, SideRecord]) -> str:
    """Where two sides part, in a sentence."""
    labels = labels_of(*sides)
    place = "" if difference.triangle is None else f" of triangle {difference.triangle}"
    if difference.cell is not None:
        place += f" in cell {cell_text(difference.cell, difference.cell_at)}"
    both = zip(labels, (difference.first, difference.second), strict=True)
    said = ", ".join(f"{label} {value.decimal}{_bits(value)}" for label, value in both)
    off = "" if difference.ulps is None else f", {difference.ulps:,} ulp apart"
    return (
        f"{difference.stage}: {difference.operation}{place}: {said}{off}{_verdict(difference, sides, labels)}"
    )


def _bits(known: NumberRecord) -> str:
    return f" ({known.bits})" if known.bits else ""


def _verdict(difference: Difference, sides: tuple[SideRecord, SideRecord], labels: tuple[str, str]) -> str:
    """Which side is right, and what the other one may have done."""
    if not difference.nearest:
        return ""
    said = []
    for name, label, ways, side in zip(
        ("first", "second"), labels, (difference.first_as, difference.second_as), sides, strict=True
    ):
        if name == difference.nearest:
            said.append(f"{label} rounds each step to the nearest")
        else:
            said.append(f"{label} is consistent with {_ways(ways, side)}")
    return "; " + ", ".join(said)


def _ways(ways: Sequence[str], side: SideRecord) -> str:
    """What a side may have done; where several things, what all else that it did agrees with."""
    common = [way for way in ways if way in side.off_as]
    text = " or ".join(common or ways) or "nothing that is known here"
    return f"{text} ({side.off:,} of {side.checked:,} operations on this ray are off)"
