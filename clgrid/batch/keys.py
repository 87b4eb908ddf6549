"""Content keys: a hash of all that a picture depends on, kept in the picture's metadata.

The key holds the bytes of the scene's files, the options that change pixels or the file, and our version.
It does not hold the device, for the bits are the same on every one; but for ``fast``, which promises no such.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from pathlib import Path
from urllib.parse import unquote

import msgspec

import clgrid
from clgrid.batch.item import Item
from clgrid.errors import ClgridError
from clgrid.image import read_image

KEY = "clgrid:content_key"
# They decide where and how long, not what.
_NOT_CONTENT = ("device", "max_memory", "time_limit", "retries")
_NAMED_IN_OBJ = re.compile(rb"^\s*mtllib\s+(.+?)\s*$", re.MULTILINE)
_NAMED_IN_MTL = re.compile(
    rb"^\s*(?:map_\w+|bump|norm|disp|decal)\s+(?:.*\s)?(\S+)\s*$", re.MULTILINE | re.IGNORECASE
)
_DAMAGED_END = {".jpg": b"\xff\xd9", ".jpeg": b"\xff\xd9"}


class Hashes:
    """Hashes of files, each read once while it stays as it is."""

    def __init__(self) -> None:
        self._known: dict[tuple[str, int, int], str] = {}

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
        except OSError:
            return "missing"

    def with_key(self, item: Item) -> Item:
        """The item with its content key and the hash of its scene's file."""
        path = Path(item.scene)
        scene = self.of(path) if path.is_file() else f"built-in {item.scene}"
        camera = Path(item.view.camera) if item.view.camera.lower().endswith(".json") else None
        settings = msgspec.to_builtins(item.settings)
        left_out = [name for name in _NOT_CONTENT if name != "device" or item.settings.accuracy != "fast"]
        content = {
            "clgrid": clgrid.__version__,
            "scene": scene,
            "beside": [self.of(each) for each in companions(path)],
            "vertices": None if item.vertices is None else self.of(Path(item.vertices)),
            "frame": item.frame,
            "view": msgspec.to_builtins(msgspec.structs.replace(item.view, name="")),
            "camera": None if camera is None else self.of(camera),
            "settings": {name: value for name, value in settings.items() if name not in left_out},
        }
        key = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:40]
        return msgspec.structs.replace(item, key=key, source_sha256=scene if path.is_file() else "")


def companions(path: Path) -> list[Path]:
    """Files that a scene's file names: buffers, images, materials. Of one that is damaged, none."""
    name = path.name.lower()
    try:
        if name.endswith(".gltf"):
            document = json.loads(path.read_bytes())
            entries = [each for kind in ("buffers", "images") for each in document.get(kind, [])]
            uris = [each.get("uri", "") for each in entries]
            named = [unquote(uri) for uri in uris if uri and not uri.startswith("data:")]
        elif name.endswith(".obj"):
            return _beside_obj(path)
        else:
            return []
    except (OSError, ValueError, AttributeError, TypeError, RecursionError):
        return []
    return [path.parent / each for each in named]


def _beside_obj(path: Path) -> list[Path]:
    found = []
    for material in _named(_NAMED_IN_OBJ, path):
        found.append(material)
        if material.is_file():
            found += _named(_NAMED_IN_MTL, material)
    return found


def _named(pattern: re.Pattern[bytes], path: Path) -> list[Path]:
    names = dict.fromkeys(os.fsdecode(match[1]) for match in pattern.finditer(path.read_bytes()))
    return [path.parent / name.replace("\\", "/") for name in names if "\0" not in name]


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
