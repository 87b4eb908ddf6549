"""Compare devices: run each in a process of its own, then look where their answers differ."""

from __future__ import annotations

import itertools
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec

from clgrid import record
from clgrid.compare.child import view_of
from clgrid.compare.differences import first_ray, heat_map, image_differences, ray_differences
from clgrid.compare.files import Folder
from clgrid.compare.locating import Replays
from clgrid.compare.messages import Order, View
from clgrid.compare.plan import Part, Plan, parts_of
from clgrid.compare.process import Command, Rows, default_command, run
from clgrid.compare_record import COMPLETED, CompareDevice, ComparePair, CompareRecord, CompareRow
from clgrid.errors import ClgridError
from clgrid.host import host_record
from clgrid.record import Failure
from clgrid.repro_record import ReproGrid
from clgrid.rungs import RUNGS
from clgrid.scene import load_scene

Progress = Callable[[str], None]


def compare(
    names: Sequence[str],
    selectors: Sequence[str],
    plan: Plan,
    progress: Progress = lambda step: None,
    *,
    replays: Replays | None = None,
    words: Sequence[str] = (),
    command: Command = default_command,
) -> CompareRecord:
    """Build, cast and draw scenes on several devices, and compare what they answer, bit for bit.

    Devices run one after another, each in a process of its own: one that crashes, hangs or runs out of
    memory is a result, and the others complete.

    Parameters
    ----------
    names : sequence of str
        Files or built-in scenes.
    selectors : sequence of str
        Of devices, with ``/N`` behind for N compute units; ``all``.
    plan : Plan
        What each does.
    progress : callable
        Called with what begins.
    replays : Replays, optional
        Looks into the first differing rays of strict rungs.
    words : sequence of str
        The command line, for the record.
    command : callable
        Makes the command line of a device's process.

    Raises
    ------
    DeviceError
        If there is no such device.
    InputError
        If there is but one.
    """
    parts = parts_of(selectors)
    scenes, views, failures = _scenes(names, plan, progress)
    devices: list[CompareDevice] = []
    with tempfile.TemporaryDirectory(prefix="clgrid-compare-") as place:
        folder = Folder(Path(place))
        rows: list[Rows] = []
        for number, part in enumerate(parts if scenes else ()):
            order = _order(part, number, scenes, views, place, plan)
            told = lambda step, part=part: progress(f"{part.label}: {step}")  # noqa: E731
            device, own = run(part, order, plan.time_limit, told, command)
            devices.append(device)
            rows.append(own)
        pairs = []
        for number, name in enumerate(scenes):
            for accuracy in plan.accuracies:
                progress(f"compare {accuracy} of {name}")
                done = [k for k, own in enumerate(rows) if (number, accuracy) in own]
                for i, k in itertools.combinations(done, 2):
                    two = (devices[i].label, devices[k].label)
                    own_rows = (rows[i][number, accuracy], rows[k][number, accuracy])
                    pairs.append(_pair(folder, (i, k), two, own_rows, number, name, replays))
    first = next((each for each in devices if each.status == COMPLETED), None)
    return CompareRecord(
        schema=record.schema("compare"),
        clgrid=record.version(),
        device=first.device if first else _described(parts[0]),
        compiled=first.compiled if first else (),
        seeds={"rays": plan.seed},
        command=tuple(words),
        host=host_record(),
        accuracies=plan.accuracies,
        width=plan.width,
        height=plan.height,
        rays=plan.rays,
        time_limit=plan.time_limit,
        devices=devices,
        pairs=pairs,
        failures=failures,
    )


def _described(part: Part) -> record.DeviceRecord:
    whole = part.whole
    return record.DeviceRecord(whole.name, whole.driver_version, whole.platform)


def _scenes(
    names: Sequence[str], plan: Plan, progress: Progress
) -> tuple[list[str], list[View], list[Failure]]:
    """The scenes that can be loaded, what looks at them, and the others."""
    scenes, views, failures = [], [], []
    for name in dict.fromkeys(names):
        progress(f"load {name}")
        try:
            views.append(view_of(plan.camera(load_scene(name))))
            scenes.append(name)
        except ClgridError as error:
            failures.append(Failure(name, str(error)))
    return scenes, views, failures


