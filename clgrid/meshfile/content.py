"""The bytes of a file, unpacked where it is gzipped."""

from __future__ import annotations

import gzip
import mmap
import os
import stat
import zlib
from pathlib import Path

from clgrid.errors import MeshError

Content = bytes | mmap.mmap
"""Bytes that numpy, re and slicing read; a slice is a copy."""

GZIP_MAGIC = b"\x1f\x8b"


def content(path: Path) -> Content:
    """Bytes of a regular file, mapped rather than read; gunzipped if its name ends in ``.gz``.

    Raises
    ------
    MeshError
        If the file cannot be opened, is empty, is no regular file or is damaged gzip data.
    """
    try:
        # asked before opening: that of a pipe would wait for a writer
        if not stat.S_ISREG(path.stat().st_mode):
            raise MeshError("is not a regular file; give the path of a mesh file")
        with open(path, "rb") as file:
            if os.fstat(file.fileno()).st_size == 0:
                raise MeshError("is empty (0 bytes); export it again")
            if path.suffix.lower() == ".gz":
                return _gunzipped(file.read())
            return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    except OSError as error:
        raise MeshError(
            f"cannot be opened ({error.strerror or error}); check the path and its permissions"
        ) from error


def _gunzipped(packed: bytes) -> bytes:
    if not packed.startswith(GZIP_MAGIC):
        raise MeshError("is named .gz and holds no gzip data; rename it or compress it")
    try:
        unpacked = gzip.decompress(packed)
    except (EOFError, OSError, zlib.error) as error:
        raise MeshError(
            f"holds damaged or truncated gzip data ({error}); copy or compress it again"
        ) from error
    if not unpacked:
        raise MeshError("is empty (0 bytes) after decompression; export it again")
    return unpacked
