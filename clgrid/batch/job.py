"""What a job file says: scenes, frames, cameras, and how each picture is made."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec

from clgrid.batch.toml_lines import line_of
from clgrid.errors import InputError

Vector = tuple[float, float, float]


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """How a picture is made; what is None is as ``clgrid.render`` and ``Image.save`` have it.

    Attributes
    ----------
    size : (int, int)
        Pixels across and down.
    aovs : tuple of str
    background : 3 floats
    layout, density, resolution, accuracy, device, max_memory, skipping
        As for ``clgrid.build``.
    samples, seed, lights, sun, sun_strength, sky, occlusion_rays, occlusion_distance
        As of ``clgrid.look.Shading``; a picture with none of them is lit from the eye.
    crop : 4 ints
        x0, y0, x1, y1: the pixels of the whole picture that are drawn.
    compression, half, tile, quality
        As for ``Image.save``.
    time_limit : float
        Seconds that an item may take; what compiles is not counted.
    retries : int
        Times that an item is tried again whose process died or took too long.
    """

    size: tuple[int, int] | None = None
    aovs: tuple[str, ...] | None = None
    background: Vector | None = None
    layout: str | None = None
    density: float | str | None = None
    resolution: tuple[int, int, int] | None = None
    accuracy: str | None = None
    device: str | None = None
    max_memory: int | None = None
    skipping: bool | None = None
    samples: int | None = None
    seed: int | None = None
    lights: bool | None = None
    sun: Vector | None = None
    sun_strength: float | None = None
    sky: Vector | None = None
    occlusion_rays: int | None = None
    occlusion_distance: float | None = None
    crop: tuple[int, int, int, int] | None = None
    compression: str | None = None
    half: bool | None = None
    tile: int | None = None
    quality: int | None = None
    time_limit: float | None = None
    retries: int | None = None


class View(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """A camera: one of the scene's by name or index, a camera file, or a place to look from.

    All of them empty is the view of the whole scene.
    """

    name: str = ""
    camera: str = ""
    eye: Vector | None = None
    look_at: Vector | None = None
    up: Vector | str = "auto"
    fov: float | None = None


class Override(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """Other settings for some of the items.

    Attributes
    ----------
    scene, camera : str
        Which names they are for; ``*`` and ``?`` stand for anything.
    frames : str, int or list of int
        Which frames they are for; all without it.
    """

    scene: str = "*"
    camera: str = "*"
    frames: str | int | list[int] | None = None


class Job(Settings, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """A job file.

    Attributes
    ----------
    scenes : list of str
        Files or patterns of files, relative to the job file, or built-in scenes; a folder is a scene whose
        files are its frames.
    output : str or list of str
        Names of the pictures, relative to the job file, with ``{scene}``, ``{folder}``, ``{camera}``,
        ``{frame:04d}``, ``{item:04d}``.
    frames : str, int, list of int or None
        ``"1..240"``, ``"all"``, or numbers; a still picture without it.
    vertices : str or None
        What moves the scenes: a ``.npy`` file of the vertices of each frame, or a folder or a pattern of mesh
        files; without it, a glTF scene's own animation.
    fps : float or None
        Frames a second, at which animations are sampled; 24 without it.
    animation : str, int or None
        Name or number of an animation of the glTF scenes; the first without it.
    cameras : list
        ``"all"`` of the scene, names, indices, camera files, or tables with ``eye`` and ``look_at``.
    records : str or None
        Where the records of the run go; ``run.jsonl`` in the folder of the pictures without it.
    item : list of Override
        Exceptions; the later ones win.
    """

    scenes: list[str]
    output: str | list[str]
    frames: str | int | list[int] | None = None
    vertices: str | None = None
    fps: float | None = None
    animation: str | int | None = None
    cameras: list[str | int | View] = []
    records: str | None = None
    item: list[Override] = []


def read_job(path: Path) -> Job:
    """Read a job file.

    Raises
    ------
    InputError
        If it cannot be read, with file, line and key.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(f"job {path}: cannot be read ({reason}); give a TOML file") from error
    return parse_job(text, str(path))


def parse_job(text: str, name: str) -> Job:
    """Read the text of a job file.

    Raises
    ------
    InputError
        With file, line and key.
    """
    try:
        return msgspec.toml.decode(text, type=Job)
    except msgspec.ValidationError as error:
        reason, _, place = str(error).partition(" - at `")
        path = place.rstrip("`").removeprefix("$").removeprefix(".")
        key = _unknown(reason)
        whole = ".".join(part for part in (path, key) if part)
        line = line_of(text, whole)
        where = f"{name}:{line}" if line else name
        subject = f" {whole}:" if whole else ""
        raise InputError(f"job {where}:{subject} {_first_small(reason)}") from error
    except msgspec.DecodeError as error:
        raise InputError(f"job {name}: not TOML: {error}") from error


def _unknown(reason: str) -> str:
    """The key that a message is about, where the path is only that of its table."""
    return reason.split("`")[1] if "unknown field" in reason else ""


def _first_small(reason: str) -> str:
    if "unknown field" in reason:
        return "there is no such key; docs/guide/batch.md lists them"
    if "missing required field" in reason:
        return f"the key {reason.split('`')[1]} is missing"
    return reason[:1].lower() + reason[1:].replace("`", "")


def merged(job: Job, overrides: list[Override]) -> Settings:
    """The job's settings, with those of each exception in turn put over them."""
    chosen: dict[str, Any] = {}
    for source in (job, *overrides):
        for name in Settings.__struct_fields__:
            value = getattr(source, name)
            if value is not None:
                chosen[name] = value
    return Settings(**chosen)
