"""Content keys: a hash of all that a picture depends on, kept in the picture's metadata.

The key holds the bytes of the scene's files, the options that change pixels or the file, and our version.
It does not hold the device, for the bits are the same on every one; but for ``fast``, which promises no such.
"""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path

import msgspec

import clgrid
from clgrid.batch.item import Item
from clgrid.errors import ClgridError, InputError
from clgrid.image import read_image

KEY = "clgrid:content_key"
# They decide where and how long, not what.
_NOT_CONTENT = ("device", "max_memory", "time_limit", "retries")
_DAMAGED_END = {".jpg": b"\xff\xd9", ".jpeg": b"\xff\xd9"}


class Hashes:
    """Hashes of files, each read once while it stays as it is."""

    def __init__(self) -> None:
        self._known: dict[tuple[str, int, int], str] = {}
        self._beside: dict[Path, dict[str, list[tuple[str, Path | None]]]] = {}

    def of(self, path: Path) -> str:
        """SHA-256 of a file's bytes; "missing" if it cannot be read."""
        try:
            state = path.stat()
            place = (str(path), state.st_mtime_ns, state.st_size)
            if place not in self._known:
                with open(path, "rb") as file:
                    digest = hashlib.sha256()
                    while chunk := file.read(1 << 20):
                        digest.update(chunk)
                self._known[place] = digest.hexdigest()
            return self._known[place]
        except (OSError, ValueError):  # a name that no file can have
            return "missing"

    def with_key(self, item: Item) -> Item:
        """The item with its content key and the hash of its scene's file."""
        path = Path(item.scene)
        scene = self.of(path) if path.is_file() else ""
        camera = Path(item.view.camera) if item.view.camera.lower().endswith(".json") else None
        settings = msgspec.to_builtins(item.settings)
        left_out = [name for name in _NOT_CONTENT if name != "device" or item.settings.accuracy != "fast"]
        content = {
            "clgrid": clgrid.__version__,
            # A folder is its files; of what is no file the name says all.
            "scene": self._of_source(item.scene) if scene or path.is_dir() else f"built-in {item.scene}",
            "vertices": None if item.vertices is None else self._of_source(item.vertices),
            "fps": item.fps,
            "animation": item.animation,
            "frame": item.frame,
            "view": msgspec.to_builtins(msgspec.structs.replace(item.view, name="")),
            "camera": None if camera is None else self.of(camera),
            "settings": {name: value for name, value in settings.items() if name not in left_out},
        }
        key = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:40]
        return msgspec.structs.replace(item, key=key, source_sha256=scene)

    def _of_source(self, name: str) -> str:
        """Hash of a file, or of all files of a folder or a pattern, each with the files that it names."""
        from clgrid.animation.files import frame_files, is_files

        try:
            files = frame_files(name) if is_files(name) else (Path(name),)
        except InputError:
            return "missing"
        digest = hashlib.sha256()
        for path in files:
            digest.update(f"{self.of(path)}\n".encode())
            for written, found in self._companions_of(path):
                digest.update(f"{written!r} {'missing' if found is None else self.of(found)}\n".encode())
        return digest.hexdigest()

    def _companions_of(self, path: Path) -> list[tuple[str, Path | None]]:
        """Files that a file names; looked for once while it stays as it is."""
        from clgrid.lookfile.companions import companions

        state = self.of(path)
        if state not in self._beside.get(path, {}):
            self._beside[path] = {state: companions(path)}
        return self._beside[path][state]


def has_picture(path: Path, key: str) -> bool:
    """Whether a file is the whole picture of this key. A truncated or damaged one is not."""
    if not path.is_file():
        return False
    try:
        end = _DAMAGED_END.get(path.suffix.lower(), b"")
        with open(path, "rb") as file:
            size = file.seek(0, os.SEEK_END)
            file.seek(max(0, size - len(end)))
            if file.read() != end and end:
                return False
        metadata = read_image(path).metadata
    except (ClgridError, OSError):
        return False
    return metadata.get(KEY) == key or f"{KEY}: {key}" in str(metadata.get("ImageDescription", "")).split(
        "\n"
    )
