"""From a job to its items: which scene, frame and camera each picture shows, and where it goes.

All that can be wrong with a job is found here, before any work. Scenes are the outermost, cameras the
innermost: a mesh is loaded once and moved once a frame.
"""

from __future__ import annotations

import fnmatch
import glob
from dataclasses import dataclass
from pathlib import Path

import msgspec

from clgrid import procedural
from clgrid.animation import DEFAULT_FPS, checked_fps
from clgrid.animation.files import frame_files, shared_name
from clgrid.batch import names
from clgrid.batch.frame_numbers import parse_frames
from clgrid.batch.item import Item
from clgrid.batch.job import Job, Override, Settings, View, merged
from clgrid.batch.loader import shading_of
from clgrid.errors import ClgridError, InputError, MeshError
from clgrid.imagefile import EXTENSIONS, Saving
from clgrid.layouts import ALL_LAYOUTS
from clgrid.recipe import Options
from clgrid.renderer import AOVS
from clgrid.scene import count_frames, short_name
from clgrid.shading.lamps import lamps_of
from clgrid.shading.order import check_shading

ALL_CAMERAS = "all"
WHOLE = "default"


@dataclass(frozen=True)
class Plan:
    """A job as items.

    Attributes
    ----------
    items : list of Item
        Of all shards, without content keys.
    records : Path
        Where the records go.
    """

    items: list[Item]
    records: Path


@dataclass(frozen=True)
class Shard:
    """One of several equal parts of a job: the items ``index``, ``index + count``...

    Attributes
    ----------
    index : int
        From 0.
    count : int
    """

    index: int = 0
    count: int = 1

    def of(self, items: list[Item]) -> list[Item]:
        """The items of this shard."""
        return [item for item in items if item.number % self.count == self.index]


WHOLE_JOB = Shard()


def parse_shard(text: str) -> Shard:
    """Read ``i/n``, from ``1/n`` to ``n/n``.

    Raises
    ------
    InputError
        If it is no such thing.
    """
    first, slash, last = text.partition("/")
    if not slash or not first.isdecimal() or not last.isdecimal() or not 1 <= int(first) <= int(last):
        raise InputError(f"--shard {text!r}: give one part of several, such as 3/16, from 1/16 to 16/16")
    return Shard(int(first) - 1, int(last))


def plan(job: Job, base: Path) -> Plan:
    """Make the items of a job.

    Parameters
    ----------
    job : Job
    base : Path
        Folder that its files are relative to.

    Raises
    ------
    InputError
        If a scene, a frame, a name of a picture or a setting cannot be as the job says.
    """
    patterns = [job.output] if isinstance(job.output, str) else list(job.output)
    _check_patterns(patterns, moving=job.frames is not None)
    scenes = find_scenes(job.scenes, base)
    for override in job.item:
        if override.frames is not None:
            parse_frames(override.frames, "item frames")
    vertices = None if job.vertices is None else str(_under(base, job.vertices))
    _check_moving(job, scenes)
    cameras = [_camera(each, base) for each in job.cameras]
    items: list[Item] = []
    frames_of = _frames_of(job, scenes, vertices)
    for scene in scenes:
        views = _views(cameras, scene)
        for frame in frames_of[scene]:
            for view in views:
                items.append(_item(job, len(items), scene, frame, view, vertices, patterns, base))
    names.require_distinct([(path, item.title) for item in items for path in item.outputs])
    for settings in {msgspec.json.encode(item.settings): item.settings for item in items}.values():
        check_settings(settings)
    records = (
        _under(base, job.records) if job.records else names.fixed_folder(patterns[0], base) / "run.jsonl"
    )
    return Plan(items, records)


def _check_patterns(patterns: list[str], *, moving: bool) -> None:
    if not patterns:
        raise InputError("output: names no picture; give at least one name")
    for pattern in patterns:
        names.checked_fields(pattern, frames=moving)
        suffix = Path(pattern).suffix.lower()
        if suffix not in EXTENSIONS:
            raise InputError(f"output {pattern!r}: unknown picture format; end it in {', '.join(EXTENSIONS)}")


