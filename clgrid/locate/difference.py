"""Two traces compared by value: the first difference, what goes into it, what each side may have done."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import zip_longest

from clgrid.locate.arithmetic import CORRECT, Number, consistent, names_of
from clgrid.locate.setting import Setting, number
from clgrid.locate.stages import BOOL, LONG, TRIANGLE, UINT, Value
from clgrid.locate.trace import Record
from clgrid.locate.wording import NO_HIT, cell_text, shown, shown_number, ulps_between, value_of
from clgrid.repro_record import Difference, NumberRecord

COURSE = "course"
"""Type of a difference in what comes next on the ray's way."""
_DECIDED = (BOOL, UINT, TRIANGLE, COURSE)
# Operations of a trace that are followed in exact arithmetic, a few thousand a second.
_MOST_CHECKED = 4096


@dataclass
class Found:
    """What is different in two traces.

    Attributes
    ----------
    first, decision : Difference or None
        The first value, and the first decision.
    differing : int
        Values, up to where the two go different ways.
    """

    first: Difference | None = None
    decision: Difference | None = None
    differing: int = 0

    def note(self, kind: str, difference: Callable[[], Difference]) -> None:
        """One more, of this type; others than the first are only counted, since to tell takes time."""
        self.differing += 1
        decided = self.decision is None and kind in _DECIDED
        if self.first is not None and not decided:
            return
        told = difference()
        self.first = self.first or told
        self.decision = told if decided else self.decision


@dataclass
class Way:
    """A ray as one side sees it.

    Attributes
    ----------
    names : dict of str to Number
        What is known so far.
    cell : int or None
        Where it is.
    """

    setting: Setting
    names: dict[str, Number]
    cell: int | None = None
    _axes: tuple[int, ...] = ()

    @classmethod
    def start(cls, setting: Setting) -> Way:
        """Before anything is computed."""
        return cls(setting, dict(setting.constants))

    def arrive(self, record: Record) -> None:
        """At what a record is of."""
        if record.stage.name == "cell":
            self.cell = record.item
        if record.stage.name == "triangle":
            self.names.update(self.setting.corners(record.item, self._axes))

    def learn(self, value: Value, bits: int) -> None:
        """A value of the record."""
        known = number(*value_of(value.type, bits))
        self.names.pop(value.name, None)
        if known is not None:
            self.names[value.name] = known
        if value.name == "kz" and value.type == LONG:
            self._axes = tuple(int(self.names[f"k{a}"].value) % 3 for a in "xyz")
            for a, axis in zip("xyz", self._axes, strict=True):
                for row in ("origin", "direction"):
                    self.names[f"{row}_k{a}"] = self.names[f"{row}_{'xyz'[axis]}"]

    def ways(self, value: Value, bits: int) -> tuple[str, ...] | None:
        """What a value is consistent with, given all before; None where the host cannot follow."""
        known = number(*value_of(value.type, bits))
        if value.operation.startswith(":") or known is None:
            return None
        return consistent(value.operation, self.names, value.type, known.value)


@dataclass
class Audit:
    """The operations of one side, each by what that side itself has computed before.

    Attributes
    ----------
    checked, off : int
        Followed, and not rounded to the nearest.
    off_as : tuple of str
        What all of those that are off are consistent with.
    """

    checked: int = 0
    off: int = 0
    off_as: tuple[str, ...] = field(default=())

    def note(self, ways: tuple[str, ...]) -> None:
        """One more, consistent with these."""
        self.checked += 1
        if CORRECT in ways:
            return
        self.off += 1
        self.off_as = ways if self.off == 1 else tuple(way for way in self.off_as if way in ways)


def audit(trace: Sequence[Record], setting: Setting) -> Audit:
    """Check the operations of a trace, as many as there is time for."""
    done, way = Audit(), Way.start(setting)
    for record in trace:
        way.arrive(record)
        for value, bits in zip(record.stage.values, record.bits, strict=True):
            ways = way.ways(value, bits)
            if ways is not None:
                done.note(ways)
            way.learn(value, bits)
        if done.checked >= _MOST_CHECKED:
            break
    return done


def compare(one: Sequence[Record], other: Sequence[Record], setting: Setting) -> Found:
    """Compare two traces of the same ray through grids over the same mesh."""
    found, ways = Found(), (Way.start(setting), Way.start(setting))
    for left, right in zip_longest(one, other):
        if left is None or right is None or (left.stage, left.item) != (right.stage, right.item):
            found.note(COURSE, partial(_parting, ways[0], left, right))
            break
        for way, record in zip(ways, (left, right), strict=True):
            way.arrive(record)
        for value, a, b in zip(left.stage.values, left.bits, right.bits, strict=True):
            if a != b:
                found.note(value.type, partial(_difference, ways, left, value, a, b))
            ways[0].learn(value, a)
            ways[1].learn(value, b)
    return found


def _parting(way: Way, left: Record | None, right: Record | None) -> Difference:
    """Where the traces go on with different things."""
    last = left or right
    assert last is not None
    return Difference(
        stage=last.stage.name,
        value="next",
        type=COURSE,
        operation="what comes next on the ray's way",
        steps=(),
        cell=way.cell,
        cell_at=None if way.cell is None else way.setting.cell_at(way.cell),
        triangle=None,
        first=NumberRecord("", _thing(way.setting, left)),
        second=NumberRecord("", _thing(way.setting, right)),
        ulps=None,
        inputs={},
        nearest="",
        first_as=(),
        second_as=(),
    )


def _thing(setting: Setting, record: Record | None) -> str:
    if record is None:
        return "the end"
    if record.stage.of == "triangle":
        return f"triangle {setting.name_of(record.item)}"
    if record.stage.of == "cell":
        return f"cell {cell_text(record.item, setting.cell_at(record.item))}"
    return record.stage.name


def _difference(ways: tuple[Way, Way], record: Record, value: Value, a: int, b: int) -> Difference:
    way = ways[0]
    setting, cell = way.setting, way.cell
    in_words = value.operation.startswith(":")
    *steps, operation = value.operation.removeprefix(": ").splitlines()
    names = [] if in_words else [name for name in names_of(value.operation) if name in way.names]
    first_as, second_as = (each.ways(value, bits) for each, bits in zip(ways, (a, b), strict=True))
    return Difference(
        stage=record.stage.name,
        value=value.name,
        type=value.type,
        operation=operation,
        steps=tuple(steps),
        cell=cell,
        cell_at=None if cell is None else setting.cell_at(cell),
        triangle=setting.name_of(record.item) if record.stage.of == "triangle" else None,
        first=_shown(setting, value, a),
        second=_shown(setting, value, b),
        ulps=ulps_between(value.type, a, b),
        inputs={name: shown_number(way.names[name]) for name in names},
        nearest=_nearest(first_as, second_as),
        first_as=first_as or (),
        second_as=second_as or (),
    )


def _nearest(first_as: tuple[str, ...] | None, second_as: tuple[str, ...] | None) -> str:
    if first_as is None or second_as is None:
        return ""
    if CORRECT in first_as:
        return "first"
    return "second" if CORRECT in second_as else "neither"


def _shown(setting: Setting, value: Value, bits: int) -> NumberRecord:
    if value.type != TRIANGLE:
        return shown(value.type, bits)
    return shown(value.type, bits, "none" if bits == NO_HIT else str(setting.name_of(bits)))
