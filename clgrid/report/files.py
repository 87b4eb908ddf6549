"""The files of a report: checked before the work, written beside and renamed."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from clgrid.errors import InputError
from clgrid.imagefile import partial_of

PLOTS = (".png", ".svg")


def check(path: Path, option: str) -> None:
    """Find out before the work whether a file could be written.

    Raises
    ------
    InputError
        If its folder is missing or not writable, or it is a folder.
    """
    folder = path.absolute().parent
    if not folder.is_dir():
        raise InputError(f"{option} {path}: no such folder; create it")
    if path.is_dir():
        raise InputError(f"{option} {path}: is a folder; name a file")
    if not os.access(folder, os.W_OK):
        raise InputError(f"{option} {path}: the folder is not writable; choose another")


def check_plot(path: Path) -> None:
    """Find out before the work whether a plot could be drawn.

    Raises
    ------
    InputError
        As ``check``, and for a format that is neither PNG nor SVG.
    UnsupportedError
        If matplotlib is not installed.
    """
    from clgrid.report.plot import load

    if path.suffix.lower() not in PLOTS:
        raise InputError(f"--plot {path}: end its name in {' or '.join(PLOTS)}")
    check(path, "--plot")
    load()


def save(path: Path, option: str, write: Callable[[Path], object]) -> None:
    """Write a file that appears under its name only when it is complete.

    Raises
    ------
    InputError
        If it cannot be written.
    """
    partial = partial_of(path)
    try:
        write(partial)
        os.replace(partial, path)
    except OSError as error:
        raise InputError(f"{option} {path}: cannot be written ({error.strerror}); choose another") from error
    finally:
        partial.unlink(missing_ok=True)


def save_text(path: Path, option: str, text: str) -> None:
    """Write text, as UTF-8, likewise."""
    save(path, option, lambda partial: partial.write_bytes(text.encode()))
