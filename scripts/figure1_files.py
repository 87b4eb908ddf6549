"""Files that are there whole or not at all."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def beside(path: Path) -> Iterator[Path]:
    """Give a path next to ``path`` to write to; it becomes ``path`` if nothing went wrong.

    Raises
    ------
    OSError
        If the folder cannot be made or written, or nothing was written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    fresh = path.with_name(f".{os.getpid()}.{path.name}")
    try:
        yield fresh
        os.replace(fresh, path)
    finally:
        with contextlib.suppress(FileNotFoundError):
            fresh.unlink()


def write_text(path: Path, text: str) -> None:
    """Write all of ``text`` or nothing."""
    with beside(path) as fresh:
        fresh.write_text(text, encoding="utf-8")
