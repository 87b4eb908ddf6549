"""Names of pictures: patterns with fields, which no two items may fill alike."""

from __future__ import annotations

import re
import string
from collections.abc import Sequence
from pathlib import Path

from clgrid.errors import InputError

FIELDS = ("scene", "folder", "camera", "frame", "item")
_NUMBERS = ("frame", "item")
# What separates folders, or is awkward in a file's name.
_UNFIT = re.compile(r"[^\w.+=@-]+")


def has_fields(pattern: str) -> bool:
    """Whether a name is a pattern."""
    return "{" in pattern or "}" in pattern


def checked_fields(pattern: str, *, frames: bool) -> set[str]:
    """The fields of a pattern.

    Raises
    ------
    InputError
        If it has a field that there is not, or that cannot be written so.
    """
    try:
        parts = list(string.Formatter().parse(pattern))
        fields = {name for _, name, _, _ in parts if name is not None}
    except ValueError as error:
        raise InputError(f"output {pattern!r}: {error}; write a brace itself as two") from error
    unknown = sorted(fields - set(FIELDS))
    if unknown:
        known = ", ".join(f"{{{name}}}" for name in FIELDS)
        raise InputError(f"output {pattern!r}: no field {{{unknown[0]}}}; there are {known}")
    if "frame" in fields and not frames:
        raise InputError(f"output {pattern!r}: has {{frame}}, but no frames are asked for; give frames")
    try:
        pattern.format(scene="a", folder="a", camera="a", frame=0, item=0)
    except (ValueError, KeyError, IndexError, AttributeError) as error:
        raise InputError(f"output {pattern!r}: {error}; such as {{frame:04d}} or {{scene}}") from error
    return fields


def fit(name: str) -> str:
    """A name as part of a file's name."""
    return _UNFIT.sub("_", name).strip(".") or "_"


def filled(pattern: str, *, scene: str, folder: str, camera: str, frame: int | None, item: int) -> str:
    """A pattern with its fields filled."""
    names = {"scene": fit(scene), "folder": fit(folder), "camera": fit(camera)}
    return pattern.format(**names, frame=0 if frame is None else frame, item=item)


def fixed_folder(pattern: str, base: Path) -> Path:
    """The deepest folder that holds all pictures of a pattern."""
    folders = Path(pattern).parts[:-1]
    fixed = []
    for part in folders:
        if has_fields(part):
            break
        fixed.append(part)
    return base.joinpath(*fixed)


def require_distinct(outputs: Sequence[tuple[str, str]]) -> None:
    """Refuse two items that would write one file.

    Parameters
    ----------
    outputs : sequence of (str, str)
        File and what is drawn in it.

    Raises
    ------
    InputError
        Naming both, and the fields that tell items apart.
    """
    seen: dict[str, str] = {}
    for path, title in outputs:
        if path in seen:
            raise InputError(
                f"output {path}: would be written twice, for {seen[path]} and for {title}; "
                "put {scene}, {folder}, {camera}, {frame:04d} or {item:04d} into output"
            )
        seen[path] = title
