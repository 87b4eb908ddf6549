"""What an operation gives with each step rounded: as it should be, and as compilers and devices err.

Statements are Python's, of the names in ``stages``, with C's types: a float and a double make a double.
Numbers are rational, so that nothing here depends on how this machine rounds.
"""

from __future__ import annotations

import ast
import itertools
import math
import operator
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cache

# Digits, and the exponents of the least subnormal and of the least number beyond the largest.
_FORMATS = {"float": (24, -149, 128), "double": (53, -1074, 1024)}
# Sums that take a product, whose ways of being fused are all tried; of more, each alone and all together.
_MOST_SITES = 4

CORRECT = "each step rounded to the nearest"


class UnknownError(Exception):
    """The host does not follow this operation, or one of its numbers is none."""


@dataclass(frozen=True)
class Number:
    """A value with its C type: ``float``, ``double`` or ``long``."""

    value: Fraction
    type: str


@dataclass(frozen=True)
class Model:
    """A way to compute.

    Attributes
    ----------
    name : str
    fused : tuple of int
        For each sum that takes a product, in order: 0, or which operand is taken unrounded, 1 or 2.
    reciprocal : str
        Quotients are products with a reciprocal, rounded to this type; "same": to the quotient's.
    flush : bool
        Whether subnormal floats are 0, as operands and as results.
    wide : bool
        Whether floats are computed as doubles, and rounded at the end.
    down : bool
        Whether results are cut off towards 0.
    """

    name: str
    fused: tuple[int, ...] = ()
    reciprocal: str = ""
    flush: bool = False
    wide: bool = False
    down: bool = False


def rounded(value: Fraction, kind: str, *, down: bool = False) -> Fraction:
    """The nearest number of a format, ties to even; or the one towards 0.

    Raises
    ------
    UnknownError
        Beyond the largest.
    """
    digits, least, beyond = _FORMATS[kind]
    if value == 0:
        return value
    size = abs(value)
    exponent = size.numerator.bit_length() - size.denominator.bit_length()
    exponent += size >= Fraction(2) ** exponent
    unit = Fraction(2) ** max(exponent - digits, least)
    steps = size / unit
    size = unit * (math.floor(steps) if down else round(steps))
    if size >= Fraction(2) ** beyond:
        raise UnknownError
    return size if value > 0 else -size


@dataclass
class _Evaluation:
    """One run through the statements."""

    model: Model
    names: dict[str, Number]
    sites: int = 0
    # The exact values of products that a sum may take unrounded.
    exact: dict[int, Fraction] = field(default_factory=dict)

    def run(self, body: list[ast.stmt]) -> Number:
        result = Number(Fraction(0), "double")
        for statement in body:
            assert isinstance(statement, ast.Assign)
            assert isinstance(statement.targets[0], ast.Name)
            result = self.of(statement.value)
            self.names[statement.targets[0].id] = result
        return result

    def fit(self, value: Fraction, kind: str) -> Number:
        """The result of a step."""
        if kind == "long":
            return Number(value, kind)
        at = "double" if self.model.wide else kind
        result = rounded(value, at, down=self.model.down)
        return Number(self.flushed(result, kind), kind)

    def flushed(self, value: Fraction, kind: str) -> Fraction:
        digits, least, _ = _FORMATS[kind]
        small = self.model.flush and abs(value) < Fraction(2) ** (least + digits - 1)
        return Fraction(0) if small else value

    def of(self, node: ast.expr) -> Number:
        if isinstance(node, ast.Name):
            if node.id not in self.names:
                raise UnknownError
            known = self.names[node.id]
            return (
                known if known.type == "long" else replace(known, value=self.flushed(known.value, known.type))
            )
        if isinstance(node, ast.Constant):
            assert isinstance(node.value, int | float)
            return Number(Fraction(node.value), "double" if isinstance(node.value, float) else "long")
        if isinstance(node, ast.UnaryOp):
            of = self.of(node.operand)
            return Number(-of.value, of.type)
        if isinstance(node, ast.BinOp):
            return self.combined(node)
        if isinstance(node, ast.IfExp):
            return self.of(node.body if self.holds(node.test) else node.orelse)
        if isinstance(node, ast.Compare | ast.BoolOp):
            return Number(Fraction(int(self.holds(node))), "long")
        assert isinstance(node, ast.Call)
        assert isinstance(node.func, ast.Name)
        return _CALLS[node.func.id](self, [self.of(each) for each in node.args])

    def holds(self, node: ast.expr) -> bool:
        if isinstance(node, ast.BoolOp):
            answers = (self.holds(each) for each in node.values)
            return any(answers) if isinstance(node.op, ast.Or) else all(answers)
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            return not self.holds(node.operand)
        if isinstance(node, ast.Compare):
            left, right = self.of(node.left).value, self.of(node.comparators[0]).value
            return _COMPARISONS[type(node.ops[0])](left, right)
        return self.of(node).value != 0

    def combined(self, node: ast.BinOp) -> Number:
        left, right = self.of(node.left), self.of(node.right)
        kind = _wider(left.type, right.type)
        a, b = left.value, right.value
        if isinstance(node.op, ast.Mult):
            result = self.fit(a * b, kind)
            self.exact[id(node)] = a * b
            return result
        if isinstance(node.op, ast.Div):
            return self.quotient(a, b, kind)
        a, b = self.unrounded(node, a, b)
        return self.fit(a + b if isinstance(node.op, ast.Add) else a - b, kind)

    def unrounded(self, node: ast.BinOp, a: Fraction, b: Fraction) -> tuple[Fraction, Fraction]:
        """The operands of a sum, one of them perhaps a product as it is before it is rounded."""
        products = [side for side in (node.left, node.right) if id(side) in self.exact]
        if not products:
            return a, b
        fused = self.model.fused
        way = fused[self.sites] if self.sites < len(fused) else 0
        self.sites += 1
        # Names of products are not fused: a statement ends there (C99, 6.5.8).
        if way == 1 and id(node.left) in self.exact:
            return self.exact[id(node.left)], b
        if way == 2 and id(node.right) in self.exact:
            return a, self.exact[id(node.right)]
        return a, b

    def quotient(self, a: Fraction, b: Fraction, kind: str) -> Number:
        if b == 0:
            raise UnknownError
        if not self.model.reciprocal:
            return self.fit(a / b, kind)
        narrow = self.model.reciprocal if self.model.reciprocal != "same" else kind
        one = self.fit(Fraction(1), kind).value
        return self.fit(self.fit(a * self.fit(one / b, narrow).value, narrow).value, kind)


