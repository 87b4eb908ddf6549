"""Programs: real .cl files, specialised by -D, built once and kept."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import pyopencl as cl

from clgrid import structs
from clgrid.device import Device


def source_folder() -> Path:
    """Folder of the .cl and .h files: clgrid/cl when installed, the checkout's cl/ when editable."""
    inside = Path(__file__).parent / "cl"
    return inside if inside.is_dir() else Path(__file__).parent.parent / "cl"


_kernels: dict[Any, Any] = {}
_programs: dict[Any, Any] = {}


def kernel(device: Device, file: str, name: str, **defines: int | str) -> Any:
    """The kernel ``name`` of ``file`` built with ``-Dkey=value`` options; built once a process."""
    key = (device, file, tuple(sorted(defines.items())))
    if key not in _programs:
        folder = source_folder()
        digest = hashlib.sha256()
        for path in sorted(folder.iterdir()):
            digest.update(path.read_bytes())
        options = ["-I", str(folder), f"-DCLG_SOURCE_HASH={digest.hexdigest()[:16]}"]
        options += [f"-D{k}={v}" for k, v in sorted(defines.items())]
        source = structs.declarations() + (folder / file).read_text()
        _programs[key] = cl.Program(device.context, source).build(options)
    if (key, name) not in _kernels:
        _kernels[key, name] = cl.Kernel(_programs[key], name)
    return _kernels[key, name]
