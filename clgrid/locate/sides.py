"""A side of the comparison: a device, with what its kernels are compiled from, in a process of its own."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import msgspec
import numpy as np

from clgrid import cache, device, probe, program
from clgrid.errors import DeviceError, InputError
from clgrid.locate import child
from clgrid.locate.trace import Words
from clgrid.mesh import Mesh
from clgrid.repro_record import ReproGrid, ReproRay

TIMEOUT_SECONDS = 300.0


@dataclass(frozen=True)
class Side:
    """A device that is compared, with what its kernels are compiled from.

    Attributes
    ----------
    device : str
        A selector, as for ``clgrid.build``.
    build_options : str
        Added to clgrid's own, as ``CLGRID_BUILD_OPTIONS`` does.
    kernels : dict of str to str
        Sources in place of clgrid's own, whole, by file name.
    """

    device: str
    build_options: str = ""
    kernels: dict[str, str] = field(default_factory=dict)

    @classmethod
    def here(cls, device: str) -> Side:
        """The device with the build options and kernels that this process is told to use."""
        folder, own = program.source_folder(), program.own_source_folder()
        kernels = {} if folder == own else _foreign(folder, own)
        return cls(device, " ".join(program.build_options()), kernels)


@dataclass(frozen=True)
class Seen:
    """What a side answered: its result, and the words of its trace."""

    result: child.Result
    words: Words


def _foreign(folder: Path, own: Path) -> dict[str, str]:
    """Sources of a folder that are not clgrid's own."""
    sources = [*folder.glob("*.cl"), *folder.glob("*.h")]
    texts = {path.name: path.read_text(encoding="utf-8") for path in sorted(sources)}
    return {
        name: text
        for name, text in texts.items()
        if not (own / name).is_file() or (own / name).read_text(encoding="utf-8") != text
    }


def ask(
    mesh: Mesh, grid: ReproGrid, ray: ReproRay, sides: Sequence[Side], timeout: float = TIMEOUT_SECONDS
) -> list[Seen]:
    """What each side makes of the ray, all at once.

    Raises
    ------
    DeviceError
        If a device is not there, or its process crashes or hangs.
    ClgridError
        If a grid cannot be built.
    """
    for side in sides:
        device.choose(side.device)
    with tempfile.TemporaryDirectory(prefix="clgrid-locate-") as folder:
        places = [Path(folder) / str(number) for number in range(len(sides))]
        for place, side in zip(places, sides, strict=True):
            place.mkdir()
            np.savez(place / child.MESH, vertices=mesh.vertices, faces=mesh.faces)
            job = child.Job(side.device, grid, ray)
            (place / child.JOB).write_bytes(msgspec.json.encode(job))
        with ThreadPoolExecutor(len(sides)) as pool:
            return list(pool.map(_asked, places, sides, [timeout] * len(sides)))


def _asked(place: Path, side: Side, timeout: float) -> Seen:
    environment = {**os.environ, "CLGRID_BUILD_OPTIONS": side.build_options, "CLGRID_KERNELS": ""}
    if side.kernels:
        environment["CLGRID_KERNELS"] = str(_kernels_of(side, place / "cl"))
    command = probe.child_command("clgrid.locate.child", str(place))
    ended = probe.run_child(command, timeout, environment)
    if ended is None:
        raise DeviceError(f"{side.device}: tracing one ray takes more than {timeout:.0f} s")
    result = place / child.RESULT
    if not result.is_file():
        last = probe.telling_line(ended.stderr.splitlines())[:200] or "no message"
        raise DeviceError(f"{side.device}: tracing one ray failed ({probe.ending(ended.returncode)}): {last}")
    outcome = msgspec.json.decode(result.read_bytes(), type=dict)
    if "error" in outcome:
        failed = msgspec.convert(outcome, child.Failed)
        raise (DeviceError if failed.exit_code == DeviceError.exit_code else InputError)(failed.error)
    return Seen(msgspec.convert(outcome, child.Result), np.load(place / child.WORDS))


def _kernels_of(side: Side, spare: Path) -> Path:
    """A folder of clgrid's kernels with those of the side in their place.

    It stays in clgrid's cache, if that can be written, since its path is part of the keys of drivers' caches.

    Raises
    ------
    InputError
        If a name is none of a kernel source.
    """
    for name in side.kernels:
        if Path(name).name != name or Path(name).suffix not in (".cl", ".h"):
            raise InputError(f"{name!r} is no name of a kernel source: give NAME.cl or NAME.h")
    own = [path for path in program.own_source_folder().iterdir() if path.suffix in (".cl", ".h")]
    texts = {path.name: path.read_text(encoding="utf-8") for path in sorted(own)} | side.kernels
    kept = cache.folder() / f"kernels-{cache.key(*texts.items())}"
    if kept.is_dir():
        return kept
    try:
        kept.parent.mkdir(parents=True, exist_ok=True)
        beside = Path(tempfile.mkdtemp(dir=kept.parent, prefix=kept.name))
    except OSError:
        spare.mkdir()
        beside = kept = spare
    for name, text in texts.items():
        (beside / name).write_text(text, encoding="utf-8")
    if beside != kept:
        try:
            beside.rename(kept)
        except OSError:  # another process was faster
            shutil.rmtree(beside)
    return kept
