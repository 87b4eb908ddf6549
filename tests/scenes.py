"""Where the shared scenes and hostile files are; tests that need them skip by name without them."""

from __future__ import annotations

import csv
import os
from pathlib import Path

import pytest


def shared_root() -> Path:
    """Folder that holds ``scenes`` and ``hostile``: around ``CLGRID_SCENES``, or ``../shared``."""
    given = os.environ.get("CLGRID_SCENES")
    folder = Path(given) if given else Path(__file__).resolve().parents[2] / "shared" / "scenes"
    return folder if (folder / "scenes").is_dir() else folder.parent


def manifest(collection: str) -> list[dict[str, str]]:
    """Rows of ``scenes/MANIFEST.tsv`` or ``hostile/MANIFEST.tsv``; none where the folder is missing."""
    path = shared_root() / collection / "MANIFEST.tsv"
    if not path.is_file():
        return []
    with open(path, newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file, delimiter="\t", quoting=csv.QUOTE_NONE))


def shared_file(collection: str, name: str) -> Path:
    """Path of a shared file; skips the test, naming the file, where it is missing."""
    path = shared_root() / collection / name
    if not path.exists():
        pytest.skip(f"{collection}/{name} is not in {shared_root()} (set CLGRID_SCENES)")
    return path


def scene(name: str) -> Path:
    """Path of a shared scene such as ``scans/horse.ply``."""
    return shared_file("scenes", name)
