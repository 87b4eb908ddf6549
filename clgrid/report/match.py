"""Which row of one record is which row of another."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from clgrid.report.entries import Entry, Scalar

Key = tuple[object, ...]


@dataclass(frozen=True)
class Matches:
    """Rows of two records.

    Attributes
    ----------
    pairs : list of (str, Entry, Entry)
        With a label, unique among all.
    only_first, only_second : list of str
        Labels of the others.
    """

    pairs: list[tuple[str, Entry, Entry]]
    only_first: list[str]
    only_second: list[str]


def match(first: Sequence[Entry], second: Sequence[Entry]) -> Matches:
    """Match rows by names; where several have the same, by the first of their marks that tell them apart.

    Rows that nothing tells apart are matched in their order. A single row is matched with one of another
    device, density or resolution, since that is what runs differ in; of several rows, those of one device
    with those of the same.
    """
    groups = [_grouped(first), _grouped(second)]
    varying = _varying([*first, *second])
    matches = Matches([], [], [])
    for names in dict.fromkeys([*groups[0], *groups[1]]):
        one, two = groups[0].get(names, []), groups[1].get(names, [])
        used = _telling(one, two)
        keys = [_numbered([_marks(entry, used) for entry in each]) for each in (one, two)]
        there = dict(zip(keys[1], two, strict=True))
        for key, entry in zip(keys[0], one, strict=True):
            label = _label(entry, used, varying, key)
            if key in there:
                matches.pairs.append((label, entry, there.pop(key)))
            else:
                matches.only_first.append(label)
        matches.only_second.extend(_label(entry, used, varying, key) for key, entry in there.items())
    return matches


def _grouped(entries: Sequence[Entry]) -> dict[Key, list[Entry]]:
    groups: dict[Key, list[Entry]] = {}
    for entry in entries:
        groups.setdefault(tuple(entry.names.items()), []).append(entry)
    return groups


def _telling(one: Sequence[Entry], two: Sequence[Entry]) -> list[str]:
    """The marks to match by: as few as tell the rows of each record apart, each of them needed."""
    if len(one) <= 1 and len(two) <= 1:
        return []
    used: list[str] = []
    apart = [1, 1]
    for mark in dict.fromkeys(name for entry in (*one, *two) for name in entry.marks):
        now = [len({_marks(entry, [*used, mark]) for entry in each}) for each in (one, two)]
        if now != apart:
            used.append(mark)
            apart = now
        if apart == [len(one), len(two)]:
            break
    return used


def _marks(entry: Entry, used: Sequence[str]) -> Key:
    return tuple(entry.marks.get(mark) for mark in used)


def _numbered(keys: Sequence[Key]) -> list[Key]:
    """Make equal keys differ by their count."""
    seen: Counter[Key] = Counter()
    numbered = []
    for key in keys:
        seen[key] += 1
        numbered.append((*key, seen[key]))
    return numbered


def _varying(entries: Sequence[Entry]) -> set[str]:
    """Names that tell rows apart."""
    values: dict[str, set[Scalar]] = {}
    for entry in entries:
        for name, value in entry.names.items():
            values.setdefault(name, set()).add(value)
    varying = {name for name, found in values.items() if len(found) > 1}
    # The number of triangles is said where the scene does not tell it.
    known = {(entry.names.get("scene"), entry.names.get("triangles")) for entry in entries}
    return varying - ({"triangles"} if len(known) == len({scene for scene, _ in known}) else set())


def _label(entry: Entry, used: Sequence[str], varying: set[str], key: Key) -> str:
    """What a reader needs to know the row: the scene, and what differs between rows."""
    words = [
        _word(name, value)
        for name, value in entry.names.items()
        if value is not None and (name == "scene" or name in varying)
    ]
    words += [_word(mark, entry.marks[mark]) for mark in used if entry.marks.get(mark) is not None]
    if isinstance(key[-1], int) and key[-1] > 1:
        words.append(f"number {key[-1]}")
    return ", ".join(words) or next((str(value) for value in entry.names.values()), "row")


_BARE = (
    "scene",
    "layout",
    "accuracy",
    "workload",
    "pair",
    "device",
    "what",
    "type",
    "clock",
    "path",
    "reference",
)


def _word(name: str, value: Scalar) -> str:
    if isinstance(value, bool):
        return name if value else f"no {name}"
    if name == "kind":
        return "all rays" if value == "all" else f"{value} rays"
    number = (
        f"{value:,}" if isinstance(value, int) else f"{value:.6g}" if isinstance(value, float) else str(value)
    )
    if name in ("triangles", "samples", "bounces", "rays"):
        return f"{number} {name}"
    return number if name in _BARE else f"{name} {number}"