def _wider(left: str, right: str) -> str:
    order = ("long", "float", "double")
    return max(left, right, key=order.index)


def _least(_: _Evaluation, of: list[Number]) -> Number:
    return min(of, key=lambda each: each.value)


def _greatest(_: _Evaluation, of: list[Number]) -> Number:
    return max(of, key=lambda each: each.value)


def _converted(kind: str) -> Callable[[_Evaluation, list[Number]], Number]:
    return lambda run, of: run.fit(of[0].value, kind)


def _unknown(_: _Evaluation, of: list[Number]) -> Number:
    raise UnknownError


def _clamped(_: _Evaluation, of: list[Number]) -> Number:
    """Within START_LIMIT of cl/config.h."""
    return Number(max(Fraction(-2), min(Fraction(2), of[0].value)), of[0].type)


_CALLS: dict[str, Callable[[_Evaluation, list[Number]], Number]] = {
    "min": _least,
    "max": _greatest,
    "abs": lambda run, of: Number(abs(of[0].value), of[0].type),
    "float": _converted("float"),
    "double": _converted("double"),
    "long": lambda run, of: Number(Fraction(math.trunc(of[0].value)), "long"),
    "clamped": _clamped,
    "unknown": _unknown,
}
_COMPARISONS: dict[type[ast.cmpop], Callable[[Fraction, Fraction], bool]] = {
    ast.Lt: operator.lt,
    ast.Gt: operator.gt,
    ast.NotEq: operator.ne,
    ast.Eq: operator.eq,
}


@cache
def _body(operation: str) -> list[ast.stmt]:
    return ast.parse(operation).body


def names_of(operation: str) -> list[str]:
    """The values that an operation takes, in the order in which it names them."""
    made: set[str] = set()
    found: list[str] = []
    for statement in _body(operation):
        assert isinstance(statement, ast.Assign)
        names = [node for node in ast.walk(statement.value) if isinstance(node, ast.Name)]
        for name in sorted(names, key=lambda node: (node.lineno, node.col_offset)):
            if name.id not in made and name.id not in _CALLS and name.id not in found:
                found.append(name.id)
        made |= {target.id for target in statement.targets if isinstance(target, ast.Name)}
    return found


def evaluate(operation: str, names: Mapping[str, Number], kind: str, model: Model) -> Fraction:
    """The value of an operation that gives the type ``kind``.

    Raises
    ------
    UnknownError
        If it cannot be told.
    """
    result = _Evaluation(model, dict(names)).run(_body(operation))
    # What was computed in wider numbers is rounded in the end.
    return result.value if kind == "long" else rounded(result.value, kind)


def models_of(operation: str, names: Mapping[str, Number], kind: str) -> Iterator[Model]:
    """The ways in which an operation may have been computed wrongly."""
    run = _Evaluation(Model(""), dict(names))
    run.run(_body(operation))
    sites = run.sites
    if sites <= _MOST_SITES:
        ways = [way for way in itertools.product((0, 1, 2), repeat=sites) if any(way)]
    else:
        alone = [tuple(side if i == k else 0 for i in range(sites)) for k in range(sites) for side in (1, 2)]
        ways = [(1,) * sites, (2,) * sites, *alone]
    for way in ways:
        yield Model("contraction: a product and a sum rounded once (fma)", fused=way)
    yield Model("a product with a rounded reciprocal in place of a quotient", reciprocal="same")
    yield Model("a product with a reciprocal in float32 in place of a quotient", reciprocal="float")
    yield Model("subnormal numbers flushed to zero", flush=True)
    if kind == "float":
        yield Model("float32 steps computed in float64", wide=True)
    yield Model("results cut off towards zero", down=True)


def consistent(
    operation: str, names: Mapping[str, Number], kind: str, value: Fraction
) -> tuple[str, ...] | None:
    """Names of the models that give this value, each once; the right one alone, if it does.

    None if the operation cannot be followed.
    """
    try:
        if evaluate(operation, names, kind, Model(CORRECT)) == value:
            return (CORRECT,)
    except UnknownError:
        return None
    found: list[str] = []
    for model in models_of(operation, names, kind):
        try:
            gives = evaluate(operation, names, kind, model) == value
        except UnknownError:
            continue
        if gives and model.name not in found:
            found.append(model.name)
    return tuple(found)