def _order(part: Part, number: int, scenes: list[str], views: list[View], place: str, plan: Plan) -> Order:
    return Order(
        selector=part.whole.label,
        units=part.units,
        number=number,
        scenes=scenes,
        views=views,
        folder=place,
        accuracies=plan.accuracies,
        width=plan.width,
        height=plan.height,
        rays=plan.rays,
        repetitions=plan.repetitions,
        layout=plan.layout,
        density=plan.density,
        resolution=plan.resolution,
        max_memory=plan.max_memory,
        skipping=plan.skipping,
        seed=plan.seed,
    )


def _pair(
    folder: Folder,
    numbers: tuple[int, int],
    labels: tuple[str, str],
    rows: tuple[CompareRow, CompareRow],
    scene: int,
    name: str,
    replays: Replays | None,
) -> ComparePair:
    """Compare what two devices answer."""
    accuracy = rows[0].accuracy
    first, second = (folder.answers(scene, accuracy, number) for number in numbers)
    prepared = folder.rays(scene)
    assert prepared is not None
    recipe, rays = prepared
    grids = [row.grid_digests for row in rows]
    arrays = tuple(key for key in {**grids[0], **grids[1]} if grids[0].get(key) != grids[1].get(key))
    kinds = [ray_differences(first, second, kind, accuracy) for kind in rays]
    image = image_differences(first, second)
    promised = RUNGS[accuracy].lossless
    found = first_ray(first, second, rays)
    ray = found[0] if found else None
    if found and promised and replays is not None:
        grid = ReproGrid(
            layout=recipe.layout,
            accuracy=accuracy,
            resolution=rows[0].resolution,
            density=recipe.density,
            skipping=recipe.skipping,
        )
        where, file = replays.of(name, grid, found[1], labels)
        ray = msgspec.structs.replace(found[0], where=where, replay=file)
    rays_equal = all(kind.differing == 0 for kind in kinds)
    return ComparePair(
        scene=rows[0].scene,
        accuracy=accuracy,
        first=labels[0],
        second=labels[1],
        promised=promised,
        equal=rays_equal and not arrays and not image.differing and not image.ids,
        grids=not arrays,
        arrays=arrays,
        references=(rows[0].references, rows[1].references),
        rays=kinds,
        image=image,
        heat_map=heat_map(first, second),
        ray=ray,
    )


def broken_promises(result: CompareRecord) -> list[str]:
    """Say, a line each, where devices differ on a rung that promises the same bits."""
    return [
        f"{pair.scene}: {pair.accuracy}: {pair.first} and {pair.second} differ: {_what(pair)}"
        for pair in result.pairs
        if pair.promised and not pair.equal
    ]


def _what(pair: ComparePair) -> str:
    said = []
    if pair.arrays:
        said.append(f"arrays {', '.join(pair.arrays)} of the grid")
    said += [f"{each.differing:,} of {each.rays:,} {each.kind} rays" for each in pair.rays if each.differing]
    if pair.image.differing or pair.image.ids:
        said.append(f"{max(pair.image.differing, pair.image.ids):,} pixels")
    if pair.ray is not None:
        origin, direction = (
            [float.fromhex(value) for value in vector] for vector in (pair.ray.origin, pair.ray.direction)
        )
        said.append(
            f"the first, {pair.ray.kind} ray {pair.ray.index}: origin {origin}, direction {direction}:"
            f" {pair.ray.first}; {pair.ray.second}"
        )
        said += [pair.ray.where] * bool(pair.ray.where)
        said += [f"clgrid repro {pair.ray.replay}"] * bool(pair.ray.replay)
    return "; ".join(said)


def unfinished(result: CompareRecord) -> list[str]:
    """Say, a line each, which devices did not complete and what others could not do."""
    lines = []
    for each in result.devices:
        if each.status != COMPLETED:
            said = f": {each.last_words}" if each.last_words and each.last_words not in each.reason else ""
            lines.append(f"{each.label}: {each.status} at {each.step!r}: {each.reason}{said}")
        lines += [
            f"{each.label}: {failure.accuracy} of {failure.scene}: {failure.error}"
            for failure in each.failures
            if failure.error != each.reason
        ]
    return lines