def _check_moving(job: Job, scenes: list[str]) -> None:
    """Refuse what says how scenes move where no frame is asked for, or two things that move one."""
    folder = next((scene for scene in scenes if Path(scene).is_dir()), None)
    if job.frames is not None:
        if folder and job.vertices:
            raise InputError(f"vertices: {folder} is a folder of frames already; give one of them")
        if job.vertices and job.animation is not None:
            raise InputError("animation: vertices move the scenes already; give one of them")
        checked_fps(fps_of(job))
        return
    given = next((name for name in ("vertices", "fps", "animation") if getattr(job, name) is not None), None)
    if given:
        raise InputError(f'{given}: without frames no frame is drawn; add frames = "all"')
    if folder:
        raise InputError(
            f'scenes: {folder} is a folder, whose files are frames; add frames = "all", or give a pattern '
            "such as folder/*.ply, whose files are scenes"
        )


def find_scenes(given: list[str], base: Path) -> list[str]:
    """Files of patterns in the order of their names, folders of frames, and built-in scenes; each once.

    Raises
    ------
    InputError
        If a pattern fits nothing, or a file is missing.
    """
    found: dict[str, None] = {}
    for name in given:
        path = _under(base, name)
        if path.is_file():
            found[str(path)] = None
        elif path.is_dir():
            frame_files(path)
            found[str(path)] = None
        elif procedural.is_name(name):
            found[name] = None
        elif glob.has_magic(name):
            matches = sorted(match for match in glob.glob(str(path), recursive=True) if Path(match).is_file())
            if not matches:
                raise InputError(f"scenes: no file fits {name!r} in {base}; correct the pattern")
            found.update(dict.fromkeys(matches))
        else:
            raise InputError(f"scenes: no file {path}, nor a built-in scene of that name")
    if not found:
        raise InputError("scenes: names none; give files, patterns or built-in scenes")
    return list(found)


def _under(base: Path, name: str) -> Path:
    return (base / name).absolute()


def _camera(given: str | int | View, base: Path) -> View:
    if isinstance(given, View):
        if given.camera and (given.eye or given.look_at or given.up != "auto"):
            raise InputError(f"cameras: {given.camera!r} brings its own place; leave out eye, look_at and up")
        return _with_file(given, base)
    return View() if given == WHOLE else _with_file(View(camera=str(given)), base)


def _with_file(view: View, base: Path) -> View:
    """A camera file's name becomes absolute; it has to be there."""
    if not view.camera.lower().endswith(".json"):
        return view
    path = _under(base, view.camera)
    if not path.is_file():
        raise InputError(f"cameras: no file {path}; correct its name")
    return msgspec.structs.replace(view, camera=str(path), name=view.name or path.stem)


def _views(cameras: list[View], scene: str) -> list[View]:
    """The cameras for a scene, each with a name that no other has."""
    wanted: list[View] = []
    for view in cameras or [View()]:
        wanted += _all_of(scene) if view.camera == ALL_CAMERAS else [view]
    named = []
    taken: set[str] = set()
    for number, view in enumerate(wanted):
        name = view.name or view.camera or (f"view{number}" if view.eye or view.look_at else WHOLE)
        if name in taken:
            name = f"{name}.{number}"
        taken.add(name)
        named.append(msgspec.structs.replace(view, name=name))
    return named


def _all_of(scene: str) -> list[View]:
    """The cameras in a scene's file; the view of the whole scene where it has none, or cannot be read.

    What is wrong with the file is said when the item is drawn, and is that item's failure alone.
    """
    from clgrid.meshfile.gltf_cameras import read_cameras

    path = Path(scene)
    try:
        path = frame_files(path)[0] if path.is_dir() else path
        cameras = read_cameras(path) if path.is_file() else ()
    except ClgridError:
        cameras = ()
    return [View(camera=str(k), name=each.name or str(k)) for k, each in enumerate(cameras)] or [View()]


