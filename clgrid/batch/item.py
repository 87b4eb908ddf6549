"""One picture of a job, and what became of it: what goes to the child process and what comes back."""

from __future__ import annotations

import msgspec

from clgrid.animation import DEFAULT_FPS
from clgrid.batch.job import Settings, View
from clgrid.record import DeviceRecord

DONE, SKIPPED, FAILED = "done", "skipped", "failed"


class Item(msgspec.Struct, frozen=True, kw_only=True):
    """One picture to draw.

    Attributes
    ----------
    number : int
        In the whole job, from 0, whatever the shard.
    scene : str
        File or built-in scene.
    scene_name, camera_name : str
        For names of files.
    frame : int or None
        None of a still picture.
    vertices, fps, animation
        What moves the scene, as of ``clgrid.load_scene``.
    view : View
        The camera.
    outputs : tuple of str
        Files to write, absolute.
    key : str
        Hash of all that the pictures depend on; empty while it is not known.
    source_sha256 : str
        Of the scene's file.
    """

    number: int
    scene: str
    scene_name: str
    camera_name: str
    frame: int | None
    vertices: str | None
    fps: float = DEFAULT_FPS
    animation: str | int | None = None
    view: View
    settings: Settings
    outputs: tuple[str, ...]
    key: str = ""
    source_sha256: str = ""

    @property
    def title(self) -> str:
        """Short name for tables and messages."""
        frame = "" if self.frame is None else f" frame {self.frame}"
        return f"{self.scene_name} {self.camera_name}{frame}"


class Written(msgspec.Struct, frozen=True):
    """A file that is there."""

    path: str
    bytes: int


class GridRecord(msgspec.Struct, frozen=True, kw_only=True):
    """The grid that a picture was drawn through; measurements may choose another one another day."""

    layout: str
    resolution: tuple[int, int, int]
    references: int
    bytes: int


class ItemRecord(msgspec.Struct, frozen=True, kw_only=True):
    """A line of ``run.jsonl``: what became of an item.

    Attributes
    ----------
    schema, clgrid, device, compiled, seeds
        As of every record; ``device`` is None and ``compiled`` empty where nothing was drawn.
    item, scene, camera, frame
        Which item.
    status : {"done", "skipped", "failed"}
        ``skipped``: its files were there.
    key : str
        Hash of all that its pictures depend on.
    outputs : tuple of Written
    attempts : int
        Times that it was tried.
    load_s, compile_s, build_s, render_s, write_s
        Seconds, one entry each time that it was done; none where it was not.
    wait_s : list of float
        Seconds that the device waited for the scene's file.
    peak_bytes : int
        Most memory that the process had held when it was done.
    error : str
        One line; empty unless it failed.
    run : str
        When the run began, UTC, and its process.
    """

    schema: str = "clgrid.batch.item/1"
    clgrid: str
    item: int
    scene: str
    camera: str
    frame: int | None
    status: str
    key: str
    device: DeviceRecord | None = None
    compiled: tuple[str, ...] = ()
    seeds: dict[str, int] = {}
    outputs: tuple[Written, ...] = ()
    attempts: int = 0
    grid: GridRecord | None = None
    triangles: int = 0
    hits: int = 0
    load_s: list[float] = []
    wait_s: list[float] = []
    compile_s: list[float] = []
    build_s: list[float] = []
    render_s: list[float] = []
    write_s: list[float] = []
    peak_bytes: int = 0
    warnings: tuple[str, ...] = ()
    error: str = ""
    run: str = ""


def about(item: Item, version: str, status: str) -> ItemRecord:
    """A record of an item without what was measured."""
    seed = item.settings.seed
    return ItemRecord(
        clgrid=version,
        item=item.number,
        scene=item.scene,
        camera=item.camera_name,
        frame=item.frame,
        status=status,
        key=item.key,
        seeds={} if seed is None else {"seed": seed},
    )
