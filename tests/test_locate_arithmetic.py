"""Exact arithmetic with each step rounded: against numpy's own, and against errors that are planted."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clgrid.locate.arithmetic import (
    CORRECT,
    Model,
    Number,
    UnknownError,
    consistent,
    evaluate,
    names_of,
    rounded,
)

F32 = np.float32
CONTRACTION = "contraction: a product and a sum rounded once (fma)"
FINITE = st.floats(allow_nan=False, allow_infinity=False, width=32)


def numbers(kind: str, **values: float) -> dict[str, Number]:
    return {name: Number(Fraction(float(value)), kind) for name, value in values.items()}


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_rounding_to_float32_is_numpys(x: float) -> None:
    with np.errstate(all="ignore"):
        expected = float(F32(x))
    if np.isinf(expected):
        with pytest.raises(UnknownError):
            rounded(Fraction(x), "float")
    else:
        assert rounded(Fraction(x), "float") == Fraction(expected)


@given(FINITE, FINITE)
def test_rounding_a_quotient_to_float64_is_the_processors(a: float, b: float) -> None:
    if b == 0:
        return
    assert rounded(Fraction(a) / Fraction(b), "double") == Fraction(a / b)


def test_rounding_at_the_ends_of_the_format() -> None:
    least = Fraction(2) ** -149
    assert rounded(least / 2, "float") == 0  # ties to even
    assert rounded(least * Fraction(3, 4), "float") == least
    assert rounded(least * Fraction(3, 4), "float", down=True) == 0
    largest = Fraction(float(np.finfo(F32).max))
    assert rounded(largest + 1, "float") == largest
    with pytest.raises(UnknownError):
        rounded(largest * 2, "float")


@given(*[FINITE] * 4)
def test_each_step_is_rounded_as_numpy_rounds_it(a: float, b: float, c: float, d: float) -> None:
    with np.errstate(all="ignore"):
        expected = F32(a) * F32(b) - F32(c) * F32(d)
        finite = np.isfinite(F32(a) * F32(b)) and np.isfinite(F32(c) * F32(d)) and np.isfinite(expected)
    names = numbers("float", a=a, b=b, c=c, d=d)
    if finite:
        assert evaluate("x = a * b - c * d", names, "float", Model(CORRECT)) == Fraction(float(expected))
    else:
        with pytest.raises(UnknownError):
            evaluate("x = a * b - c * d", names, "float", Model(CORRECT))


def test_a_float_and_a_double_make_a_double() -> None:
    third = F32(1 / 3)
    names = numbers("float", a=third) | numbers("double", d=1e-9)
    assert evaluate("x = a + d", names, "double", Model(CORRECT)) == Fraction(float(third) + 1e-9)
    assert evaluate("x = float(a + d)", names, "float", Model(CORRECT)) == Fraction(float(third))


def fused(a: float, b: float, c: float) -> Fraction:
    return rounded(Fraction(a) * Fraction(b) + Fraction(c), "float")


def test_a_contracted_product_is_told_from_a_rounded_one() -> None:
    rng = np.random.default_rng(2)
    found = set()
    for cx, by, cy, bx in rng.normal(size=(200, 4)).astype(F32).tolist():
        names = numbers("float", cx=cx, by=by, cy=cy, bx=bx)
        strict = F32(cx) * F32(by) - F32(cy) * F32(bx)
        assert consistent("u = cx * by - cy * bx", names, "float", Fraction(float(strict))) == (CORRECT,)
        for value in (fused(cx, by, -float(F32(cy) * F32(bx))), fused(-cy, bx, float(F32(cx) * F32(by)))):
            ways = consistent("u = cx * by - cy * bx", names, "float", value)
            assert ways is not None
            assert ways == (CORRECT,) or CONTRACTION in ways
            found.add(ways)
    # Most are fused and nothing else.
    assert (CONTRACTION,) in found
    assert (
        consistent("u = cx * by - cy * bx", numbers("float", cx=1, by=1, cy=1, bx=2), "float", Fraction(7))
        == ()
    )


def test_a_reciprocal_is_told_from_a_quotient() -> None:
    x, z = F32(0.3), F32(0.9)
    value = Fraction(float(x * (F32(1) / z)))
    assert value != Fraction(float(x / z))
    names = numbers("float", x=x, z=z)
    ways = consistent("s = float(double(x) / double(z))", names, "float", value)
    assert ways == ("a product with a reciprocal in float32 in place of a quotient",)


def test_flushed_subnormals_and_wide_steps_are_told() -> None:
    small = numbers("float", a=2.0**-130, b=1.0)
    assert consistent("x = a * b", small, "float", Fraction(0)) == ("subnormal numbers flushed to zero",)
    wide = numbers("float", a=2.0**24, b=1.0, c=-(2.0**24))
    ways = consistent("x = (a + b) + c", wide, "float", Fraction(1))
    assert ways == ("float32 steps computed in float64",)


def test_what_cannot_be_followed_is_not_told() -> None:
    assert consistent("x = a / b", numbers("float", a=1, b=0), "float", Fraction(1)) is None
    assert consistent("x = a + missing", numbers("float", a=1), "float", Fraction(1)) is None
    assert consistent("x = unknown()", {}, "float", Fraction(1)) is None


def test_choices_and_statements_follow_the_values() -> None:
    text = "m = max(abs(a), b); far = m > 2\nx = a * 2 if far else b"
    assert names_of(text) == ["a", "b"]
    assert evaluate(text, numbers("double", a=-3, b=1), "double", Model(CORRECT)) == -6
    assert evaluate(text, numbers("double", a=1, b=2), "double", Model(CORRECT)) == 2
    assert evaluate("n = long(a)", numbers("double", a=-2.75), "long", Model(CORRECT)) == -2