def _frames_of(job: Job, scenes: list[str], vertices: str | None) -> dict[str, list[int | None]]:
    """The frames that are drawn of each scene; None of a job without frames.

    A scene that stands still has frame 0 alone. One that cannot be read keeps the numbers asked for, or 0:
    what is wrong with it is said when its item is drawn, and is that item's failure.
    """
    if job.frames is None:
        return {scene: [None] for scene in scenes}
    numbers = parse_frames(job.frames)
    counts = {scene: _count(job, scene, vertices) for scene in scenes}
    still = vertices is None and not any(Path(scene).is_dir() for scene in scenes)
    if still and set(counts.values()) == {1}:
        raise InputError(
            f"frames {job.frames!r}: nothing moves {_named(scenes)}; give vertices, or leave out frames"
        )
    found: dict[str, list[int | None]] = {}
    for scene, count in counts.items():
        if numbers is not None and count is not None and max(numbers) >= count:
            has = "1 frame, 0" if count == 1 else f"0..{count - 1}"
            raise InputError(
                f"frames {job.frames!r}: there is no frame {max(numbers)}, {vertices or scene} has {has}"
            )
        found[scene] = list(range(count or 1)) if numbers is None else list(numbers)
    return found


def _named(scenes: list[str]) -> str:
    return scenes[0] if len(scenes) == 1 else f"any of the {len(scenes)} scenes"


def _count(job: Job, scene: str, vertices: str | None) -> int | None:
    """Frames of a scene; None if its file cannot be read."""
    try:
        return count_frames(scene, vertices, fps_of(job), job.animation)
    except MeshError:
        return None


def fps_of(job: Job) -> float:
    """Frames a second of a job."""
    return DEFAULT_FPS if job.fps is None else job.fps


def _item(
    job: Job, number: int, scene: str, frame: int | None, view: View, vertices: str | None,
    patterns: list[str], base: Path,
) -> Item:  # fmt: skip
    path = Path(scene)
    name = scene
    if path.is_absolute():
        name = shared_name(path) if path.is_dir() else short_name(path)
    chosen = [override for override in job.item if _fits(override, name, scene, view.name, frame)]
    fields = {"scene": name, "folder": path.parent.name, "camera": view.name}
    outputs = tuple(
        str(_under(base, names.filled(pattern, frame=frame, item=number, **fields))) for pattern in patterns
    )
    return Item(
        number=number,
        scene=scene,
        scene_name=name,
        camera_name=view.name,
        frame=frame,
        vertices=vertices,
        fps=fps_of(job),
        animation=job.animation,
        view=view,
        settings=merged(job, chosen),
        outputs=outputs,
    )


def _fits(override: Override, name: str, scene: str, camera: str, frame: int | None) -> bool:
    frames = None if override.frames is None else parse_frames(override.frames)
    return (
        any(fnmatch.fnmatchcase(each, override.scene) for each in (name, scene, Path(scene).name))
        and fnmatch.fnmatchcase(camera, override.camera)
        and (frames is None or frame in frames)
    )


def check_settings(settings: Settings) -> None:
    """Refuse what would fail for every item that has these settings.

    Raises
    ------
    InputError
        Naming the key.
    """
    width, height = settings.size or (1024, 1024)
    if width < 1 or height < 1 or width * height > 1 << 28:
        raise InputError(f"size {width}x{height}: give at least 1x1 and at most 2^28 pixels")
    unknown = [name for name in settings.aovs or () if name not in AOVS]
    if unknown:
        raise InputError(f"aovs: unknown AOV {unknown[0]!r}; choose of {', '.join(AOVS)}")
    Options(
        layout=settings.layout or ALL_LAYOUTS[0],
        density="auto" if settings.density is None else settings.density,
        resolution=settings.resolution,
        accuracy=settings.accuracy or "robust",
        max_memory=settings.max_memory,
        skipping=settings.skipping or False,
        rays=0,
    )
    saving_of(settings)
    shading = shading_of(settings)
    if shading is not None:
        check_shading(shading)
        lamps_of(None, shading)
    if settings.time_limit is not None and not settings.time_limit > 0:
        raise InputError(f"time_limit {settings.time_limit:g}: give seconds above 0")
    if settings.retries is not None and settings.retries < 0:
        raise InputError(f"retries {settings.retries}: give 0 or more")
    if settings.crop is not None:
        x0, y0, x1, y1 = settings.crop
        if not (0 <= x0 < x1 <= width and 0 <= y0 < y1 <= height):
            raise InputError(f"crop {settings.crop}: give x0, y0, x1, y1 within {width}x{height}")


def saving_of(settings: Settings) -> Saving:
    """How pictures are written: the same bytes for the same item, so without seconds."""
    given = {name: getattr(settings, name) for name in ("compression", "half", "tile", "quality")}
    return Saving(timings=False, **{name: value for name, value in given.items() if value is not None})
