"""Small facts kept on disk between processes: what a device could do, which runtime was registered."""

from __future__ import annotations

import contextlib
import hashlib
import json
import logging
import os
import tempfile
from pathlib import Path
from typing import Any

log = logging.getLogger(__name__)


def folder() -> Path:
    """``$XDG_CACHE_HOME/clgrid``, else ``~/.cache/clgrid``; it need not exist."""
    home = os.environ.get("XDG_CACHE_HOME")
    base = Path(home) if home and Path(home).is_absolute() else Path("~/.cache").expanduser()
    return base / "clgrid"


def key(*facts: object) -> str:
    """Digest of ``facts``: equal facts, equal key."""
    return hashlib.sha256(json.dumps([str(fact) for fact in facts]).encode()).hexdigest()[:24]


def write_whole(path: Path, text: str, mode: int = 0o600) -> None:
    """Write ``text`` so that a reader sees all of it or none: beside, then renamed.

    Parameters
    ----------
    path : Path
    text : str
    mode : int
        Who may read the file.

    Raises
    ------
    OSError
        If the folder cannot be made or written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, beside = tempfile.mkstemp(dir=path.parent, prefix=path.name, suffix=".part")
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
        os.chmod(beside, mode)
        os.replace(beside, path)
    except BaseException:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(beside)
        raise


def load(name: str) -> dict[str, Any] | None:
    """The record stored as ``name``, or None where there is none that can be read."""
    try:
        record = json.loads((folder() / f"{name}.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return record if isinstance(record, dict) else None


def store(name: str, record: dict[str, Any]) -> None:
    """Keep ``record`` as ``name``; a cache folder that cannot be written costs time, not the answer."""
    try:
        write_whole(folder() / f"{name}.json", json.dumps(record))
    except OSError as error:
        log.debug("cache folder %s cannot be written: %s", folder(), error)


def link(path: Path, target: Path) -> bool:
    """Make ``path`` a symbolic link to ``target``; False if that cannot be done."""
    if path.is_symlink() and os.readlink(path) == str(target):
        return True
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent) as beside:
            fresh = Path(beside) / path.name
            fresh.symlink_to(target, target_is_directory=True)
            os.replace(fresh, path)
    except OSError as error:
        log.debug("%s cannot be linked: %s", path, error)
        return False
    return True
