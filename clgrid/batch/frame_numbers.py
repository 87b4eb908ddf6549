"""Which frames are asked for: ``"1..240"``, ``"0..10..2"``, ``"all"``, a number, or a list."""

from __future__ import annotations

import re

from clgrid.errors import InputError

ALL = "all"
_MOST = 10**6


def parse_frames(given: str | int | list[int], what: str = "frames") -> list[int] | None:
    """Read frame numbers; None is all that there are.

    Raises
    ------
    InputError
        If it is none of the forms, empty, or has a negative number.
    """
    if isinstance(given, int):
        numbers = [given]
    elif isinstance(given, list):
        numbers = given
    elif given.strip() == ALL:
        return None
    else:
        numbers = [number for part in given.split(",") for number in _range(part, given, what)]
    if not numbers or min(numbers) < 0:
        raise InputError(f"{what} {given!r}: give at least one frame, from 0")
    if len(set(numbers)) != len(numbers):
        raise InputError(f"{what} {given!r}: names a frame twice")
    return numbers


def _range(part: str, given: str, what: str) -> range:
    match = re.fullmatch(r"\s*(\d{1,9})(?:\.\.(\d{1,9})(?:\.\.(\d{1,9}))?)?\s*", part)
    if match is None:
        raise InputError(f"{what} {given!r}: give 1..240, 1..240..2 for each second one, numbers, or all")
    first, last, step = int(match[1]), int(match[2] or match[1]), int(match[3] or 1)
    if last < first or step < 1 or last - first > _MOST:
        raise InputError(f"{what} {given!r}: give a range that goes up, of at most a million frames")
    return range(first, last + 1, step)
