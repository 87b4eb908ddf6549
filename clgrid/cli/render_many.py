"""``clgrid render`` of several pictures: its options as a job, which goes the way of ``clgrid batch``."""

from __future__ import annotations

import glob
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clgrid.cli import options
from clgrid.errors import InputError

if TYPE_CHECKING:
    from clgrid.batch.job import Job, View


def is_job(scenes: Sequence[str], outputs: Sequence[str], cameras: Sequence[str], **wishes: Any) -> bool:
    """Whether more is asked for than one picture of one scene under plain names."""
    several = len(scenes) > 1 or len(cameras) > 1 or list(cameras) == ["all"] or any(wishes.values())
    return (
        several
        or any("{" in name for name in outputs)
        or any(glob.has_magic(name) and not Path(name).is_file() for name in scenes)
        or any(Path(name).is_dir() for name in scenes)
    )


def job_of(
    scenes: Sequence[str],
    outputs: Sequence[str],
    cameras: Sequence[str],
    place: dict[str, Any],
    moving: dict[str, Any],
    settings: dict[str, Any],
) -> Job:
    """The options as a job; what is None or empty is left as a job has it.

    Raises
    ------
    InputError
        If options contradict each other.
    """
    from clgrid.batch.job import Job

    if place["eye"] or place["look_at"]:
        if cameras:
            raise InputError("--camera brings its own place: leave out --eye, --look-at and --up")
        views: list[str | int | View] = [_view(place)]
    elif cameras:
        views = [_named(name, place) for name in cameras]
    else:
        views = [_view(place)]
    return Job(
        scenes=list(scenes),
        output=list(outputs),
        cameras=views,
        frames=moving["frames"] or None,
        vertices=moving["vertices"] or None,
        fps=moving["fps"],
        animation=moving["animation"] or None,
        **settings,
    )


def _named(name: str, place: dict[str, Any]) -> str | View:
    from clgrid.batch.job import View

    return name if place["fov"] is None else View(camera=name, fov=place["fov"])


def _view(place: dict[str, Any]) -> View:
    from clgrid.batch.job import View
    from clgrid.scene import parse_vector

    return View(
        eye=parse_vector(place["eye"], "--eye") if place["eye"] else None,
        look_at=parse_vector(place["look_at"], "--look-at") if place["look_at"] else None,
        up=place["up"],
        fov=place["fov"],
    )


def shading_of(given: dict[str, Any]) -> dict[str, Any]:
    """The options of shading that were given, as ``clgrid.look.Shading`` has them."""
    read = dict(given)
    read["sun"] = _vector(read["sun"], "--sun") if read["sun"] else None
    read["sky"] = options.parse_colour(read["sky"], "--sky") if read["sky"] else None
    return {name: value for name, value in read.items() if value is not None}


def _vector(text: str, what: str) -> tuple[float, float, float]:
    from clgrid.scene import parse_vector

    return parse_vector(text, what)
